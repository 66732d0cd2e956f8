"""Files that several processes may write at once: there whole, from one of them, or not at all."""

import errno
import os
import re
import shutil
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from glob import escape
from hashlib import sha256
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

from acquisition.printable import beginning_of
from acquisition.session.journal_chain import JOURNAL_NAME
from acquisition.session.manifest import MANIFEST_NAME

PART_SUFFIX = ".part"
"""Suffix of a file that is still being written; a leftover one is worthless."""

CAPTURE_FOLDERS = ("captures", "frames")
"""Of a session."""

_WRITER = re.compile(r"\.(\d+)\.[0-9a-f]{32}\.part$")
"""End of a part's name, after that of its writer's machine."""

_LONGEST_HEAD_BYTES = 120
"""With a machine of 64 letters, the process and a random name, a part's name stays below 255."""

_ABANDONED_S = 3600.0
"""Age of a part of another machine from which on nobody is taken to be writing it."""


def refuse_capture(path: Path) -> None:
    """Refuse to write a result where a session keeps its captures, whatever may be replaced.

    Raises
    ------
    OSError
        If ``path`` is, or lies in, such a folder.
    """
    place = Path(os.path.realpath(path))
    for folder in (place, *place.parents):
        if folder.name in CAPTURE_FOLDERS and any(
            (folder.parent / name).exists() for name in (MANIFEST_NAME, JOURNAL_NAME)
        ):
            raise OSError(
                errno.EEXIST,
                f"session {folder.parent} keeps its captures there, and they are never written "
                "over; name another folder",
                str(path),
            )


def part_of(path: Path) -> Path:
    """Return a new name for a part of a file, which tells the process that writes it."""
    writer = f"{socket.gethostname()}.{os.getpid()}.{uuid4().hex}"
    return path.with_name(f"{_part_head(path.name)}.{writer}{PART_SUFFIX}")


def _part_head(name: str) -> str:
    """The beginning of a part's name: that of its file, or a short form of a long one."""
    head = beginning_of(name, _LONGEST_HEAD_BYTES)
    return name if head == name else f"{head}~{sha256(os.fsencode(name)).hexdigest()[:8]}"


def clear_parts(folder: Path, name: str = "") -> None:
    """Delete the parts, with this beginning, that killed processes left in a folder.

    Those of this machine go when their process has ended, those of another when nothing was
    written to them for an hour, and those that tell no writer at once.
    """
    for part in folder.glob(f"{escape(_part_head(name))}*{PART_SUFFIX}"):
        try:
            age_s = time.time() - part.stat().st_mtime
        except FileNotFoundError:  # its writer has just given it its name
            continue
        if _is_being_written(part.name, age_s):
            continue
        if part.is_dir():
            shutil.rmtree(part, ignore_errors=True)
        else:
            part.unlink(missing_ok=True)


def _is_being_written(name: str, age_s: float) -> bool:
    writer = _WRITER.search(name)
    if writer is None:
        return False
    # A signal of 0 asks whether a process runs, but on Windows interrupts it.
    if os.name != "nt" and name[: writer.start()].endswith(f".{socket.gethostname()}"):
        return _is_running(int(writer[1]))
    return age_s < _ABANDONED_S


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # of somebody else
        pass
    return True


@contextmanager
def whole_file(path: Path, *, is_synced: bool = False) -> Iterator[BinaryIO]:
    """Open a file that gets its name when the block has ended without an error.

    Several processes may write the same file at once: each has its own part, and the last one wins.
    Unless ``is_synced``, with one fsync, a power cut within the next half minute may leave it
    empty or short.

    Raises
    ------
    OSError
        If the file cannot be written; ``path`` is as it was before.
    """
    refuse_capture(path)
    part = part_of(path)
    try:
        with part.open("xb") as file:
            yield file
            if is_synced:
                file.flush()
                os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def commit_file(path: Path, data: bytes) -> None:
    """Write a file with one fsync, also where two workers write the same one at once.

    The content is on disk before the name is. A power cut in the seconds after may lose the name,
    not the content: then the shard is done again. Thus no fsync of the folder.

    Raises
    ------
    OSError
        If the disk is full or the folder cannot be written.
    """
    with whole_file(path, is_synced=True) as file:
        file.write(data)


def write_shared(path: Path, data: bytes | memoryview) -> None:
    """Write a result with its name durable as well, and clear what killed writers of it left.

    Raises
    ------
    OSError
        If the disk is full or the folder cannot be written; ``path`` is as it was before.
    """
    clear_parts(path.parent, path.name)
    with whole_file(path, is_synced=True) as file:
        file.write(data)
    fsync_directory(path.parent)


def fsync_directory(path: Path) -> None:
    """Make the names in a directory durable, where the system offers that (Windows does not)."""
    if os.name == "nt":
        return
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
