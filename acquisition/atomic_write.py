"""Write a file so that after a power cut it is there whole, or as it was before."""

import os
from pathlib import Path

__all__ = ["PART_SUFFIX", "atomic_write", "fsync_directory"]

PART_SUFFIX = ".part"
"""Ending of a file that is still being written; one left behind is worth nothing."""


def atomic_write(path: Path, data: bytes) -> None:
    """Write ``data`` to ``path`` through ``path.part``: fsync, rename, fsync of the directory.

    Raises
    ------
    OSError
        If the disk is full or the directory cannot be written; ``path`` is as it was before.
    """
    part = path.with_name(path.name + PART_SUFFIX)
    try:
        with part.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        # On a full disk the half-written part takes the room that the error report needs.
        part.unlink(missing_ok=True)
        raise
    fsync_directory(path.parent)


def fsync_directory(path: Path) -> None:
    """Make the names in a directory durable."""
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
