"""Write a file so that after a power cut it is complete, or as it was before.

A session may have been received from someone else: what is written in it goes into its own files,
never through a link.
"""

import errno
import hashlib
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import BinaryIO

from acquisition.session.shared_files import PART_SUFFIX as PART_SUFFIX, fsync_directory

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
    _write_parts(path, (data,))


def atomic_write_hashed(path: Path, parts: FileParts) -> str:
    """Write a file as ``atomic_write`` does; return its SHA-256, taken while the disk works.

    Raises
    ------
    OSError
        As ``atomic_write``.
    """
    digest = helper_thread().submit(_sha256_of, parts)
    try:
        _write_parts(path, parts)
    finally:
        wait((digest,))  # it reads the caller's memory
    return digest.result()


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
def _part_of(path: Path) -> Iterator[BinaryIO]:
    part = path.with_name(path.name + PART_SUFFIX)
    try:
        with open_part(path) as file:
            yield file
        part.replace(path)
    except BaseException:
        # On a full disk the half-written part takes the space that the error report needs.
        part.unlink(missing_ok=True)
        raise
    fsync_directory(path.parent)


def _write_parts(path: Path, parts: FileParts) -> None:
    with _part_of(path) as file:
        for part in parts:
            for start in range(0, len(part), _STEP_BYTES):
                file.write(memoryview(part)[start : start + _STEP_BYTES])
                _begin_to_store(file)
        _make_durable(file)


def _begin_to_store(file: BinaryIO) -> None:
    """Let the disk work at what was written while the rest follows, where the system can."""
    if sys.platform == "linux":
        file.flush()
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)


def _make_durable(file: BinaryIO) -> None:
    file.flush()
    os.fsync(file.fileno())


def _sha256_of(parts: FileParts) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.hexdigest()
