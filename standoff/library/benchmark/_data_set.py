"""The benchmark's data set: rendered task by task, resumable, its manifest last."""

import hashlib
import json
import shutil
from dataclasses import asdict, dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from acquisition.files import make_folder
from acquisition.regular_files import read_regular_file
from acquisition.remote_files import is_url, url_of
from acquisition.session import write_shared
from acquisition.untrusted import parse_json
from analysis.choices import BenchmarkSize
from analysis.errors import ResultsFileError, SweepError
from analysis.sweep import (
    Batch,
    Commit,
    Manifest,
    Record,
    Row,
    SweepItem,
    SweepOptions,
    SweepWork,
    announced_sweep,
)
from hil_mocks.benchmark_set import (
    FORMAT,
    TRACKS,
    VERSION,
    Task,
    benchmark_tasks,
    card_files,
    document_bytes,
    track_documents,
)
from simulation.arguments import checked
from simulation.notebook import Shown
from standoff.errors import ApplicationError
from standoff.library.call import Call, FilePath, Progress, path_of

MANIFEST_NAME = "manifest.json"
STATE_NAME = ".progress"
_MADE_WITH = (
    "standoff",
    "numpy",
    "scipy",
    "numba",
    "opencv-contrib-python-headless",
    "scikit-image",
    "Pillow",
    "tifffile",
)
"""Packages whose versions may change the last digits, or the compression, of a file."""

STATE_NAME = ".progress"
_ABOUT_NAME = "set.json"


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class MadeBenchmark(Shown):
    """A complete data set of the public benchmark.

    Parameters
    ----------
    out
        Folder of the data set.
    size, seed
        Size and seed that were asked for.
    tasks
        Number of tasks by track.
    tasks_found_done
        Number of tasks that an earlier run had rendered.
    files, bytes
        Number of files, without the manifest, and their total size in bytes.
    sha256
        Hash of the whole data set: the same wherever it is made with the same package versions.
    notes
        Remarks, one sentence each.
    """

    out: Path
    size: str
    seed: int
    tasks: dict[str, int]
    tasks_found_done: int
    files: int
    bytes: int
    sha256: str
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return what ``standoff benchmark make --json`` prints."""
        facts = asdict(self)
        del facts["notes"]
        return facts | {"out": str(self.out)}


@checked
def make_benchmark(
    out: FilePath,
    *,
    size: BenchmarkSize = "small",
    seed: int = 1,
    workers: int = 1,
    progress: Progress | None = None,
) -> MadeBenchmark:
    """Render the public benchmark's data set: photographs with exact truth, in five tracks.

    A second call renders what is missing. ``docs/benchmark-data.md`` describes the files.

    Parameters
    ----------
    out
        Folder for the data set: new, empty, or holding part of the same data set.
    size
        ``tiny``: a few MB, for tests; ``small``: about 100 MB; ``full``: about 1 GB.
    seed
        Seed of all random numbers. Published results are for seed 1.
    workers
        Number of processes that render; the files do not depend on it.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    MadeBenchmark
        What the folder holds.

    Raises
    ------
    ApplicationError
        If ``out`` holds something else, or cannot be written.
    ArgumentError
        If there is no such size, or ``seed`` or ``workers`` is out of range.

    Examples
    --------
    >>> standoff.make_benchmark("benchmark", size="tiny").tasks
    {'psf': 4, 'simulation': 3, 'alignment': 7, 'changes': 10, 'things': 6}
    """
    call = Call("make_benchmark", progress)
    target = path_of(out, "out")
    if is_url(target):
        raise ApplicationError(f"{url_of(target)} is a URL; a set is made in a folder")
    folder = target.absolute()
    about = _about(size, seed)
    tasks = benchmark_tasks(size, seed)
    try:
        manifest = _finished(folder, about)
        found_done = len(tasks)
        if manifest is None:
            _begin(folder, about)
            work = _TaskWork(folder=folder, about=about)
            names = map(work.path_of, tasks)
            with Manifest(names, work.state) as listed:
                options = SweepOptions(workers=workers, strict=True)
                sweep, records = announced_sweep(call, "rendering", listed, work, options)
                found_done = sweep.found_done
                rendered = {one.item.path.name: one.row for one in records.answers()}
            manifest = _finish(folder, about, tasks, rendered)
    except OSError as error:
        raise ApplicationError(
            f"cannot write {error.filename or folder}: {error.strerror}; the same command goes on "
            "from here"
        ) from error
    except ResultsFileError as error:
        raise ApplicationError(f"{error}; the same command goes on from here") from error
    except SweepError as error:
        raise ApplicationError(str(error)) from error
    files = manifest["files"]
    return MadeBenchmark(
        out=target,
        size=size,
        seed=seed,
        tasks={track: sum(task.track == track for task in tasks) for track in TRACKS},
        tasks_found_done=found_done,
        files=len(files),
        bytes=sum(facts["bytes"] for facts in files.values()),
        sha256=manifest["sha256"],
        notes=call.notes,
    )


def _about(size: str, seed: int) -> dict[str, Any]:
    """Return what the manifest says beside the files."""
    made_with = {name: version(name) for name in _MADE_WITH}
    return {
        "format": FORMAT,
        "version": VERSION,
        "size": size,
        "seed": seed,
        "made_with": made_with,
    }


def _finished(folder: Path, about: dict[str, Any]) -> dict[str, Any] | None:
    """Manifest of a set that is complete and as asked for; None where there is none yet."""
    path = folder / MANIFEST_NAME
    if not path.exists():
        return None
    try:
        manifest: Any = parse_json(read_regular_file(path), has_file_names=True)
        is_same = all(manifest[key] == about[key] for key in ("format", "version", "size", "seed"))
        files = dict(manifest["files"])
    except OSError as error:
        raise ApplicationError(f"{path}: {error.strerror}") from error
    except (ValueError, KeyError, TypeError):
        is_same, files = False, {}
    if not is_same:
        raise ApplicationError(f"{folder} contains something else; name another --out")
    for name, facts in files.items():
        file = folder / name
        if not file.is_file() or file_facts(file.read_bytes()) != facts:
            raise ApplicationError(
                f"{file} is missing or has changed since it was made; remove {path} to have it "
                "made again"
            )
    return dict(manifest)


def _begin(folder: Path, about: dict[str, Any]) -> None:
    """Take a folder that is new, or in which the same set was begun."""
    state = folder / STATE_NAME / _ABOUT_NAME
    if state.is_file():
        try:
            begun = parse_json(state.read_bytes())
        except ValueError:
            begun = None
        if begun != about:
            raise ApplicationError(
                f"{folder} holds a set begun with another size or seed, or with other versions of "
                f"packages (see {state}); name another --out"
            )
        if any(state.parent.glob("*-*.json")):
            raise ApplicationError(
                f"{folder} was begun by an earlier version of standoff, and this version cannot "
                "continue from it; remove it, or name another --out"
            )
        return
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ApplicationError(f"{folder} contains something else; name another --out")
    make_folder(state.parent)
    write_shared(state, document_bytes(about))


@dataclass(frozen=True, kw_only=True)
class _TaskWork(SweepWork):
    """Renders tasks and writes their files, in any process."""

    commits_each = True

    folder: Path
    about: dict[str, Any]

    @property
    def key(self) -> str:
        """What the manifest says beside the files, as text."""
        return json.dumps(self.about)

    @property
    def state(self) -> Path:
        """Folder of the records."""
        return self.folder / STATE_NAME

    @property
    def root(self) -> Path:
        """Folder of the set."""
        return self.folder

    def path_of(self, task: Task) -> Path:
        """Name a task by a file that is not there."""
        return self.state / f"{task.track}-{task.name}"

    def answer(self, item: SweepItem, batch: Batch, commit: Commit) -> Record:
        """Render a task and write its files."""
        tasks = _tasks(self.about["size"], self.about["seed"])
        [task] = [one for one in tasks if self.path_of(one) == item.path]
        rendered = task.rendered()
        for path, data in rendered.files.items():
            _write_below(self.folder, path, data)
        facts = {path: file_facts(data) for path, data in rendered.files.items()}
        row = {"files": facts, "task": rendered.task, "truth": rendered.truth}
        marks = {path: one["sha256"] for path, one in facts.items()}
        return Record(items=(item,), rows=(row,), files=marks)

    def mark_of(self, path: Path) -> str:
        """Return the file's SHA-256."""
        return str(file_facts(path.read_bytes())["sha256"])


_tasks = lru_cache(maxsize=1)(benchmark_tasks)


def file_facts(data: bytes) -> dict[str, Any]:
    """Return what the manifest says of a file."""
    return {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}


def _write_below(folder: Path, path: str, data: bytes) -> None:
    """Write a file of the set, with the folders that it lies in."""
    target = folder / path
    target.parent.mkdir(parents=True, exist_ok=True)
    write_shared(target, data)


def _finish(
    folder: Path, about: dict[str, Any], tasks: list[Task], rendered: dict[str, Row]
) -> dict[str, Any]:
    """Write the lists and the truth, then the manifest; return it."""
    files = {path: facts for row in rendered.values() for path, facts in row["files"].items()}
    documents = card_files(about["size"], about["seed"])
    for track in TRACKS:
        of_track = [task.name for task in tasks if task.track == track]
        known = [(name, rendered[f"{track}-{name}"]) for name in of_track]
        documents |= track_documents(track, [(name, r["task"], r["truth"]) for name, r in known])
    for path, data in documents.items():
        _write_below(folder, path, data)
        files[path] = file_facts(data)
    lines = "".join(f"{files[path]['sha256']}  {path}\n" for path in sorted(files))
    manifest = {**about, "files": files, "sha256": hashlib.sha256(lines.encode()).hexdigest()}
    write_shared(folder / MANIFEST_NAME, document_bytes(manifest))
    shutil.rmtree(folder / STATE_NAME)
    return manifest
