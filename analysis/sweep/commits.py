"""Files that are there whole or not at all: commits of shards, and what several may write."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

PART_SUFFIX = ".part"
"""Suffix of a file that is being written, or was when its worker was killed."""


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
    part = path.with_name(f"{path.name}.{uuid4().hex}{PART_SUFFIX}")
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
