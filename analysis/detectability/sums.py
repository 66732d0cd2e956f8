"""Sums of the artefact over photographs: exact, so that those of any photographs can be merged.

The bytes of a sum are one line of JSON and the numbers model by model as float64; they are read one
model at a time. Sums of parts are the same bits, however the photographs were shared out.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import prod
from typing import Self

import numpy as np

from analysis.detectability.artefact import ArtefactTiles
from analysis.sweep import Stored
from simulation.arrays import FloatArray

_NUMBER = np.dtype("<f8")


class ExactSum:
    """The exact sum of finite float64 arrays of one shape, as terms that do not overlap.

    References
    ----------
    J. R. Shewchuk, Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric
    Predicates, 1997, section 2.
    """

    def __init__(self, terms: Iterable[FloatArray] = ()) -> None:
        self._terms: list[FloatArray] = []
        for term in terms:
            self.add(term)

    def add(self, values: FloatArray) -> None:
        """Add an array, whose terms of no account go to further ones."""
        for number, term in enumerate(self._terms):
            self._terms[number], values = _two_sum(term, values)
        if not self._terms or values.any():
            self._terms.append(values)

    def terms(self) -> list[FloatArray]:
        """Return arrays whose sum is the exact one, each below the last bits of the one before."""
        terms = list(self._terms)
        is_changing = True
        while is_changing:
            is_changing = False
            for number in range(len(terms) - 1, 0, -1):
                upper, lower = _two_sum(terms[number - 1], terms[number])
                is_changing |= not np.array_equal(upper, terms[number - 1], equal_nan=True)
                terms[number - 1], terms[number] = upper, lower
        while len(terms) > 1 and not terms[-1].any():
            terms.pop()
        return terms

    def rounded(self) -> FloatArray:
        """Return the float64 nearest to each sum; of two as near the even one."""
        first, *rest = self.terms()
        if len(rest) < 2:  # of two terms the first is the nearest
            return first
        # Half of a last bit was rounded to even, but what follows it decides.
        twice = 2 * rest[0]
        further = first + twice
        is_further = (rest[0] * rest[1] > 0) & (further - first == twice)
        return np.where(is_further, further, first)


def on_own_grid(values: FloatArray) -> FloatArray:
    """Round to the last bits of the largest of each last two axes, so that sums have few terms."""
    largest = np.abs(values).max(axis=(-2, -1), keepdims=True)
    shift = np.ldexp(3.0, np.frexp(largest)[1])
    return np.asarray((values + shift) - shift)


def _two_sum(one: FloatArray, other: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The rounded sum, and exactly what rounding took from it; D. E. Knuth, 1969, 4.2.2."""
    rounded = one + other
    of_other = rounded - one
    return rounded, (one - (rounded - of_other)) + (other - of_other)


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


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredSums:
    """Sums in a record.

    Parameters
    ----------
    stored
        Where the record's bytes are.
    images
        The number of photographs that the sums are over.
    shape
        Of the products: models, terms, zooms, tiles, n, 2 n - 1.
    first_byte
        Where the products begin in the file.
    """

    stored: Stored
    images: int
    shape: tuple[int, ...]
    first_byte: int

    @classmethod
    def of(cls, stored: Stored) -> Self:
        """Read the line before the numbers."""
        with stored.path.open("rb") as file:
            file.seek(stored.at)
            line = file.readline()
        header = json.loads(line)
        return cls(
            stored=stored,
            images=header["images"],
            shape=tuple(header["shape"]),
            first_byte=stored.at + len(line),
        )

    def sums(self, model: int | None = None) -> tuple[list[FloatArray], FloatArray]:
        """Read the terms of the products, and the pixels, of one model or of all."""
        models, _, *rest = self.shape
        first, count = (0, models) if model is None else (model, 1)
        products = self._floats(first * prod(self.shape[1:]), (count, *self.shape[1:]))
        after = prod(self.shape) + first * prod(rest[:2])
        terms = [products[:, number] for number in range(self.shape[1])]
        return terms, self._floats(after, (count, *rest[:2]))

    def _floats(self, first: int, shape: tuple[int, ...]) -> FloatArray:
        offset = self.first_byte + first * _NUMBER.itemsize
        found = np.fromfile(self.stored.path, dtype=_NUMBER, count=prod(shape), offset=offset)
        return np.asarray(found.reshape(shape), np.float64)


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

    def add_stored(self, stored: StoredSums, model: int | None = None) -> None:
        """Add stored sums: one model of them, or all."""
        self._add(stored.images, *stored.sums(model))

    def rounded(self) -> ArtefactSums | None:
        """Return the sums as nearest numbers; None if there is no photograph."""
        if self.images == 0 or self._alone is not None:
            return self._alone
        return ArtefactSums(
            products_dn2=self._products_dn2.rounded(), pixels=np.asarray(self._pixels)
        )

    def stored_bytes(self) -> bytes:
        """Return the sums as bytes, the terms of each model's products together."""
        if self._alone is not None:
            terms, pixels = self._alone.products_dn2[:, None], self._alone.pixels
        else:
            terms = np.stack(self._products_dn2.terms(), axis=1)
            pixels = np.asarray(self._pixels)
        header = json.dumps({"images": self.images, "shape": terms.shape}).encode("ascii")
        numbers = (np.ascontiguousarray(one, dtype=_NUMBER).tobytes() for one in (terms, pixels))
        return b"\n".join([header, b"".join(numbers)])

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
