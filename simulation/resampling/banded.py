"""Banded matrices along the two image axes: ``out = Wy image Wx^T`` in one pass over the image.

Every resampling and every blur of this package is such a pair. The compiled kernel works on strips
of output rows: it combines input rows into a strip, transposes the strip so that the second
combination also runs along contiguous memory, and transposes the result back. Rows are made two at
a time, because neighbours read nearly the same input. Measured by ``benchmarks/bench_zoom_out.py``.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any, cast

import cv2
import numpy as np
from scipy import sparse

from simulation.arrays import Float32Array, FloatArray, FloatImage, IntArray
from simulation.compiled import compiled, compiled_part

_STEP = 2
"""The bands of pairs are widened to a multiple of this; up to 6 rows are combined at a time."""

_STRIP_BYTES = 1 << 20
"""A strip should stay in the second-level cache ..."""

_STRIP_ROWS_MIN, _STRIP_ROWS_MAX = 64, 320
"""... but the shorter the rows of its transpose, the more they cost in set-up; even numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class _RowPairs:
    """Rows 2 k and 2 k + 1 of a matrix over the same columns, zero where one has no weight.

    ``starts`` has one column for each pair, ``bands`` its number of columns with a weight; a last
    row without a partner gets an empty one.
    """

    starts: IntArray
    bands: IntArray
    weights: FloatArray
    single_weights: Float32Array

    def weights_as(self, dtype: "np.dtype[Any]") -> FloatImage:
        """Weights in the dtype of an image."""
        return self.single_weights if dtype == np.float32 else self.weights


def _paired(starts: IntArray, weights: FloatArray, columns: int) -> _RowPairs:
    rows, band = weights.shape
    has_weight = weights != 0
    # A row without any weight has its whole band.
    first = starts + has_weight.argmax(axis=1)
    last = starts + band - has_weight[:, ::-1].argmax(axis=1)
    if rows % 2:
        first, last = np.append(first, first[-1]), np.append(last, last[-1])
    first, last = first.reshape(-1, 2).min(axis=1), last.reshape(-1, 2).max(axis=1)
    bands = np.minimum(-(-(last - first) // _STEP) * _STEP, columns)
    first = np.minimum(first, columns - bands)
    shared = np.zeros((2 * len(first), int(bands.max())))
    column = (starts - np.repeat(first, 2)[:rows])[:, None] + np.arange(band)
    row = np.broadcast_to(np.arange(rows)[:, None], column.shape)
    shared[row[has_weight], column[has_weight]] = weights[has_weight]
    return _RowPairs(first, bands, shared, shared.astype(np.float32))


@dataclass(frozen=True, slots=True, eq=False)
class BandedMatrix:
    """A matrix whose row i is ``weights[i]`` at columns ``starts[i]`` and following.

    Parameters
    ----------
    starts
        Shape ``(n,)``, int64: first column of each row's band.
    weights
        Shape ``(n, band)``, float64.
    columns
        Number of columns.
    """

    starts: IntArray
    weights: FloatArray
    columns: int
    # Operators are cached and applied many times: pairing and rounding once is worth keeping.
    pairs: _RowPairs = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "pairs", _paired(self.starts, self.weights, self.columns))

    @classmethod
    def from_entries(
        cls,
        rows: int,
        columns: int,
        row: IntArray,
        column: IntArray,
        value: FloatArray,
    ) -> "BandedMatrix":
        """Make a matrix from listed entries; entries at the same position are added.

        Parameters
        ----------
        rows, columns
            Shape of the matrix.
        row, column, value
            Position and value of each entry, one-dimensional, of equal length.
        """
        matrix = sparse.coo_array((value, (row, column)), shape=(rows, columns)).tocsr()
        return cls._from_sparse(matrix)

    @classmethod
    def _from_sparse(cls, matrix: "sparse.csr_array") -> "BandedMatrix":
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
        rows, columns = matrix.shape
        counts = np.diff(matrix.indptr)
        row = np.repeat(np.arange(rows), counts)
        column = matrix.indices.astype(np.int64)
        first = np.full(rows, columns, dtype=np.int64)
        last = np.zeros(rows, dtype=np.int64)
        np.minimum.at(first, row, column)
        np.maximum.at(last, row, column)
        band = max(int((last - first).max()) + 1, 1)
        starts = np.clip(first, 0, columns - band)
        weights = np.zeros((rows, band))
        weights[row, column - starts[row]] = matrix.data
        return cls(starts, weights, columns)

    def __repr__(self) -> str:
        return f"BandedMatrix({self.rows} x {self.columns}, band {self.weights.shape[1]})"

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.starts)

    def __matmul__(self, other: "BandedMatrix") -> "BandedMatrix":
        """Return the product: ``other`` first, then this one."""
        return self._from_sparse(self._sparse() @ other._sparse())

    def elementwise(self, other: "BandedMatrix", factor: float = 1.0) -> "BandedMatrix":
        """Return the elementwise product, times ``factor``."""
        return self._from_sparse(self._sparse().multiply(other._sparse()).tocsr() * factor)

    def of_rows(self, rows: slice) -> "BandedMatrix":
        """Return the matrix of some of the rows."""
        return BandedMatrix(self.starts[rows], self.weights[rows], self.columns)

    def dense(self) -> FloatArray:
        """Same matrix as an array of shape ``(rows, columns)``."""
        return np.asarray(self._sparse().toarray())

    def _sparse(self) -> "sparse.csr_array":
        band = self.weights.shape[1]
        column = (self.starts[:, None] + np.arange(band)).ravel()
        indptr = np.arange(self.rows + 1) * band
        return sparse.csr_array(
            (self.weights.ravel(), column, indptr), shape=(self.rows, self.columns)
        )


def apply_separable(along_y: BandedMatrix, along_x: BandedMatrix, image: FloatImage) -> FloatImage:
    """``along_y @ image @ along_x.T``.

    Parameters
    ----------
    along_y, along_x
        Their ``columns`` are the rows and columns of ``image``.
    image
        Shape ``(rows, cols)``, finite, float32 or float64.

    Returns
    -------
    ndarray of shape (along_y.rows, along_x.rows)
        In the image's dtype.
    """
    out = np.empty((along_y.rows, along_x.rows), dtype=image.dtype)
    put_separable(((along_y, (along_x,)),), image, out)
    return out


Term = tuple[BandedMatrix, tuple[BandedMatrix, ...]]
"""A matrix along y, and those to apply along x one after another."""


def put_separable(
    terms: tuple[Term, ...], image: FloatImage, out: FloatImage, *, threads: int = 1
) -> None:
    """Write the sum of the image combined by each term to ``out``.

    ``out`` has the result's shape and the image's dtype. Terms without a matrix along x combine
    along y alone. ``threads`` share the strips of rows; the result is the same.
    """
    for along_y, along_x in terms:
        expected = along_y.columns, along_x[0].columns if along_x else out.shape[1]
        if image.shape != expected:
            raise ValueError(f"the operator takes images of shape {expected}, got {image.shape}")
    image = np.ascontiguousarray(image)
    fitting = _STRIP_BYTES // (image.shape[1] * image.itemsize) // 2 * 2
    strip_rows = int(np.clip(fitting, _STRIP_ROWS_MIN, _STRIP_ROWS_MAX))
    # As many strips for each thread.
    rounds = -(-len(out) // (strip_rows * threads))
    strip_rows = min(strip_rows, -(-len(out) // (2 * rounds * threads)) * 2)
    strips = [slice(first, first + strip_rows) for first in range(0, len(out), strip_rows)]
    threads = min(threads, len(strips))
    put = partial(_put_strips, terms, image, out)
    if threads == 1:
        put(strips)
        return
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(put, [strips[first::threads] for first in range(threads)]):
            pass


@dataclass(frozen=True, slots=True)
class _Scratch:
    """Arrays to write to, kept from strip to strip: fresh memory costs as much as the sums."""

    arrays: dict[tuple[str, tuple[int, int]], FloatImage] = field(default_factory=dict)

    def array(self, name: str, shape: tuple[int, int], dtype: "np.dtype[Any]") -> FloatImage:
        if (name, shape) not in self.arrays:
            self.arrays[name, shape] = np.empty(shape, dtype)
        return self.arrays[name, shape]


def _put_strips(
    terms: tuple[Term, ...], image: FloatImage, out: FloatImage, strips: list[slice]
) -> None:
    scratch = _Scratch()
    for rows in strips:
        _put_strip(terms, image, out[rows], rows.start // 2, scratch)


def _put_strip(
    terms: tuple[Term, ...],
    image: FloatImage,
    target: FloatImage,
    first_pair: int,
    scratch: _Scratch,
) -> None:
    pairs = slice(first_pair, first_pair + (len(target) + 1) // 2)
    total: FloatImage | None = None
    for along_y, along_x in terms:
        strip = _combined(image, along_y.pairs, "strip", scratch, pairs)
        if not along_x:
            target[:] = strip[: len(target)]
            return
        turned = _transposed(strip, "turned", scratch)
        for number, matrix in enumerate(along_x[:-1]):
            turned = _combined(turned, matrix.pairs, f"part {number}", scratch)[: matrix.rows]
        # The sum is taken in the cache, before it is turned back.
        total = _combined(turned, along_x[-1].pairs, "total", scratch, sum_so_far=total)
    whole = cast("FloatImage", total)
    cv2.transpose(whole[: target.shape[1], : len(target)], target)


def _transposed(image: FloatImage, name: str, scratch: _Scratch) -> FloatImage:
    into = scratch.array(name, (image.shape[1], image.shape[0]), image.dtype)
    return cast("FloatImage", cv2.transpose(image, into))


def _combined(
    image: FloatImage,
    pairs: _RowPairs,
    name: str,
    scratch: _Scratch,
    which: slice = slice(None),
    *,
    sum_so_far: FloatImage | None = None,
) -> FloatImage:
    """Rows of a matrix times an image, added to a sum if there is one."""
    starts = pairs.starts[which]
    weights = pairs.weights_as(image.dtype)[2 * (which.start or 0) :]
    out = sum_so_far
    if out is None:
        out = scratch.array(name, (2 * len(starts), image.shape[1]), image.dtype)
    _combine_rows(image, (starts, pairs.bands[which], weights), out, sum_so_far is not None)
    return out


# Sums may be reordered, which vectorises them; NaN and infinity keep their meaning.
_FREE_ORDER = {"fastmath": {"reassoc", "contract", "nsz"}, "nogil": True}


@compiled_part(**_FREE_ORDER)
def _add_six(
    first: FloatImage, second: FloatImage, rows: FloatImage, stride: int, weights: FloatImage
) -> None:
    """Add the sums of six rows that start every ``stride`` elements, by two sets of weights."""
    n = first.shape[0]
    a0, a1, a2 = weights[0, 0], weights[0, 1], weights[0, 2]
    a3, a4, a5 = weights[0, 3], weights[0, 4], weights[0, 5]
    b0, b1, b2 = weights[1, 0], weights[1, 1], weights[1, 2]
    b3, b4, b5 = weights[1, 3], weights[1, 4], weights[1, 5]
    r0, r1, r2 = rows[:n], rows[stride:][:n], rows[2 * stride :][:n]
    r3, r4, r5 = rows[3 * stride :][:n], rows[4 * stride :][:n], rows[5 * stride :][:n]
    for j in range(n):
        x0, x1, x2, x3, x4, x5 = r0[j], r1[j], r2[j], r3[j], r4[j], r5[j]
        first[j] += ((a0 * x0 + a1 * x1) + (a2 * x2 + a3 * x3)) + (a4 * x4 + a5 * x5)
        second[j] += ((b0 * x0 + b1 * x1) + (b2 * x2 + b3 * x3)) + (b4 * x4 + b5 * x5)


@compiled_part(**_FREE_ORDER)
def _begin_by_two(
    first: FloatImage, second: FloatImage, rows: FloatImage, stride: int, weights: FloatImage
) -> None:
    """Write the sums of two rows, by two sets of weights."""
    n = first.shape[0]
    a0, a1, b0, b1 = weights[0, 0], weights[0, 1], weights[1, 0], weights[1, 1]
    r0, r1 = rows[:n], rows[stride:][:n]
    for j in range(n):
        x0, x1 = r0[j], r1[j]
        first[j] = a0 * x0 + a1 * x1
        second[j] = b0 * x0 + b1 * x1


@compiled_part(**_FREE_ORDER)
def _add_two(
    first: FloatImage, second: FloatImage, rows: FloatImage, stride: int, weights: FloatImage
) -> None:
    n = first.shape[0]
    a0, a1, b0, b1 = weights[0, 0], weights[0, 1], weights[1, 0], weights[1, 1]
    r0, r1 = rows[:n], rows[stride:][:n]
    for j in range(n):
        x0, x1 = r0[j], r1[j]
        first[j] += a0 * x0 + a1 * x1
        second[j] += b0 * x0 + b1 * x1


@compiled_part(**_FREE_ORDER)
def _add_one(first: FloatImage, second: FloatImage, row: FloatImage, weights: FloatImage) -> None:
    n = first.shape[0]
    a, b, r = weights[0, 0], weights[1, 0], row[:n]
    for j in range(n):
        first[j] += a * r[j]
        second[j] += b * r[j]


@compiled(**_FREE_ORDER)
def _combine_rows(
    image: FloatImage, pairs: tuple[IntArray, IntArray, FloatImage], out: FloatImage, adds: bool
) -> None:
    """Write pairs of combined rows of ``image`` to ``out``, which has an even number of rows.

    ``pairs`` are the starts, bands and weights of `_RowPairs`; with ``adds`` the sums are added to
    what ``out`` holds.
    """
    starts, bands, weights = pairs
    stride = image.shape[1]
    pixels = image.reshape(-1)
    for k in range(out.shape[0] // 2):
        first, second, own = out[2 * k], out[2 * k + 1], weights[2 * k : 2 * k + 2]
        rows = pixels[starts[k] * stride :]
        t, band = 0, bands[k]
        if not adds:
            if band >= 2:
                _begin_by_two(first, second, rows, stride, own)
                t = 2
            else:
                first[:] = 0
                second[:] = 0
        while t + 6 <= band:
            _add_six(first, second, rows[t * stride :], stride, own[:, t:])
            t += 6
        while t + 2 <= band:
            _add_two(first, second, rows[t * stride :], stride, own[:, t:])
            t += 2
        if t < band:
            _add_one(first, second, rows[t * stride :], own[:, t:])
