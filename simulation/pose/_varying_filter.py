"""A filter that varies over the reference, as a short sum of separable ones with weights.

``sum_t a_t(n) (u_t v_t * r)(n)``: the kernels at the nodes of a lattice are expanded in products of
a column and a row, and the weights ``a_t`` are bilinear between the nodes. Measured by
``benchmarks/speed/pose.py``.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from simulation.arrays import FloatArray, FloatImage, IntArray
from simulation.compiled import compiled, compiled_part

_CORRELATION_PX = 30.0
_EVEN = 7**0.5
"""Covariance of the images that terms are chosen for: along either axis ``exp(-|d| / 30 px)`` plus
this, so that most of what they show is even along one axis, as across an edge, or along both."""

_VARIANCE = 1 + 2 * _EVEN
"""Of such images, their mean aside."""

_TERMS_MAX = 40

_WORTH_REFINING = 9.0
"""What refinement has been seen to remove of the missed energy, at most."""

_REFINEMENTS = 8

_FOLDING = 4
"""Terms from which rows at equal distances from the middle are added before they are weighted."""

_PIVOT = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VaryingFilter:
    """Separable kernels, and their weights on a lattice over the reference.

    ``along_y`` and ``along_x`` have the shape ``(terms, 2 radius + 1)``, the radius a multiple of
    4, at least 8. ``weights`` have the shape ``(terms, rows, cols)`` of the lattice; at every node
    the kernels' weighted sum is 1. ``rows_px`` and ``cols_px`` are the reference coordinates of the
    lattice, increasing; the filter is constant beyond.
    """

    along_y: FloatArray
    along_x: FloatArray
    weights: FloatArray
    rows_px: FloatArray
    cols_px: FloatArray

    @property
    def radius(self) -> int:
        """Half-width of the kernels in px."""
        return int(self.along_y.shape[1] // 2)

    def kernels(self, rows_px: FloatArray, cols_px: FloatArray) -> FloatArray:
        """Kernels at a lattice of reference positions, row by row, shape ``(n, size, size)``."""
        along_x = interpolated(self.weights, self.cols_px, cols_px)
        weights = interpolated(along_x.swapaxes(1, 2), self.rows_px, rows_px).swapaxes(1, 2)
        terms = weights.reshape(len(weights), -1)
        kernels = np.einsum("tn,ti,tj->nij", terms, self.along_y, self.along_x, optimize=True)
        return np.asarray(kernels)

    def apply(self, window: FloatImage, origin: tuple[int, int]) -> FloatImage:
        """Filter a contiguous part of the reference; ``radius`` pixels on all sides are used up."""
        rows, cols = (size - 2 * self.radius for size in window.shape)
        node, part = cells(self.rows_px, origin[0] + np.arange(rows))
        used = slice(int(node.min()), int(node.max()) + 2)
        is_odd = (self.along_y * self.along_y[:, ::-1]).sum(axis=1) < 0
        order = np.argsort(is_odd, kind="stable")
        # Rounded before they are many: fresh memory costs more than the interpolation.
        along_y, along_x, weights = (
            a[order].astype(window.dtype)
            for a in (self.along_y, self.along_x, self.weights[:, used])
        )
        values = interpolated(weights, self.cols_px, origin[1] + np.arange(cols))
        out = np.empty((rows, cols), window.dtype)
        lines = values, node - used.start, part.astype(window.dtype)
        even = int(np.count_nonzero(~is_odd))
        _filter(np.ascontiguousarray(window), along_y, along_x, even, lines, out)
        return out


def separable_terms(
    kernels: FloatArray, tolerance: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Expand kernels ``(n, 2 radius + 1, 2 radius + 1)`` of sum 1 in products that they share.

    Columns ``(terms, 2 radius + 1)``, rows of that shape, and weights ``(n, terms)``; the sums of
    the kernels stay 1. ``tolerance`` is the error of a filtered image over its standard deviation,
    rms over the nodes.
    """
    count, size, _ = kernels.shape
    root = _image_root(size)
    seen = root.T @ kernels @ root
    _, strength, basis = np.linalg.svd(seen.reshape(count, -1), full_matrices=False)
    columns, values, rows = np.linalg.svd(basis.reshape(-1, size, size))
    energy = strength[:, None] * values
    order = np.argsort(energy.ravel())[::-1][:_TERMS_MAX]
    from_basis, from_kernel = np.unravel_index(order, energy.shape)
    columns, rows = columns[from_basis, :, from_kernel], rows[from_basis, from_kernel]
    gram = (columns @ columns.T) * (rows @ rows.T)
    shares = np.einsum("ti,nij,tj->tn", columns, seen, rows, optimize=True)
    squares = float((seen**2).sum())
    limit = count * tolerance**2 * _VARIANCE
    for terms in range(1, len(order) + 1):
        weights = np.linalg.lstsq(gram[:terms, :terms], shares[:terms], rcond=1e-12)[0]
        missed = squares - float((weights * shares[:terms]).sum())
        found = columns[:terms], rows[:terms], weights.T
        if count > 1 and limit < missed < _WORTH_REFINING * limit:
            missed, found = _refined(seen, found)
        if missed <= limit:
            break
    along_y, along_x = (
        _of_one_parity(solve_triangular(root, part.T, trans="T", lower=True).T)
        for part in found[:2]
    )
    sums = found[2] @ (along_y.sum(axis=1) * along_x.sum(axis=1))
    return along_y, along_x, found[2] / sums[:, None]


def _of_one_parity(kernels: FloatArray) -> FloatArray:
    """Take rounding out of kernels that are even or odd, as symmetric ones expand into."""
    sign = np.sign((kernels * kernels[:, ::-1]).sum(axis=1, keepdims=True))
    return np.asarray((kernels + sign * kernels[:, ::-1]) / 2)


_Terms = tuple[FloatArray, FloatArray, FloatArray]


def _refined(seen: FloatArray, terms: _Terms) -> tuple[float, _Terms]:
    """Improve columns, rows and weights in turn, by least squares; return what is missed, too."""
    columns, rows, weights = terms
    for _ in range(_REFINEMENTS):
        shares = np.einsum("nt,tj,nij->ti", weights, rows, seen, optimize=True)
        columns = _solution((weights.T @ weights) * (rows @ rows.T), shares)
        shares = np.einsum("nt,ti,nij->tj", weights, columns, seen, optimize=True)
        rows = _solution((weights.T @ weights) * (columns @ columns.T), shares)
        shares = np.einsum("ti,nij,tj->tn", columns, seen, rows, optimize=True)
        weights = _solution((columns @ columns.T) * (rows @ rows.T), shares).T
    made = np.einsum("nt,ti,tj->nij", weights, columns, rows, optimize=True)
    return float(((seen - made) ** 2).sum()), (columns, rows, weights)


def _solution(gram: FloatArray, shares: FloatArray) -> FloatArray:
    """Least squares of terms that may be nearly alike."""
    ridge = _PIVOT * np.trace(gram) * np.eye(len(gram))
    return np.asarray(np.linalg.solve(gram + ridge, shares))


def image_rms(kernels: FloatArray) -> FloatArray:
    """Rms of images filtered by kernels ``(n, size, size)``, over their standard deviation."""
    root = _image_root(kernels.shape[-1])
    return np.asarray(np.linalg.norm(root.T @ kernels @ root, axis=(1, 2)) / sqrt(_VARIANCE))


def _image_root(size: int) -> FloatArray:
    """Root by which, on either side, a kernel's norm becomes the rms of the filtered image."""
    offset = np.arange(size)
    distance = np.abs(offset[:, None] - offset)
    return np.asarray(cholesky(np.exp(-distance / _CORRELATION_PX) + _EVEN, lower=True))


def cells(nodes_px: FloatArray, at_px: IntArray | FloatArray) -> tuple[IntArray, FloatArray]:
    """Node before each position, and the part of the way to the next; constant beyond the ends."""
    if len(nodes_px) == 1:
        return np.zeros(len(at_px), dtype=np.int64), np.zeros(len(at_px))
    node = np.clip(np.searchsorted(nodes_px, at_px, side="right") - 1, 0, len(nodes_px) - 2)
    part = (at_px - nodes_px[node]) / (nodes_px[node + 1] - nodes_px[node])
    return node, np.clip(part, 0.0, 1.0)


def interpolated(
    weights: FloatImage, nodes_px: FloatArray, at_px: IntArray | FloatArray
) -> FloatImage:
    """Interpolate along the last axis, in the dtype of the weights."""
    node, part = cells(nodes_px, at_px)
    hats = np.zeros((len(nodes_px), len(at_px)), weights.dtype)
    index = np.arange(len(at_px))
    hats[node, index] = 1 - part
    hats[np.minimum(node + 1, len(nodes_px) - 1), index] += part
    return np.asarray(weights @ hats)


# Sums may be reordered, which vectorises them; NaN and infinity keep their meaning.
_FREE_ORDER = {"fastmath": {"reassoc", "contract", "nsz"}, "nogil": True}


@compiled_part(**_FREE_ORDER)
def _begin_two(
    first: FloatImage, second: FloatImage, rows: FloatImage, stride: int, taps: FloatImage
) -> None:
    """Write the sums of nine rows that begin every ``stride`` elements, by two sets of taps."""
    n = len(first)
    a0, a1, a2, a3, a4 = taps[0, 0], taps[0, 1], taps[0, 2], taps[0, 3], taps[0, 4]
    a5, a6, a7, a8 = taps[0, 5], taps[0, 6], taps[0, 7], taps[0, 8]
    b0, b1, b2, b3, b4 = taps[1, 0], taps[1, 1], taps[1, 2], taps[1, 3], taps[1, 4]
    b5, b6, b7, b8 = taps[1, 5], taps[1, 6], taps[1, 7], taps[1, 8]
    r0, r1, r2 = rows[:n], rows[stride:][:n], rows[2 * stride :][:n]
    r3, r4, r5 = rows[3 * stride :][:n], rows[4 * stride :][:n], rows[5 * stride :][:n]
    r6, r7, r8 = rows[6 * stride :][:n], rows[7 * stride :][:n], rows[8 * stride :][:n]
    for j in range(n):
        x0, x1, x2, x3, x4 = r0[j], r1[j], r2[j], r3[j], r4[j]
        x5, x6, x7, x8 = r5[j], r6[j], r7[j], r8[j]
        first[j] = ((a0 * x0 + a1 * x1) + (a2 * x2 + a3 * x3)) + (
            (a4 * x4 + a5 * x5) + (a6 * x6 + a7 * x7) + a8 * x8
        )
        second[j] = ((b0 * x0 + b1 * x1) + (b2 * x2 + b3 * x3)) + (
            (b4 * x4 + b5 * x5) + (b6 * x6 + b7 * x7) + b8 * x8
        )


@compiled_part(**_FREE_ORDER)
def _begin(out: FloatImage, rows: FloatImage, stride: int, taps: FloatImage) -> None:
    """Write the sum of nine rows that begin every ``stride`` elements."""
    n = len(out)
    a0, a1, a2, a3, a4 = taps[0], taps[1], taps[2], taps[3], taps[4]
    a5, a6, a7, a8 = taps[5], taps[6], taps[7], taps[8]
    r0, r1, r2 = rows[:n], rows[stride:][:n], rows[2 * stride :][:n]
    r3, r4, r5 = rows[3 * stride :][:n], rows[4 * stride :][:n], rows[5 * stride :][:n]
    r6, r7, r8 = rows[6 * stride :][:n], rows[7 * stride :][:n], rows[8 * stride :][:n]
    for j in range(n):
        out[j] = ((a0 * r0[j] + a1 * r1[j]) + (a2 * r2[j] + a3 * r3[j])) + (
            (a4 * r4[j] + a5 * r5[j]) + (a6 * r6[j] + a7 * r7[j]) + a8 * r8[j]
        )


@compiled_part(**_FREE_ORDER)
def _add_others(out: FloatImage, rows: FloatImage, stride: int, taps: FloatImage) -> None:
    """Add the sum of the rows after the ninth; they are a multiple of four."""
    n, t = len(out), 9
    while t + 8 <= len(taps):
        a0, a1, a2, a3 = taps[t], taps[t + 1], taps[t + 2], taps[t + 3]
        a4, a5, a6, a7 = taps[t + 4], taps[t + 5], taps[t + 6], taps[t + 7]
        r = rows[t * stride :]
        r0, r1, r2, r3 = r[:n], r[stride:][:n], r[2 * stride :][:n], r[3 * stride :][:n]
        r = r[4 * stride :]
        r4, r5, r6, r7 = r[:n], r[stride:][:n], r[2 * stride :][:n], r[3 * stride :][:n]
        for j in range(n):
            out[j] += ((a0 * r0[j] + a1 * r1[j]) + (a2 * r2[j] + a3 * r3[j])) + (
                (a4 * r4[j] + a5 * r5[j]) + (a6 * r6[j] + a7 * r7[j])
            )
        t += 8
    if t < len(taps):
        a0, a1, a2, a3 = taps[t], taps[t + 1], taps[t + 2], taps[t + 3]
        r = rows[t * stride :]
        r0, r1, r2, r3 = r[:n], r[stride:][:n], r[2 * stride :][:n], r[3 * stride :][:n]
        for j in range(n):
            out[j] += (a0 * r0[j] + a1 * r1[j]) + (a2 * r2[j] + a3 * r3[j])


@compiled_part(**_FREE_ORDER)
def _fold_rows(
    pixels: FloatImage, first: int, stride: int, sums: FloatImage, differences: FloatImage
) -> None:
    """Write the sums and the differences of rows at equal distances from a middle one.

    ``sums[k]`` and ``differences[k]`` are of the rows k below and above; no differences are made
    if their array is empty.
    """
    radius, n = len(sums) - 1, stride
    middle = first + radius * stride
    sums[0] = pixels[middle : middle + n]
    for k in range(1, radius + 1):
        below, above = pixels[middle + k * stride :][:n], pixels[middle - k * stride :][:n]
        total = sums[k]
        for j in range(n):
            total[j] = below[j] + above[j]
        if len(differences):
            difference = differences[k]
            for j in range(n):
                difference[j] = below[j] - above[j]


@compiled(**_FREE_ORDER)
def _filter(
    window: FloatImage,
    along_y: FloatImage,
    along_x: FloatImage,
    even: int,
    weights: tuple[FloatImage, IntArray, FloatImage],
    out: FloatImage,
) -> None:
    """Write the filtered window to ``out``.

    The first ``even`` terms are even along y, the others odd. ``weights`` are the terms' values at
    the lattice's rows, shape ``(terms, rows, cols)``, and for every row of ``out`` the lattice's
    row before it and the part of the way to the next.
    """
    values, node, part = weights
    stride, pixels = window.shape[1], window.reshape(-1)
    terms, radius = len(along_y), along_y.shape[1] // 2
    # Adding rows above and below the middle first is worth it for several terms.
    folds = terms >= _FOLDING
    taps = along_y[:, radius:].copy() if folds else along_y
    sums = np.empty((radius + 1, stride), window.dtype)
    differences = np.zeros((radius + 1 if even < terms else 0, stride), window.dtype)
    columns = np.empty((2, stride), window.dtype)
    row = np.empty(out.shape[1], window.dtype)
    for i in range(out.shape[0]):
        target = out[i]
        target[:] = 0
        share = part[i]
        if folds:
            _fold_rows(pixels, i * stride, stride, sums, differences)
        for t in range(terms):
            rows = (
                (sums if t < even else differences).reshape(-1) if folds else pixels[i * stride :]
            )
            # Two terms of one parity read the same rows.
            second = (t if t < even else t - even) % 2
            if second == 0:
                if t + 1 == even or t + 1 == terms:
                    _begin(columns[0], rows, stride, taps[t])
                else:
                    _begin_two(columns[0], columns[1], rows, stride, taps[t : t + 2])
            column = columns[second]
            _add_others(column, rows, stride, taps[t])
            _begin(row, column, 1, along_x[t])
            _add_others(row, column, 1, along_x[t])
            above, below = values[t, node[i]], values[t, min(node[i] + 1, values.shape[1] - 1)]
            for j in range(len(row)):
                target[j] += (above[j] + share * (below[j] - above[j])) * row[j]
