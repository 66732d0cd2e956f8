"""Files that are there whole or not at all, without waiting for the disk."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

PART_SUFFIX = ".part"


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """Open a file that gets its name when the block has ended without an error.

    Several processes may write the same file: each has its own part. A power cut within the next
    half minute may leave it empty or short; what it holds can be made again.

    Raises
    ------
    OSError
        If the file cannot be written; ``path`` is as it was before.
    """
    part = path.with_name(f"{path.name}.{uuid4().hex}{PART_SUFFIX}")
    try:
        with part.open("xb") as file:
            yield file
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
