"""One task's files in the set's folder, with a record by which a later run finds them."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from acquisition.session import write_shared
from acquisition.untrusted import parse_json
from hil_mocks.benchmark_set import Task, document_bytes

STATE_NAME = ".progress"


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskRecord:
    """What is known of a task whose files are written: ``files`` has their facts by path."""

    files: dict[str, dict[str, Any]]
    task: dict[str, Any]
    truth: dict[str, Any]


def file_facts(data: bytes) -> dict[str, Any]:
    """Return what the manifest says of a file."""
    return {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}


def written_record(task: Task, folder: Path) -> TaskRecord:
    """Render a task, write its files, and its record last; in any process.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    rendered = task.rendered()
    record = TaskRecord(
        files={path: file_facts(data) for path, data in rendered.files.items()},
        task=rendered.task,
        truth=rendered.truth,
    )
    for path, data in rendered.files.items():
        write_below(folder, path, data)
    document = {"files": record.files, "task": record.task, "truth": record.truth}
    write_shared(_record_path(task, folder), document_bytes(document))
    return record


def found_record(task: Task, folder: Path) -> TaskRecord | None:
    """Record of a task that an earlier run wrote, if all of its files are as they were."""
    try:
        document: Any = parse_json(_record_path(task, folder).read_bytes(), has_file_names=True)
        for path, facts in document["files"].items():
            if file_facts((folder / path).read_bytes()) != facts:
                return None
        return TaskRecord(**document)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def write_below(folder: Path, path: str, data: bytes) -> None:
    """Write a file of the set, with the folders that it lies in."""
    target = folder / path
    target.parent.mkdir(parents=True, exist_ok=True)
    write_shared(target, data)


def _record_path(task: Task, folder: Path) -> Path:
    return folder / STATE_NAME / f"{task.track}-{task.name}.json"
