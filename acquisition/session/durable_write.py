"""Write a file so that after a power cut it is complete, or as it was before."""

import hashlib
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

PART_SUFFIX = ".part"
"""Suffix of a file that is still being written; a leftover one is worthless."""


def atomic_write(path: Path, data: bytes | memoryview) -> None:
    """Write ``data`` to ``path`` through ``path.part``: fsync, rename, fsync of the directory.

    Raises
    ------
    OSError
        If the disk is full or the directory cannot be written; ``path`` is as it was before.
    """
    with _part_of(path) as file:
        file.write(data)
        _make_durable(file)


def atomic_write_hashed(path: Path, data: bytes | memoryview) -> str:
    """Write ``data`` as ``atomic_write`` does; return its SHA-256, taken while the disk works.

    Raises
    ------
    OSError
        As ``atomic_write``.
    """
    with ThreadPoolExecutor(1) as pool:
        digest = pool.submit(_sha256_of, data)
        atomic_write(path, data)
        return digest.result()


def fsync_directory(path: Path) -> None:
    """Make the names in a directory durable, where the system offers that (Windows does not)."""
    if os.name == "nt":
        return
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def _part_of(path: Path) -> Iterator[BinaryIO]:
    part = path.with_name(path.name + PART_SUFFIX)
    try:
        with part.open("w+b") as file:
            yield file
        part.replace(path)
    except BaseException:
        # On a full disk the half-written part takes the space that the error report needs.
        part.unlink(missing_ok=True)
        raise
    fsync_directory(path.parent)


def _make_durable(file: BinaryIO) -> None:
    file.flush()
    os.fsync(file.fileno())


def _sha256_of(data: bytes | memoryview) -> str:
    return hashlib.sha256(data).hexdigest()
