"""Sums of the artefact over photographs: what a sweep keeps of them, and its files.

A file holds the SHA-256 of all that follows, one line of JSON, the sums model by model as float64,
and a line for each photograph. It is read one model at a time. Sums are exact: those of any files
together are the same bits, however the photographs were shared out among them.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import prod
from pathlib import Path

import numpy as np

from acquisition.untrusted import parse_json
from analysis.detectability.artefact import ArtefactTiles
from analysis.sweep import ExactSum, on_own_grid
from simulation.arrays import FloatArray

_SCHEMA = "standoff.artefact-sums/2"
_NUMBER = np.dtype("<f8")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ArtefactSums:
    """Lagged products of the artefact for every model and zoom, of one photograph or of many.

    ``products_dn2`` has the shape (models, zooms, tiles, n, 2 n - 1), the rows of lags from
    -(n - 1) to 0; ``pixels`` the shape (models, zooms, tiles).
    """

    products_dn2: FloatArray
    pixels: FloatArray

    def artefact(self, model: int, zoom: int) -> ArtefactTiles:
        """Artefact for the plan's model and zoom with these indices."""
        half = self.products_dn2[model, zoom]
        # The other half follows from evenness in the lag.
        other = half[:, -2::-1, ::-1]
        return ArtefactTiles(
            products_dn2=np.concatenate([half, other], axis=1), pixels=self.pixels[model, zoom]
        )


class SummedPhotographs:
    """Sums over photographs that are exact, so that no order of them matters.

    Of one alone they are its own. Those of several are sums of products that were rounded to the
    last bits of the largest, which costs less than working them out did.
    """

    def __init__(self) -> None:
        self.images = 0
        self._alone: ArtefactSums | None = None
        self._products_dn2 = ExactSum()
        self._pixels: FloatArray | float = 0.0

    def add(self, own: ArtefactSums) -> None:
        """Add a photograph."""
        self._add(1, [own.products_dn2], own.pixels)

    def add_file(self, file: "SumsFile", model: int | None = None) -> None:
        """Add a file: one model of it, or all."""
        if file.images:
            self._add(file.images, *file.sums(model))

    def terms(self) -> tuple[FloatArray, FloatArray]:
        """Products, of shape (models, terms, ...) whose terms add up to the sums, and pixels."""
        if self._alone is not None:
            return self._alone.products_dn2[:, None], self._alone.pixels
        return np.stack(self._products_dn2.terms(), axis=1), np.asarray(self._pixels)

    def rounded(self) -> ArtefactSums | None:
        """Return the sums as nearest numbers; None if there is no photograph."""
        if self.images == 0 or self._alone is not None:
            return self._alone
        return ArtefactSums(
            products_dn2=self._products_dn2.rounded(), pixels=np.asarray(self._pixels)
        )

    def _add(self, images: int, terms: Sequence[FloatArray], pixels: FloatArray) -> None:
        before, self._alone = self._alone, None
        if self.images + images == 1:
            self._alone = ArtefactSums(products_dn2=terms[0], pixels=pixels)
        else:
            for term in () if before is None else (before.products_dn2,):
                self._products_dn2.add(on_own_grid(term))
            for term in map(on_own_grid, terms) if images == 1 else terms:
                self._products_dn2.add(term)
        self._pixels = self._pixels + pixels
        self.images += images


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredPhotograph:
    """What is kept of each photograph by name; ``item`` is the digest of it as it was on disk."""

    path: str
    sha256: str
    encoding: str
    mean_dn: float
    item: int


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptPhotographs:
    """The photographs of a file of sums.

    ``refused`` has, by their digests, the lines of those that gave nothing, ``notes`` what is
    worth saying of the others.
    """

    work: str
    group: int
    measured: Sequence[MeasuredPhotograph] = ()
    refused: Mapping[int, str] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)

    @property
    def items(self) -> list[int]:
        """Digests of all."""
        return [*(one.item for one in self.measured), *self.refused]


@dataclass(frozen=True, slots=True, kw_only=True)
class SumsFile:
    """A file of sums: what is in it and where.

    Parameters
    ----------
    path
        The file.
    work
        Hash of what was measured.
    group
        Of the photographs.
    images
        The number of photographs that the sums are over.
    shape
        Of the products: models, terms, zooms, tiles, n, 2 n - 1.
    first_byte
        Where the products begin.
    """

    path: Path
    work: str
    group: int
    images: int
    shape: tuple[int, ...]
    first_byte: int

    @classmethod
    def found(cls, path: Path) -> "SumsFile | None":
        """Look for a file; a damaged one, or one of an earlier form, counts as none.

        Raises
        ------
        OSError
            If it is there and cannot be read.
        """
        try:
            with path.open("rb") as file:
                digest = file.readline()
                whole = file.read()
        except FileNotFoundError:
            return None
        if digest != _digest(whole):
            return None
        line = whole.partition(b"\n")[0]
        header = parse_json(line)
        if header["schema"] != _SCHEMA:
            return None
        return cls(
            path=path,
            work=header["work"],
            group=header["group"],
            images=header["images"],
            shape=tuple(header["shape"]),
            first_byte=len(digest) + len(line) + 1,
        )

    def sums(self, model: int | None = None) -> tuple[list[FloatArray], FloatArray]:
        """Read the terms of the products, and the pixels, of one model or of all."""
        models, _, *rest = self.shape
        first, count = (0, models) if model is None else (model, 1)
        products = self._floats(first * prod(self.shape[1:]), (count, *self.shape[1:]))
        after = prod(self.shape) + first * prod(rest[:2])
        terms = [products[:, number] for number in range(self.shape[1])]
        return terms, self._floats(after, (count, *rest[:2]))

    def photographs(self) -> KeptPhotographs:
        """Read what is kept of each photograph."""
        measured, refused = [], {}
        with self.path.open("rb") as file:
            file.readline()
            notes = json.loads(file.readline())["notes"]
            file.seek(self.first_byte + _sums_bytes(self.shape))
            for line in file:
                told = json.loads(line)
                if "refused" in told:
                    refused[told["item"]] = told["refused"]
                else:
                    measured.append(MeasuredPhotograph(**told))
        return KeptPhotographs(
            work=self.work, group=self.group, measured=measured, refused=refused, notes=notes
        )

    def _floats(self, first: int, shape: tuple[int, ...]) -> FloatArray:
        offset = self.first_byte + first * _NUMBER.itemsize
        found = np.fromfile(self.path, dtype=_NUMBER, count=prod(shape), offset=offset)
        return np.asarray(found.reshape(shape), np.float64)


def sums_bytes(sums: SummedPhotographs, kept: KeptPhotographs) -> bytes:
    """Return a file of sums."""
    body, shape = b"", (0,) * 6
    if sums.images:
        products_dn2, pixels = sums.terms()
        body, shape = _stored(products_dn2) + _stored(pixels), products_dn2.shape
    told = [
        *map(asdict, kept.measured),
        *({"item": item, "refused": line} for item, line in kept.refused.items()),
    ]
    body += b"".join(json.dumps(one).encode("ascii") + b"\n" for one in told)
    header = {
        "schema": _SCHEMA,
        "work": kept.work,
        "group": kept.group,
        "images": sums.images,
        "shape": shape,
        "notes": dict(kept.notes),
    }
    whole = json.dumps(header).encode("ascii") + b"\n" + body
    return _digest(whole) + whole


def joined_files(files: Sequence[SumsFile]) -> bytes:
    """Return the file of several files of one group together."""
    sums, kept = SummedPhotographs(), [file.photographs() for file in files]
    for file in files:
        sums.add_file(file)
    notes: dict[str, str] = {}
    for one in kept:
        notes |= {kind: min(text, notes.get(kind, text)) for kind, text in one.notes.items()}
    return sums_bytes(
        sums,
        KeptPhotographs(
            work=files[0].work,
            group=files[0].group,
            measured=[each for one in kept for each in one.measured],
            refused={item: line for one in kept for item, line in one.refused.items()},
            notes=notes,
        ),
    )


def _digest(data: bytes) -> bytes:
    return hashlib.sha256(data).hexdigest().encode("ascii") + b"\n"


def _stored(values: FloatArray) -> bytes:
    return np.ascontiguousarray(values, dtype=_NUMBER).tobytes()


def _sums_bytes(shape: Sequence[int]) -> int:
    return (prod(shape) + shape[0] * prod(shape[2:4])) * _NUMBER.itemsize
