"""Banded matrices along the two image axes: ``out = Wy image Wx^T`` in one pass over the image.

Every resampling and every blur of this package is such a pair. The compiled kernel works on strips
of output rows: it combines input rows into a strip, turns the strip by 90 degrees so that the
second combination also runs along contiguous memory, and turns the result back. Measured by
``benchmarks/bench_zoom_out.py``.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

__all__ = ["BandedMatrix", "apply_separable", "put_separable"]

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.floating[Any]]
Function = TypeVar("Function", bound=Callable[..., object])

_UNROLL = 8
"""Input rows combined in one go; bands are widened to a multiple of it."""

_STRIP_ROWS = 64
"""Output rows per strip: a multiple of 8; a strip of 4000 columns is 1 MB."""


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

    starts: NDArray[np.int64]
    weights: FloatArray
    columns: int
    single_weights: NDArray[np.float32] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        # Operators are cached and applied many times: rounding once is worth keeping.
        object.__setattr__(self, "single_weights", self.weights.astype(np.float32))

    def weights_as(self, dtype: "np.dtype[Any]") -> FloatImage:
        """Weights in the dtype of an image."""
        return self.single_weights if dtype == np.float32 else self.weights

    @classmethod
    def from_entries(
        cls,
        rows: int,
        columns: int,
        row: NDArray[np.int64],
        column: NDArray[np.int64],
        value: FloatArray,
    ) -> "BandedMatrix":
        """Make the matrix of listed entries; entries at the same place add up.

        Parameters
        ----------
        rows, columns
            Shape of the matrix.
        row, column, value
            Place and value of each entry, one-dimensional, of equal length.
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
        band = min(-(-band // _UNROLL) * _UNROLL, columns)
        starts = np.clip(first, 0, columns - band)
        weights = np.zeros((rows, band))
        weights[row, column - starts[row]] = matrix.data
        return cls(starts, weights, columns)

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.starts)

    def __matmul__(self, other: "BandedMatrix") -> "BandedMatrix":
        """Return the product: ``other`` first, then this one."""
        return self._from_sparse(self._sparse() @ other._sparse())

    def elementwise(self, other: "BandedMatrix", factor: float = 1.0) -> "BandedMatrix":
        """Return the matrix of products of equal places, times ``factor``."""
        return self._from_sparse(self._sparse().multiply(other._sparse()).tocsr() * factor)

    def transposed(self) -> "BandedMatrix":
        """Transpose: the adjoint of the operator along this axis."""
        return self._from_sparse(self._sparse().T.tocsr())

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
    put_separable(along_y, along_x, image, out, is_added=False)
    return out


def put_separable(
    along_y: BandedMatrix,
    along_x: BandedMatrix,
    image: FloatImage,
    out: FloatImage,
    *,
    is_added: bool,
) -> None:
    """Put ``along_y @ image @ along_x.T`` into ``out``, or add it to what is there.

    ``out`` has the result's shape and the image's dtype.
    """
    if image.shape != (along_y.columns, along_x.columns):
        expected = (along_y.columns, along_x.columns)
        raise ValueError(f"the operator takes images of {expected}, got {image.shape}")
    _put(
        np.ascontiguousarray(image),
        along_y.starts,
        along_y.weights_as(image.dtype),
        along_x.starts,
        along_x.weights_as(image.dtype),
        out,
        is_added,
    )


def _compiled(function: Function) -> Function:
    # Sums may be reordered, which vectorises them; NaN and infinity keep their meaning.
    decorate = njit(cache=True, fastmath={"reassoc", "contract", "nsz"}, error_model="numpy")
    return cast("Function", decorate(function))


@_compiled
def _add_weighted_rows(out: FloatImage, rows: FloatImage, stride: int, weights: FloatImage) -> None:
    """Add rows that start every ``stride`` elements, times their weights, to ``out``."""
    n = out.shape[0]
    band = weights.shape[0]
    whole = band - band % 8
    for t in range(0, whole, 8):
        w0, w1, w2, w3 = weights[t], weights[t + 1], weights[t + 2], weights[t + 3]
        w4, w5, w6, w7 = weights[t + 4], weights[t + 5], weights[t + 6], weights[t + 7]
        r = rows[t * stride :]
        r0, r1, r2, r3 = r[:n], r[stride:][:n], r[2 * stride :][:n], r[3 * stride :][:n]
        r4, r5 = r[4 * stride :][:n], r[5 * stride :][:n]
        r6, r7 = r[6 * stride :][:n], r[7 * stride :][:n]
        for j in range(n):
            out[j] += ((w0 * r0[j] + w1 * r1[j]) + (w2 * r2[j] + w3 * r3[j])) + (
                (w4 * r4[j] + w5 * r5[j]) + (w6 * r6[j] + w7 * r7[j])
            )
    for t in range(whole, band):
        w, r0 = weights[t], rows[t * stride :][:n]
        for j in range(n):
            out[j] += w * r0[j]


@_compiled
def _transpose(source: FloatImage, out: FloatImage) -> None:
    """Write the transpose of ``source``, whose rows are a multiple of 8."""
    for i in range(0, source.shape[0], 8):
        s0, s1, s2, s3 = source[i], source[i + 1], source[i + 2], source[i + 3]
        s4, s5, s6, s7 = source[i + 4], source[i + 5], source[i + 6], source[i + 7]
        for j in range(source.shape[1]):
            o = out[j, i : i + 8]
            o[0], o[1], o[2], o[3] = s0[j], s1[j], s2[j], s3[j]
            o[4], o[5], o[6], o[7] = s4[j], s5[j], s6[j], s7[j]


@_compiled
def _put(
    image: FloatImage,
    y_starts: NDArray[np.int64],
    y_weights: FloatImage,
    x_starts: NDArray[np.int64],
    x_weights: FloatImage,
    out: FloatImage,
    is_added: bool,
) -> None:
    n, m = out.shape
    cols = image.shape[1]
    pixels = image.reshape(-1)
    strip = np.zeros((_STRIP_ROWS, cols), out.dtype)
    turned = np.empty((cols, _STRIP_ROWS), out.dtype)
    m8 = -(-m // 8) * 8
    combined = np.zeros((m8, _STRIP_ROWS), out.dtype)
    result = np.empty((_STRIP_ROWS, m8), out.dtype)
    for first in range(0, n, _STRIP_ROWS):
        count = min(_STRIP_ROWS, n - first)
        for i in range(count):
            strip[i, :] = 0
            start = y_starts[first + i] * cols
            _add_weighted_rows(strip[i], pixels[start:], cols, y_weights[first + i])
        _transpose(strip, turned)
        flat = turned.reshape(-1)
        for j in range(m):
            combined[j, :] = 0
            start = x_starts[j] * _STRIP_ROWS
            _add_weighted_rows(combined[j], flat[start:], _STRIP_ROWS, x_weights[j])
        _transpose(combined, result)
        if is_added:
            out[first : first + count] += result[:count, :m]
        else:
            out[first : first + count] = result[:count, :m]
