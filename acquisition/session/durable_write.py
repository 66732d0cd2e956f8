"""Write a file so that after a power cut it is complete, or as it was before.

A session may have been received from someone else: what is written in it goes into its own files,
never through a link.
"""

import errno
import hashlib
import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import BinaryIO

from acquisition.session.shared_files import (
    PART_SUFFIX as PART_SUFFIX,
    fsync_directory,
    refuse_capture,
)

FileParts = tuple[bytes | memoryview, ...]
"""Bytes of a file, in order; they are written from where they lie."""

_STEP_BYTES = 1 << 19
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)  # Windows has none


def atomic_write(path: Path, data: bytes | memoryview) -> None:
    """Write ``data`` to ``path`` through ``path.part``: fsync, rename, fsync of the directory.

    For a file with one writer; `acquisition.session.shared_files` has what several may write.

    Raises
    ------
    OSError
        If the disk is full or the directory cannot be written; ``path`` is as it was before.
    """
    refuse_capture(path)
    with _part_of(path, Path.replace) as file:
        _write_parts(file, (data,))
        _make_durable(file)


def write_new_hashed(
    path: Path, parts: FileParts, seal: Callable[[str], bytes] = lambda _: b""
) -> str:
    """Write a file that is not there yet, as ``atomic_write`` does; return its SHA-256.

    The hash is taken while the disk works. The file ends in what ``seal`` makes of the SHA-256 of
    ``parts``.

    Raises
    ------
    FileExistsError
        If there is a file of this name, which stays as it is.
    OSError
        As ``atomic_write``.
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
    """Move a file within its file system to a name that is not taken, and make that durable.

    Raises
    ------
    FileExistsError
        If the name is taken; nothing was moved.
    OSError
        If the system refuses.
    """
    _name_new(path, target)
    fsync_directory(target.parent)
    fsync_directory(path.parent)


def helper_thread() -> ThreadPoolExecutor:
    """The thread that works beside a writer: starting one each time takes as long as an fsync."""
    return _helper_thread_of(os.getpid())


def open_part(path: Path) -> BinaryIO:
    """Open a new file for what becomes ``path``; whatever is left over in its place is removed.

    Raises
    ------
    OSError
        If it cannot be made.
    """
    part = path.with_name(path.name + PART_SUFFIX)
    try:
        return part.open("x+b")
    except FileExistsError:
        part.unlink()  # of a run that was killed; or a link, a pipe
        return part.open("x+b")


def open_own(path: Path, flags: int) -> int:
    """Open a file that is written where it lies; returns its descriptor.

    Raises
    ------
    OSError
        If it is a link, or cannot be opened.
    """
    try:
        return os.open(path, flags | _NO_LINK, 0o666)
    except OSError as error:
        if error.errno == errno.ELOOP and path.is_symlink():
            text = "a link, which is not written through; put the file itself there"
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
