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

_UNROLL = 4
"""Input rows combined at a time; the bands of pairs are widened to a multiple of this."""

_STRIP_BYTES = 1 << 20
"""A strip should stay in the second-level cache ..."""

_STRIP_ROWS_MIN, _STRIP_ROWS_MAX = 64, 320
"""... but the shorter the rows of its transpose, the more they cost in set-up; even numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class _RowPairs:
    """Rows 2 k and 2 k + 1 of a matrix over the same columns, zero where one has no weight.

    ``starts`` has one column for each pair; a last row without a partner gets an empty one.
    """

    starts: IntArray
    weights: FloatArray
    single_weights: Float32Array

    def weights_as(self, dtype: "np.dtype[Any]") -> FloatImage:
        """Weights in the dtype of an image."""
        return self.single_weights if dtype == np.float32 else self.weights


def _paired(starts: IntArray, weights: FloatArray, columns: int) -> _RowPairs:
    rows, band = weights.shape
    if rows % 2:
        starts = np.append(starts, starts[-1])
        weights = np.concatenate([weights, np.zeros((1, band))])
    by_pair = starts.reshape(-1, 2)
    first = by_pair.min(axis=1)
    widened = band + int(np.ptp(by_pair, axis=1).max())
    widened = min(-(-widened // _UNROLL) * _UNROLL, columns)
    first = np.clip(first, 0, columns - widened)
    shared = np.zeros((len(starts), widened))
    column = (starts - np.repeat(first, 2))[:, None] + np.arange(band)
    np.put_along_axis(shared, column, weights, axis=1)
    return _RowPairs(first, shared, shared.astype(np.float32))


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
        y = along_y.pairs
        weights = y.weights_as(image.dtype)[2 * pairs.start : 2 * pairs.stop]
        strip = _combined(image, y.starts[pairs], weights, "strip", scratch)
        if not along_x:
            target[:] = strip[: len(target)]
            return
        turned = _transposed(strip, "turned", scratch)
        name = "total" if total is None else "part"
        for number, matrix in enumerate(along_x):
            x = matrix.pairs
            weights = x.weights_as(image.dtype)
            turned = _combined(turned, x.starts, weights, f"{name} {number}", scratch)
            turned = turned[: matrix.rows]
        # The sum is taken in the cache, before it is turned back.
        total = turned if total is None else np.add(total, turned, out=total)
    target[:] = _transposed(cast("FloatImage", total), "result", scratch)[: len(target)]


def _transposed(image: FloatImage, name: str, scratch: _Scratch) -> FloatImage:
    into = scratch.array(name, (image.shape[1], image.shape[0]), image.dtype)
    return cast("FloatImage", cv2.transpose(image, into))


def _combined(
    image: FloatImage, starts: IntArray, weights: FloatImage, name: str, scratch: _Scratch
) -> FloatImage:
    out = scratch.array(name, (len(weights), image.shape[1]), image.dtype)
    _combine_rows(image, starts, weights, out)
    return out


# Sums may be reordered, which vectorises them; NaN and infinity keep their meaning.
_FREE_ORDER = {"fastmath": {"reassoc", "contract", "nsz"}, "nogil": True}


@compiled_part(**_FREE_ORDER)
def _combine_into_two(
    first: FloatImage, second: FloatImage, rows: FloatImage, stride: int, weights: FloatImage
) -> None:
    """Write the sums of rows that start every ``stride`` elements, by two sets of weights."""
    n = first.shape[0]
    band = weights.shape[1]
    whole = band - band % 4
    first[:] = 0
    second[:] = 0
    for t in range(0, whole, 4):
        a0, a1, a2, a3 = weights[0, t], weights[0, t + 1], weights[0, t + 2], weights[0, t + 3]
        b0, b1, b2, b3 = weights[1, t], weights[1, t + 1], weights[1, t + 2], weights[1, t + 3]
        r = rows[t * stride :]
        r0, r1, r2, r3 = r[:n], r[stride:][:n], r[2 * stride :][:n], r[3 * stride :][:n]
        for j in range(n):
            x0, x1, x2, x3 = r0[j], r1[j], r2[j], r3[j]
            first[j] += (a0 * x0 + a1 * x1) + (a2 * x2 + a3 * x3)
            second[j] += (b0 * x0 + b1 * x1) + (b2 * x2 + b3 * x3)
    for t in range(whole, band):
        a, b, r0 = weights[0, t], weights[1, t], rows[t * stride :][:n]
        for j in range(n):
            first[j] += a * r0[j]
            second[j] += b * r0[j]


@compiled(**_FREE_ORDER)
def _combine_rows(
    image: FloatImage, starts: IntArray, weights: FloatImage, out: FloatImage
) -> None:
    """Write pairs of combined rows of ``image`` to ``out``, which has an even number of rows."""
    stride = image.shape[1]
    pixels = image.reshape(-1)
    for k in range(out.shape[0] // 2):
        _combine_into_two(
            out[2 * k],
            out[2 * k + 1],
            pixels[starts[k] * stride :],
            stride,
            weights[2 * k : 2 * k + 2],
        )
