"""The files of captures in a session, whether they are those that the journal names, and others.

A file that no line of the journal names is evidence: of lines that were lost, or of a run that was
killed before it could write its line. It is never written over.
"""

import hashlib
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from acquisition.errors import SessionError
from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from acquisition.session.capture_file import is_sealed, parse_capture
from acquisition.session.durable_write import move_new
from acquisition.session.record import CaptureRecord
from acquisition.session.shared_files import CAPTURE_FOLDERS, PART_SUFFIX

FileState = Literal["ok", "missing", "changed", "unjournaled", "unfinished"]

SET_ASIDE_FOLDER = "set-aside"
"""Of a session, for files that an operator decided not to be captures of it."""

_MOST_NAMED = 3

_OF_FILE_MANAGERS = ("Thumbs.db", "desktop.ini")


def files_of(record: CaptureRecord) -> list[tuple[str, str | None]]:
    """Names of a capture's files, relative to the session, and their hashes."""
    files = [(record.file, record.sha256)]
    if record.frames_file is not None:
        files.append((record.frames_file, record.frames_sha256))
    return files


def file_sha256(path: Path) -> str:
    """SHA-256 of a file in hexadecimal, as ``sha256sum`` prints it."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def file_state(path: Path, sha256: str | None) -> FileState:
    """Whether a file is there and has the hash.

    Raises
    ------
    SessionError
        If it cannot be read.
    """
    try:
        if not path.is_file():
            return "missing"
        return "ok" if file_sha256(path) == sha256 else "changed"
    except OSError as error:
        raise SessionError(f"{path}: {error.strerror}", path=path) from error


def is_intact(path: Path, record: CaptureRecord) -> bool:
    """Whether every file of a capture in the session at ``path`` matches the journal."""
    return all(file_state(path / file, sha256) == "ok" for file, sha256 in files_of(record))


def found_files(path: Path) -> list[str]:
    """Names of the files where captures lie, but for those that file managers leave, sorted."""
    return sorted(
        file.relative_to(path).as_posix()
        for folder in CAPTURE_FOLDERS
        for file in (path / folder).glob("*")
        if not file.name.startswith(".") and file.name not in _OF_FILE_MANAGERS
    )


def unknown_files(path: Path, records: Iterable[CaptureRecord]) -> list[str]:
    """Names of the finished files where captures lie that none of the records names."""
    known = {file for record in records for file, _ in files_of(record)}
    return [
        file
        for file in found_files(path)
        if file not in known and not (file.endswith(PART_SUFFIX) and (path / file).is_file())
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundCapture:
    """What a file that the journal does not name holds.

    Parameters
    ----------
    file
        Its name, relative to the session.
    record
        Of the capture, with the hash that the file has now; None if it is none of this session.
    is_sealed
        Whether the file vouches for its own bytes; those of older versions do not.
    refusal
        Why it is no capture of this session.
    """

    file: str
    record: CaptureRecord | None = None
    is_sealed: bool = False
    refusal: str = ""


def found_capture(
    path: Path, file: str, *, indices: Collection[int], known_uids: Collection[str]
) -> FoundCapture:
    """Read a file that the journal does not name: a capture by its own metadata and seal, or not.

    Parameters
    ----------
    path, file
        The session, and the file's name in it.
    indices
        Those of the plan.
    known_uids
        Of the captures that the journal names.
    """
    try:
        data = read_regular_file(path / file, LARGEST_IMAGE_BYTES)
        sealed = is_sealed(data)
        if sealed is False:
            return FoundCapture(file=file, refusal="is damaged: it is not as it was written")
        record = parse_capture(data, source=file).record
    except OSError as error:
        return FoundCapture(file=file, refusal=f"cannot be read ({error.strerror})")
    except SessionError:
        return FoundCapture(file=file, refusal="is not a capture of this session")
    if record.uid in known_uids:
        return FoundCapture(
            file=file, refusal=f"is a copy of capture {record.index}, which the journal has"
        )
    if record.file != file or record.index not in indices:
        return FoundCapture(file=file, refusal="is not a capture of this session")
    record = replace(record, sha256=hashlib.sha256(data).hexdigest())
    return FoundCapture(file=file, record=record, is_sealed=sealed is True)


@dataclass(frozen=True, slots=True, kw_only=True)
class KilledRun:
    """What a run left that was killed before it could journal its capture.

    Parameters
    ----------
    capture
        A whole capture; None if it was killed before.
    remains
        Files that belong to no capture.
    """

    capture: FoundCapture | None = None
    remains: tuple[str, ...] = ()


def left_by_killed_run(
    path: Path,
    unknown: Collection[str],
    next_files: Iterable[tuple[str, str]],
    uids: Collection[str],
) -> KilledRun | None:
    """Explain files that the journal does not name by a kill; None if that explains them not.

    A run writes raw frames, then the capture, then its line. So there is at most one of each, of
    the name that is next for its entry, and whole.

    Parameters
    ----------
    path, unknown
        The session, and the names of the files in it.
    next_files
        Names of capture and raw frames that each entry of the plan would have next; by index.
    uids
        Of the captures that the journal names.
    """
    if not unknown:
        return KilledRun()
    for index, (capture, frames) in enumerate(next_files):
        if not set(unknown) <= {capture, frames}:
            continue
        if capture not in unknown or (path / capture).stat().st_size == 0:
            return KilledRun(remains=tuple(unknown))
        found = found_capture(path, capture, indices=(index,), known_uids=uids)
        if found.record is None or not found.is_sealed or not is_intact(path, found.record):
            return None
        if frames in unknown and found.record.frames_file != frames:
            return None
        return KilledRun(capture=found)
    return None


def set_aside(path: Path, files: Iterable[str]) -> list[dict[str, str]]:
    """Move files out of the folders of captures; returns their old and new names and hashes.

    Raises
    ------
    OSError
        If a file cannot be moved; those before it were.
    """
    moved = []
    for file in files:
        name = Path(file).name
        folder = path / SET_ASIDE_FOLDER
        folder.mkdir(exist_ok=True)
        target, number = folder / name, 1
        while target.exists() or target.is_symlink():
            number += 1
            target = folder / f"{Path(name).stem}_{number}{Path(name).suffix}"
        facts = {"file": file, "to": target.relative_to(path).as_posix()}
        if (path / file).is_file() and not (path / file).is_symlink():
            facts["sha256"] = file_sha256(path / file)
        if (path / file).is_dir():
            (path / file).rename(target)
        else:
            move_new(path / file, target)
        moved.append(facts)
    return moved


def unknown_files_text(files: Collection[str]) -> str:
    """Say which files no line of the journal names, and what can become of them."""
    named = ", ".join(sorted(files)[:_MOST_NAMED])
    more = f" and {len(files) - _MOST_NAMED} more" if len(files) > _MOST_NAMED else ""
    return (
        f"no line of the journal names {named}{more}; `standoff verify --repair` takes in what is "
        "a capture of this session, `standoff session set-aside` moves away what is none"
    )
