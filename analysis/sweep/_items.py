"""The photographs of a sweep: as they are on disk, sorted by hashes, and cut into batches."""

import hashlib
import json
import os
from array import array
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from heapq import merge
from itertools import islice
from math import ceil, log2
from pathlib import Path
from tempfile import TemporaryFile
from types import TracebackType
from typing import IO, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from acquisition.remote_files import is_url, remote_status
from analysis.errors import ResultsFileError, SweepError

GROUPS = 64
"""Groups that many photographs fall into; merged bytes are of one group each."""

HASH_BITS = 64
"""Bits of a photograph's hash: two of a million share theirs once in 40 million sweeps."""

GROUP_HASHES = (1 << HASH_BITS) // GROUPS
_BATCH_MOST = 64
"""Photographs of a batch on average: what a kill costs a worker at most."""

_EARLIER = ("*.sums", "*.scores.npz", "*.partial.npz", f"{'[0-9a-f]' * 16}*.json")
"""Names of commits of earlier versions."""

_LINES_AT_ONCE = 1000
"""Sorted in memory: 0.2 MB of names of files."""

_RUNS_AT_ONCE = 32
"""Sorted files that are read at once, each through a buffer of 8 kB."""

Hashes = NDArray[np.uint64]
_Hash = TypeVar("_Hash", int, Hashes)


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


def group_of(path_hash: _Hash) -> _Hash:
    """0 to 63: the photographs of a group are a random sixty-fourth of all."""
    return path_hash // GROUP_HASHES


def is_few(images: int) -> bool:
    """Whether each of so many photographs is a batch, and a group, of its own."""
    return images < 2 * GROUPS


def batch_number(path_hash: _Hash, images: int) -> _Hash:
    """Leading bits of a hash, the same for the photographs of a batch, of so many in all."""
    if is_few(images):
        return path_hash
    size = min(2 ** round(log2(images // GROUPS)), _BATCH_MOST)
    shift = HASH_BITS - ceil(log2(images / size))
    return path_hash // (1 << shift)


class Manifest:
    """The photographs of a sweep in the order of their hashes, in a nameless file of ``folder``.

    ``paths`` are read once, in any order; one that comes twice counts once. The folder is made if
    need be; a `ResultsFileError` says that it cannot be written, a `SweepError` that an earlier
    version left it. Memory holds 20 bytes of each.
    """

    def __init__(self, paths: Iterable[Path], folder: Path) -> None:
        _require_own(folder)
        hashes, sizes = array("Q"), array("i")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with ExitStack() as undone:
                self._file = undone.enter_context(TemporaryFile(dir=folder))
                for path in paths:
                    item = SweepItem.on_disk(path)
                    hashes.append(item.hash)
                    sizes.append(self._file.write(item.state.encode("ascii")))
                self._file.flush()
                undone.pop_all()  # __exit__ closes it
        except OSError as error:
            raise ResultsFileError(
                f"cannot write in {folder}: {error.strerror}", source=str(folder)
            ) from error
        self.hashes, first = np.unique(np.array(hashes, np.uint64), return_index=True)
        self._sizes = np.array(sizes, np.int32)[first]
        self._starts = (np.cumsum(sizes, dtype=np.int64) - sizes)[first]

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
        return len(self.hashes)

    def __getitem__(self, number: int) -> SweepItem:
        if number >= len(self):
            raise IndexError(number)
        path, size_bytes, mtime_ns = json.loads(self.state(number))
        return SweepItem(path=Path(path), size_bytes=size_bytes, mtime_ns=mtime_ns)

    def __iter__(self) -> Iterator[SweepItem]:
        return (self[number] for number in range(len(self)))

    def state(self, number: int) -> bytes:
        """Return the state of a photograph."""
        self._file.seek(self._starts[number])
        return self._file.read(self._sizes[number])


def _require_own(state: Path) -> None:
    """Refuse what earlier versions committed, in files that this one does not read."""
    if any(next(state.glob(pattern), None) for pattern in _EARLIER):
        raise SweepError(
            f"{state} was written by an earlier version of standoff, and this version cannot "
            "continue from it; remove it, or name another --out"
        )


def first_bits(data: bytes) -> int:
    """Return the first 64 bits of the SHA-256."""
    return int.from_bytes(hashlib.sha256(data).digest()[: HASH_BITS // 8], "big")


def places_in(
    known: Hashes, wanted: Hashes, order: NDArray[np.intp] | None = None
) -> NDArray[np.intp]:
    """Return where each of ``wanted`` is in ``known``, or -1; ``order`` sorts these if need be."""
    if len(known) == 0:
        return np.full(len(wanted), -1)
    at = np.minimum(np.searchsorted(known, wanted, sorter=order), len(known) - 1)
    if order is not None:
        at = order[at]
    return np.where(known[at] == wanted, at, -1)


def sorted_lines(lines: Iterable[bytes], folder: Path) -> Iterator[bytes]:
    """Yield lines in the order of their bytes, each once, by way of nameless files in a folder.

    Each ends with its only line break. Memory does not grow with their number; the folder needs
    room for all of them, twice.
    """
    with ExitStack() as files:

        def run_of(some: Iterable[bytes]) -> IO[bytes]:
            run = files.enter_context(TemporaryFile(dir=folder))
            run.writelines(some)
            run.seek(0)
            return run

        # Level k holds runs that were merged k times; full, it becomes one run of the next.
        levels: list[list[IO[bytes]]] = [[]]
        source = iter(lines)
        while some := sorted(islice(source, _LINES_AT_ONCE)):
            levels[0].append(run_of(some))
            for level, runs in enumerate(levels):
                if len(runs) == _RUNS_AT_ONCE:
                    if level + 1 == len(levels):
                        levels.append([])
                    levels[level + 1].append(run_of(merge(*runs)))
                    for run in runs:
                        run.close()
                    runs.clear()
        before = None
        for line in merge(*(run for runs in levels for run in runs)):
            if line != before:
                yield line
            before = line
