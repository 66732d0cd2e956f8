"""Sums of the artefact over photographs: what a sweep keeps of them, and its files.

A file holds the SHA-256 of all that follows, one line of JSON, the sums model by model as float64,
and a line for each photograph. It is read one model at a time.
"""

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from math import prod
from pathlib import Path
from typing import Self

import numpy as np

from acquisition.untrusted import parse_json
from analysis.detectability.artefact import ArtefactTiles
from analysis.sweep import ShardDone
from simulation.arrays import FloatArray

_SCHEMA = "standoff.artefact-sums/1"
_NUMBER = np.dtype("<f8")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ArtefactSums:
    """Lagged products of the artefact for every model and zoom, of one photograph or of many.

    ``products_dn2`` has the shape (models, zooms, tiles, n, 2 n - 1), the rows of lags from
    -(n - 1) to 0; ``pixels`` the shape (models, zooms, tiles).
    """

    products_dn2: FloatArray
    pixels: FloatArray

    def plus(self, other: Self) -> "ArtefactSums":
        """Sum over the photographs of both; the order of a sum of three decides its last bit."""
        return ArtefactSums(
            products_dn2=self.products_dn2 + other.products_dn2, pixels=self.pixels + other.pixels
        )

    def artefact(self, model: int, zoom: int) -> ArtefactTiles:
        """Artefact for the plan's model and zoom with these indices."""
        half = self.products_dn2[model, zoom]
        # The other half follows from evenness in the lag.
        other = half[:, -2::-1, ::-1]
        return ArtefactTiles(
            products_dn2=np.concatenate([half, other], axis=1), pixels=self.pixels[model, zoom]
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredPhotograph:
    """What is kept of each photograph by name."""

    path: str
    sha256: str
    encoding: str
    mean_dn: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SumsFile:
    """The file of a shard, or of a block of shards: what is in it and where.

    ``images`` is the number of photographs that the sums are over.
    """

    path: Path
    images: int
    shape: tuple[int, ...]
    first_byte: int

    @classmethod
    def found(cls, path: Path) -> "SumsFile | None":
        """Look for a file; a damaged one counts as none.

        Raises
        ------
        OSError
            If it is there and cannot be read.
        """
        try:
            status = path.stat()
        except FileNotFoundError:
            return None
        return _checked(path, status.st_size, status.st_mtime_ns)

    def shards(self) -> dict[int, ShardDone]:
        """Read what its shards gave, by their numbers."""
        with self.path.open("rb") as file:
            file.readline()
            header = json.loads(file.readline())
        return {
            int(number): ShardDone(
                images=one["images"], refused=tuple(one["refused"]), notes=one["notes"]
            )
            for number, one in header["shards"].items()
        }

    def sums(self, model: int | None = None) -> ArtefactSums | None:
        """Read the sums of one model, or of all; None where every photograph was refused."""
        if self.images == 0:
            return None
        models = self.shape[0]
        first, count = (0, models) if model is None else (model, 1)
        shape = (count, *self.shape[1:])
        products = self._floats(first * prod(self.shape[1:]), shape)
        after = prod(self.shape) + first * prod(self.shape[1:3])
        return ArtefactSums(products_dn2=products, pixels=self._floats(after, shape[:3]))

    def photographs(self) -> Iterator[MeasuredPhotograph]:
        """Read what is kept of each photograph."""
        with self.path.open("rb") as file:
            file.seek(self.first_byte + _sums_bytes(self.shape))
            for line in file:
                yield MeasuredPhotograph(**json.loads(line))

    def _floats(self, first: int, shape: tuple[int, ...]) -> FloatArray:
        offset = self.first_byte + first * _NUMBER.itemsize
        found = np.fromfile(self.path, dtype=_NUMBER, count=prod(shape), offset=offset)
        return np.asarray(found.reshape(shape), np.float64)


def sums_bytes(
    shards: Mapping[int, ShardDone],
    sums: ArtefactSums | None,
    photographs: Iterable[MeasuredPhotograph],
) -> bytes:
    """Return the file of one or more shards."""
    body = b"" if sums is None else _stored(sums.products_dn2) + _stored(sums.pixels)
    body += b"".join(json.dumps(asdict(one)).encode("ascii") + b"\n" for one in photographs)
    header = {
        "schema": _SCHEMA,
        "images": sum(done.images for done in shards.values()),
        "shape": [0] * 5 if sums is None else sums.products_dn2.shape,
        "shards": {
            str(number): {
                "images": done.images,
                "refused": done.refused,
                "notes": dict(done.notes),
            }
            for number, done in shards.items()
        },
    }
    whole = json.dumps(header).encode("ascii") + b"\n" + body
    return _digest(whole) + whole


def joined_files(files: Sequence[SumsFile]) -> bytes:
    """Return the file of several files together, summed in their order."""
    return sums_bytes(
        {number: done for file in files for number, done in file.shards().items()},
        added(file.sums() for file in files),
        (one for file in files for one in file.photographs()),
    )


def added(parts: Iterable[ArtefactSums | None]) -> ArtefactSums | None:
    """Sum from the first to the last; None if there is none."""
    whole = None
    for part in parts:
        if part is not None:
            whole = part if whole is None else whole.plus(part)
    return whole


@lru_cache(maxsize=1)  # a block's file is asked for by each of its shards
def _checked(path: Path, size_bytes: int, mtime_ns: int) -> SumsFile | None:
    with path.open("rb") as file:
        digest = file.readline()
        whole = file.read()
    if digest != _digest(whole):
        return None
    line = whole.partition(b"\n")[0]
    header = parse_json(line)
    if header["schema"] != _SCHEMA:
        return None
    return SumsFile(
        path=path,
        images=header["images"],
        shape=tuple(header["shape"]),
        first_byte=len(digest) + len(line) + 1,
    )


def _digest(data: bytes) -> bytes:
    return hashlib.sha256(data).hexdigest().encode("ascii") + b"\n"


def _stored(values: FloatArray) -> bytes:
    return np.ascontiguousarray(values, dtype=_NUMBER).tobytes()


def _sums_bytes(shape: Sequence[int]) -> int:
    return (prod(shape) + prod(shape[:3])) * _NUMBER.itemsize
