"""Write a file whole: after a power cut it is complete, or as it was before.

Files that several processes may write at once are there whole, from one of them, or not at all. A
session may have been received from someone else: what is written in it goes into its own files,
never through a link.
"""

import errno
import hashlib
import os
import re
import shutil
import socket
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from glob import escape
from hashlib import sha256
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

from acquisition.printable import beginning_of

MANIFEST_NAME = "session.json"
JOURNAL_NAME = "journal.jsonl"

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
    """Refuse to write a result where a session keeps its captures, whatever may be replaced."""
    place = Path(os.path.realpath(path))
    for folder in (place, *place.parents):
        if folder.name in CAPTURE_FOLDERS and any(
            (folder.parent / name).exists() for name in (MANIFEST_NAME, JOURNAL_NAME)
        ):
            raise OSError(
                errno.EEXIST,
                f"session {folder.parent} keeps its captures there, and they are never "
                "overwritten; name another folder",
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

    Those of this machine go when their process has ended, those of another an hour after they were
    last written.
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

    Several processes may write it at once: the last one wins. Unless ``is_synced``, a power cut
    within the next half minute may leave it empty or short.
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
    """Write a file with one fsync: a power cut may lose its name, and the work is done again."""
    with whole_file(path, is_synced=True) as file:
        file.write(data)


def write_shared(path: Path, data: bytes | memoryview) -> None:
    """Write a result with its name durable as well, and clear what killed writers of it left."""
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


FileParts = tuple[bytes | memoryview, ...]
"""Bytes of a file, in order; they are written from where they lie."""

_STEP_BYTES = 1 << 19
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)  # Windows has none


def atomic_write(path: Path, data: bytes | memoryview) -> None:
    """Write a file with one writer through ``path.part``: fsync, rename, fsync of the directory."""
    refuse_capture(path)
    with _part_of(path, Path.replace) as file:
        _write_parts(file, (data,))
        _make_durable(file)


def write_new_hashed(
    path: Path, parts: FileParts, seal: Callable[[str], bytes] = lambda _: b""
) -> str:
    """Write a new file as ``atomic_write`` does, with a seal; return its SHA-256.

    The hash is taken while the disk works. The file ends in what ``seal`` makes of the SHA-256 of
    ``parts``.
    """
    digest = helper_thread().submit(_sha256_of, parts)
    try:
        with _part_of(path, _name_new) as file:
            _write_parts(file, parts)
            whole = digest.result()
            end = seal(whole.hexdigest())
            file.write(end)
            whole.update(end)
            _make_durable(file)
    finally:
        wait((digest,))  # it reads the caller's memory
    return whole.hexdigest()


def move_new(path: Path, target: Path) -> None:
    """Move a file within its file system to a name that is not taken, and make that durable."""
    _name_new(path, target)
    fsync_directory(target.parent)
    fsync_directory(path.parent)


def helper_thread() -> ThreadPoolExecutor:
    """The thread that works beside a writer: starting one each time takes as long as an fsync."""
    return _helper_thread_of(os.getpid())


def open_part(path: Path) -> BinaryIO:
    """Open a new file for what becomes ``path``; whatever is left over in its place is removed."""
    part = path.with_name(path.name + PART_SUFFIX)
    try:
        return part.open("x+b")
    except FileExistsError:
        part.unlink()  # of a run that was killed; or a link, a pipe
        return part.open("x+b")


def open_own(path: Path, flags: int) -> int:
    """Open a file that is written where it lies; returns its descriptor."""
    try:
        return os.open(path, flags | _NO_LINK, 0o666)
    except OSError as error:
        if error.errno == errno.ELOOP and path.is_symlink():
            text = "a link, which is not followed when writing; replace it by the file itself"
            raise OSError(errno.ELOOP, text, str(path)) from error
        raise


@cache
def _helper_thread_of(_process_id: int) -> ThreadPoolExecutor:  # a fork has no threads
    return ThreadPoolExecutor(1, "session")


@contextmanager
def _part_of(path: Path, name: Callable[[Path, Path], object]) -> Iterator[BinaryIO]:
    part = path.with_name(path.name + PART_SUFFIX)
    try:
        with open_part(path) as file:
            yield file
        name(part, path)
    except BaseException:
        # On a full disk the half-written part takes the space that the error report needs.
        part.unlink(missing_ok=True)
        raise
    fsync_directory(path.parent)


def _name_new(file: Path, name: Path) -> None:
    """Rename a file; where the new name is taken, refuse, as a plain rename does not."""
    try:
        os.link(file, name)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links: take the name first, and replace that
        os.close(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        try:
            file.replace(name)
        except BaseException:
            name.unlink(missing_ok=True)
            raise
        return
    file.unlink()


def _write_parts(file: BinaryIO, parts: FileParts) -> None:
    for part in parts:
        for start in range(0, len(part), _STEP_BYTES):
            file.write(memoryview(part)[start : start + _STEP_BYTES])
            _begin_to_store(file)


def _begin_to_store(file: BinaryIO) -> None:
    """Let the disk work at what was written while the rest follows, where the system can."""
    if sys.platform == "linux":
        file.flush()
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def _make_durable(file: BinaryIO) -> None:
    file.flush()
    os.fsync(file.fileno())


def _sha256_of(parts: FileParts) -> "hashlib._Hash":
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest
