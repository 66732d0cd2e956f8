"""The commit of a shard: one file, whole or not there."""

import os
from pathlib import Path
from uuid import uuid4

PART_SUFFIX = ".part"
"""Suffix of a file that is being written, or was when its worker was killed."""


def commit_file(path: Path, data: bytes) -> None:
    """Write a file with one fsync, also where two workers write the same one at once.

    The content is on disk before the name is. A power cut in the seconds after may lose the name,
    not the content: then the shard is done again. Thus no fsync of the folder.

    Raises
    ------
    OSError
        If the disk is full or the folder cannot be written.
    """
    # Of its own: a scheduler that lost sight of a worker has another one do the same shard.
    part = path.with_name(f"{path.name}.{uuid4().hex}{PART_SUFFIX}")
    try:
        with part.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
