"""The photographs of a sweep: sorted, counted and read again and again, never all in memory."""

import hashlib
import json
import os
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from types import TracebackType
from typing import Self

from acquisition.remote_files import is_url, remote_status
from analysis.errors import ResultsFileError
from analysis.sweep.sorting import sorted_lines

HASH_BITS = 64
"""Bits of a photograph's hash: two of a million share theirs once in 40 million sweeps."""


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
            return cls._of_url(path)
        absolute = Path(os.path.abspath(path))  # noqa: PTH100  resolve() follows links
        try:
            found = absolute.stat()
        except OSError:
            return cls(path=absolute, size_bytes=-1, mtime_ns=-1)
        if not os.access(absolute, os.R_OK):
            return cls(path=absolute, size_bytes=-1, mtime_ns=-1)
        return cls(path=absolute, size_bytes=found.st_size, mtime_ns=found.st_mtime_ns)

    @classmethod
    def _of_url(cls, path: Path) -> Self:
        try:
            found = remote_status(path)
        except OSError:
            return cls(path=path, size_bytes=-1, mtime_ns=-1)
        return cls(path=path, size_bytes=found.size_bytes, mtime_ns=found.version)

    @property
    def is_there(self) -> bool:
        """Whether the file could be read when the sweep began."""
        return self.size_bytes >= 0

    @property
    def hash(self) -> int:
        """First bits of the SHA-256 of the path, from 0 to 2^64 - 1: which shard it is in."""
        return _first_bits(os.fsencode(self.path))

    @property
    def state(self) -> str:
        """The item as one line of ASCII text, the same only for the same path, size and time."""
        return json.dumps([os.fspath(self.path), self.size_bytes, self.mtime_ns])

    @property
    def digest(self) -> int:
        """First bits of the SHA-256 of the state, from 0 to 2^64 - 1."""
        return _first_bits(self.state.encode("ascii"))


class Manifest:
    """The photographs of a sweep in the order of their hashes, in a nameless file.

    Parameters
    ----------
    paths
        Read once, in any order; a path that comes twice counts once.
    folder
        Where the file is; it vanishes with the process.

    Raises
    ------
    ResultsFileError
        If the folder cannot be written.
    """

    def __init__(self, paths: Iterable[Path], folder: Path) -> None:
        self._length = 0
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with ExitStack() as undone:
                self._file = undone.enter_context(TemporaryFile(dir=folder))
                for line in sorted_lines(map(_line, paths), folder):
                    self._file.write(line)
                    self._length += 1
                self._file.flush()
                undone.pop_all()  # __exit__ closes it
        except OSError as error:
            raise ResultsFileError(
                f"cannot write in {folder}: {error.strerror}", source=str(folder)
            ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[SweepItem]:
        """Read the photographs from the first; one reader at a time."""
        self._file.seek(0)
        for line in self._file:
            path, size_bytes, mtime_ns = json.loads(line[HASH_BITS // 4 :])
            yield SweepItem(path=Path(path), size_bytes=size_bytes, mtime_ns=mtime_ns)


def _first_bits(data: bytes) -> int:
    return int.from_bytes(hashlib.sha256(data).digest()[: HASH_BITS // 8], "big")


def _line(path: Path) -> bytes:
    item = SweepItem.on_disk(path)
    return f"{item.hash:016x}{item.state}\n".encode("ascii")
