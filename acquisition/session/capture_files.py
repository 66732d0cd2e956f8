"""The files of captures in a session, and whether they are those that the journal names."""

import hashlib
from pathlib import Path
from typing import Literal

from acquisition.errors import SessionError
from acquisition.session.record import CaptureRecord

FileState = Literal["ok", "missing", "changed", "unjournaled"]


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
