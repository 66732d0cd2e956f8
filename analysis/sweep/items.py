"""The photographs of a sweep: as they are on disk, sorted by hashes, and cut into batches."""

import hashlib
import json
import os
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from math import ceil, log2
from pathlib import Path
from tempfile import TemporaryFile
from types import TracebackType
from typing import Self

from acquisition.remote_files import is_url, remote_status
from analysis.errors import ResultsFileError

GROUPS = 64
"""Groups that many photographs fall into; merged bytes are of one group each."""

HASH_BITS = 64
"""Bits of a photograph's hash: two of a million share theirs once in 40 million sweeps."""

GROUP_HASHES = (1 << HASH_BITS) // GROUPS
_BATCH_MOST = 64
"""Photographs of a batch on average: what a kill costs a worker at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepItem:
    """A photograph as it was on disk when the sweep began.

    ``path`` is absolute, as workers may have other working folders, or stands for a URL, whose
    version is in ``mtime_ns``. ``size_bytes`` and ``mtime_ns`` are -1 for one that is missing or
    must not be read.
    """

    path: Path
    size_bytes: int
    mtime_ns: int

    @classmethod
    def on_disk(cls, path: Path) -> Self:
        """Look at a file."""
        if is_url(path):
            try:
                remote = remote_status(path)
            except OSError:
                return cls(path=path, size_bytes=-1, mtime_ns=-1)
            return cls(path=path, size_bytes=remote.size_bytes, mtime_ns=remote.version)
        absolute = Path(os.path.abspath(path))  # noqa: PTH100  resolve() follows links
        try:
            found = absolute.stat()
        except OSError:
            return cls(path=absolute, size_bytes=-1, mtime_ns=-1)
        if not os.access(absolute, os.R_OK):
            return cls(path=absolute, size_bytes=-1, mtime_ns=-1)
        return cls(path=absolute, size_bytes=found.st_size, mtime_ns=found.st_mtime_ns)

    @property
    def is_there(self) -> bool:
        """Whether the file could be read when the sweep began."""
        return self.size_bytes >= 0

    @property
    def hash(self) -> int:
        """First bits of the SHA-256 of the path, from 0 to 2^64 - 1."""
        return first_bits(os.fsencode(self.path))

    @property
    def state(self) -> str:
        """The item as one line of ASCII text, the same only for the same path, size and time."""
        return json.dumps([os.fspath(self.path), self.size_bytes, self.mtime_ns])


def group_of(path_hash: int) -> int:
    """0 to 63: the photographs of a group are a random sixty-fourth of all."""
    return path_hash // GROUP_HASHES


def is_few(images: int) -> bool:
    """Whether each of so many photographs is a batch, and a group, of its own."""
    return images < 2 * GROUPS


def batch_number(path_hash: int, images: int) -> int:
    """Leading bits of a hash, the same for the photographs of a batch, of so many in all."""
    if is_few(images):
        return path_hash
    size = min(2 ** round(log2(images // GROUPS)), _BATCH_MOST)
    return path_hash >> (HASH_BITS - ceil(log2(images / size)))


class Manifest:
    """The photographs of a sweep in the order of their hashes, in a nameless database.

    Parameters
    ----------
    paths
        Read once, in any order; a path that comes twice counts once.
    folder
        Of the records; it is made if need be.

    Raises
    ------
    ResultsFileError
        If the folder cannot be written.
    """

    def __init__(self, paths: Iterable[Path], folder: Path) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with TemporaryFile(dir=folder):
                pass
        except OSError as error:
            raise ResultsFileError(
                f"cannot write in {folder}: {error.strerror}", source=str(folder)
            ) from error
        with ExitStack() as undone:
            # SQLite keeps a database without a name in a file of its own once it is large.
            self.database = undone.enter_context(closing(sqlite3.connect("")))
            self.database.execute("pragma journal_mode = off")
            self.database.execute("create table items(hash integer primary key, state text)")
            items = map(SweepItem.on_disk, paths)
            self.database.executemany(
                "insert or ignore into items values(?, ?)",
                ((signed(item.hash), item.state) for item in items),
            )
            (count,) = self.database.execute("select count(*) from items").fetchone()
            self._length = int(count)
            self._close = undone.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._close.close()

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[SweepItem]:
        for (state,) in self.database.execute("select state from items order by hash"):
            yield item_of(state)


def item_of(state: str) -> SweepItem:
    """Return the item of a state."""
    path, size_bytes, mtime_ns = json.loads(state)
    return SweepItem(path=Path(path), size_bytes=size_bytes, mtime_ns=mtime_ns)


def first_bits(data: bytes) -> int:
    """Return the first 64 bits of the SHA-256."""
    return int.from_bytes(hashlib.sha256(data).digest()[: HASH_BITS // 8], "big")


def signed(bits: int) -> int:
    """64 bits as SQLite has them, in the same order."""
    return bits - (1 << (HASH_BITS - 1))


def unsigned(number: int) -> int:
    """The 64 bits that SQLite has as this number."""
    return number + (1 << (HASH_BITS - 1))
