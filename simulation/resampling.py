"""Banded matrices along the two image axes: ``out = Wy image Wx^T`` in one pass over the image.

Every resampling and every blur of this package is such a pair. The compiled kernel works on strips
of output rows: it combines input rows into a strip, transposes the strip so that the second
combination also runs along contiguous memory, and transposes the result back. Rows are made two at
a time, because neighbours read nearly the same input. Measured by ``benchmarks/speed/zoom_out.py``.

The border is mirrored at the image's edge (``d c b a | a b c d | d c b a``, the ``reflect`` of
``scipy.ndimage``), except for Pillow's antialiased cubic, which omits what is outside and
normalises the rest.

A Gaussian *sampled* at the pixels is a wrong blur below a width of 0.6 px: for 0.3 px, it blurs by
0.09 px. The kernels here are made from the transfer function instead: they are the inverse
transform of ``exp(-2 pi^2 f^T S f)`` up to the Nyquist frequency. A correlated Gaussian
(off-diagonal ``S``) is not a product of two kernels; its singular value decomposition writes it as
a short sum of products.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import lru_cache, partial
from math import ceil
from typing import Any, cast

import cv2
import numpy as np
from scipy import sparse

from simulation.arrays import Float32Array, FloatArray, FloatImage, IntArray
from simulation.choices import GaussianForm
from simulation.combined_rows import (
    PACKED_BYTES,
    VECTOR_BYTES,
    add_weighted,
    combine_rows,
    whole_vectors,
)

_STRIP_BYTES = 1 << 20
"""A strip should stay in the second-level cache ..."""

_STRIP_ROWS_MIN, _STRIP_ROWS_MAX = 64, 320
"""... but the shorter it is, the more rows of the image belong to two of them; whole vectors."""


@dataclass(frozen=True, slots=True, eq=False)
class _RowPairs:
    """Rows 2 k and 2 k + 1 of a matrix over the same columns, zero where one has no weight.

    ``starts`` has one column for each pair, ``bands`` its number of columns with a weight. Columns
    2 t and 2 t + 1 of ``weights`` are the two rows' for the column t of the band. A last row
    without a partner gets an empty one.
    """

    starts: IntArray
    bands: IntArray
    weights: FloatArray
    single_weights: Float32Array

    def of(self, which: slice, dtype: "np.dtype[Any]") -> tuple[IntArray, IntArray, FloatImage]:
        """Columns and weights of some of the pairs, in the dtype of an image."""
        weights = self.single_weights if dtype == np.float32 else self.weights
        return self.starts[which], self.bands[which], weights[which]


def _paired(starts: IntArray, weights: FloatArray, columns: int) -> _RowPairs:
    rows, band = weights.shape
    has_weight = weights != 0
    # A row without any weight has its whole band.
    first = starts + has_weight.argmax(axis=1)
    last = starts + band - has_weight[:, ::-1].argmax(axis=1)
    if rows % 2:
        first, last = np.append(first, first[-1]), np.append(last, last[-1])
    first, last = first.reshape(-1, 2).min(axis=1), last.reshape(-1, 2).max(axis=1)
    bands = last - first
    each = np.zeros((len(first), int(bands.max()), 2))
    column = (starts - np.repeat(first, 2)[:rows])[:, None] + np.arange(band)
    row = np.broadcast_to(np.arange(rows)[:, None], column.shape)[has_weight]
    each[row // 2, column[has_weight], row % 2] = weights[has_weight]
    shared = each.reshape(len(first), -1)
    return _RowPairs(first, bands, shared, shared.astype(np.float32))


@dataclass(frozen=True, slots=True, eq=False)
class BandedMatrix:
    """A matrix whose row i is ``weights[i]``, of ``(n, band)``, from column ``starts[i]`` on."""

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
        """Make a matrix from listed entries; entries at the same position are added."""
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
    """``along_y @ image @ along_x.T`` of a finite float32 or float64 image, in its dtype."""
    out = np.empty((along_y.rows, along_x.rows), dtype=image.dtype)
    put_separable(((along_y, (along_x,)),), image, out)
    return out


_Term = tuple[BandedMatrix, tuple[BandedMatrix, ...]]
"""A matrix along y, and those to apply along x one after another."""


@dataclass(frozen=True, slots=True, eq=False)
class TermWeights:
    """Factors of the terms' results, linear along x between columns; in the image's dtype.

    ``values`` has the shape ``(terms, columns, rows of the result)``. For every column of the
    result ``node`` is the one before it and ``part`` the part of the way to the next.
    """

    values: FloatImage
    node: IntArray
    part: FloatImage


def put_separable(
    terms: tuple[_Term, ...],
    image: FloatImage,
    out: FloatImage,
    *,
    weights: TermWeights | None = None,
    threads: int = 1,
) -> None:
    """Write the sum of the image combined by each term, times its weights, to ``out``.

    ``out`` has the result's shape and the image's dtype. Terms without a matrix along x combine
    along y alone. ``threads`` share the strips of rows; the result is the same.
    """
    for along_y, along_x in terms:
        expected = along_y.columns, along_x[0].columns if along_x else out.shape[1]
        if image.shape != expected:
            raise ValueError(f"the operator takes images of shape {expected}, got {image.shape}")
    image = np.ascontiguousarray(image)
    fitting = _STRIP_BYTES // (image.shape[1] * image.itemsize)
    fitting = int(np.clip(fitting, _STRIP_ROWS_MIN, _STRIP_ROWS_MAX))
    # As many strips for each thread.
    rounds = -(-len(out) // (fitting * threads))
    strip_rows = whole_vectors(-(-len(out) // (rounds * threads)), image.dtype)
    strips = [slice(first, first + strip_rows) for first in range(0, len(out), strip_rows)]
    threads = min(threads, len(strips))
    put = partial(_put_strips, terms, image, out, weights)
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
        """Array whose rows begin where vectors in memory do, if they are whole ones."""
        if (name, shape) not in self.arrays:
            size = shape[0] * shape[1]
            room = np.empty(size + VECTOR_BYTES // dtype.itemsize, dtype)
            first = -room.ctypes.data % VECTOR_BYTES // dtype.itemsize
            self.arrays[name, shape] = room[first : first + size].reshape(shape)
        return self.arrays[name, shape]


def _put_strips(
    terms: tuple[_Term, ...],
    image: FloatImage,
    out: FloatImage,
    weights: TermWeights | None,
    strips: list[slice],
) -> None:
    scratch = _Scratch()
    for rows in strips:
        target = out[rows]
        total: FloatImage | None = None
        for number, (along_y, along_x) in enumerate(terms):
            pairs = slice(rows.start // 2, rows.start // 2 + (len(target) + 1) // 2)
            strip = _strip(image, along_y.pairs.of(pairs, image.dtype), scratch)
            if not along_x:
                target[:] = strip[: len(target), : target.shape[1]]
                break
            made = scratch.array("turned", (strip.shape[1], strip.shape[0]), image.dtype)
            made = cast("FloatImage", cv2.transpose(strip, made))
            for place, matrix in enumerate(along_x[:-1]):
                made = _combined(made, matrix, f"part {place}", scratch)
            # The sum is taken in the cache, before it is turned back.
            if weights is None:
                total = _combined(made, along_x[-1], "total", scratch, sum_so_far=total)
                continue
            made = _combined(made, along_x[-1], "part", scratch)
            total = scratch.array("total", (made.shape[0], made.shape[1]), image.dtype)
            values = np.ascontiguousarray(weights.values[number, :, rows])
            add_weighted(total, made, (values, weights.node, weights.part), number > 0)
        if total is not None:
            cv2.transpose(total[: target.shape[1], : len(target)], target)


def _strip(
    image: FloatImage, pairs: tuple[IntArray, IntArray, FloatImage], scratch: _Scratch
) -> FloatImage:
    """Pairs of rows times the image, in an array of whole vectors either way."""
    shape = (
        whole_vectors(2 * len(pairs[0]), image.dtype),
        whole_vectors(image.shape[1], image.dtype),
    )
    strip = scratch.array("strip", shape, image.dtype)
    room = scratch.array("packed", (len(image), PACKED_BYTES // image.itemsize), image.dtype)
    combine_rows(image, pairs, strip, False, room)
    return strip


def _combined(
    image: FloatImage,
    matrix: BandedMatrix,
    name: str,
    scratch: _Scratch,
    *,
    sum_so_far: FloatImage | None = None,
) -> FloatImage:
    """A matrix times an image of whole vectors, added to a sum if there is one."""
    pairs, out = matrix.pairs.of(slice(None), image.dtype), sum_so_far
    if out is None:
        out = scratch.array(name, (2 * len(pairs[0]), image.shape[1]), image.dtype)
    combine_rows(image, pairs, out, sum_so_far is not None, np.empty((0, 0), image.dtype))
    return out


_KEYS_A = -0.5
"""Slope parameter of Pillow's BICUBIC (Resample.c) and of R. G. Keys, 1981."""


def antialiased_cubic(positions_px: FloatArray, zoom: float, size: int) -> BandedMatrix:
    """Pillow's ``resize(..., BICUBIC, box=...)`` along one axis of ``size`` pixels.

    ``positions_px`` are the input coordinates of the outputs, spaced by ``zoom``, by which the
    cubic is widened if it is above 1.

    References
    ----------
    R. G. Keys, "Cubic convolution interpolation for digital image processing", 1981, eq. 15;
    Pillow 10-13, ``src/libImaging/Resample.c``, ``precompute_coeffs``.
    """
    stretch = max(zoom, 1.0)
    support = 2.0 * stretch
    # Pillow truncates towards zero after adding one half, with pixel edges at integers.
    centre = positions_px + 0.5
    first = np.maximum((centre - support + 0.5).astype(np.int64), 0)
    last = np.minimum((centre + support + 0.5).astype(np.int64), size)
    taps = np.arange(int((last - first).max()))
    column = first[:, None] + taps
    weights = _keys_cubic((column - positions_px[:, None]) / stretch)
    weights[column >= last[:, None]] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    return _from_taps(np.minimum(column, size - 1), weights, size)


def blur(kernel: FloatArray, size: int) -> BandedMatrix:
    """Convolution of ``size`` pixels with a kernel of odd length, mirrored at the border."""
    radius = len(kernel) // 2
    # Output i takes kernel[radius + offset] from input i - offset.
    column = _mirrored(np.arange(size)[:, None] - np.arange(-radius, radius + 1), size)
    return _from_taps(column, np.broadcast_to(kernel, column.shape), size)


def spline_sampling(positions_px: FloatArray, prefilter: FloatArray, size: int) -> BandedMatrix:
    """Blur, and point-sample the quintic spline through the blurred pixels, in one matrix.

    ``positions_px`` are the input coordinates of the outputs, ``prefilter`` the kernel of odd
    length from pixels to spline coefficients, including the blur.

    References
    ----------
    M. Unser, "Splines: a perfect fit for signal and image processing", 1999.
    """
    radius = len(prefilter) // 2
    knot = np.floor(positions_px).astype(np.int64)
    fraction = positions_px - knot
    # Six B-splines reach a position, each with its own shifted copy of the prefilter.
    weights = np.zeros((len(positions_px), len(prefilter) + 5))
    for shift in range(6):
        basis = _quintic_b_spline(fraction - (shift - 2))
        # Input column k contributes prefilter[(knot + shift - 2) - k + radius].
        weights[:, shift : shift + len(prefilter)] += basis[:, None] * prefilter[::-1]
    column = knot[:, None] - radius - 2 + np.arange(weights.shape[1])
    return _from_taps(_mirrored(column, size), weights, size)


def mirrored_rows(starts: IntArray, weights: FloatArray, size: int) -> BandedMatrix:
    """Rows of weights ``(n, taps)`` from columns ``starts`` on, mirrored at the image's edges."""
    taps = weights.shape[1]
    column = _mirrored(starts[:, None] + np.arange(taps), size)
    first = np.clip(starts, 0, max(size - taps, 0))
    place = column - first[:, None]
    if taps > size or place.min() < 0 or place.max() >= taps:
        return _from_taps(column, weights, size)
    place += taps * np.arange(len(starts))[:, None]
    folded = np.bincount(place.ravel(), weights.ravel(), weights.size)
    return BandedMatrix(first, np.asarray(folded, np.float64).reshape(weights.shape), size)


def _from_taps(column: IntArray, weights: FloatArray, size: int) -> BandedMatrix:
    row = np.repeat(np.arange(len(column)), column.shape[1])
    return BandedMatrix.from_entries(len(column), size, row, column.ravel(), weights.ravel())


def _mirrored(column: IntArray, size: int) -> IntArray:
    folded = column % (2 * size)
    return np.minimum(folded, 2 * size - 1 - folded)


def _keys_cubic(x: FloatArray) -> FloatArray:
    x, a = np.abs(x), _KEYS_A
    inner = ((a + 2) * x - (a + 3)) * x**2 + 1
    outer = (((x - 5) * x + 8) * x - 4) * a
    return np.where(x < 1, inner, np.where(x < 2, outer, 0.0))


def _quintic_b_spline(x: FloatArray) -> FloatArray:
    x = np.abs(x)
    powers = [np.maximum(knot - x, 0.0) ** 5 for knot in (3, 2, 1)]
    return np.asarray((powers[0] - 6 * powers[1] + 15 * powers[2]) / 120)


_MATCHED_TAIL_TOLERANCE = 1e-3
"""Largest weight that the ``matched`` model cuts off, in both ``zoom_out`` and ``simulate_pose``;
it keeps two successive zooms within 0.07 % of a single one."""

_TERMS_TOLERANCE = 3e-5
"""Terms are kept until the omitted singular values sum to less than this."""

_CUT_SIGMAS = 4.5
"""A Gaussian is below 1e-4 of its peak there."""

_SPLINE_RADIUS_MIN_PX = 13
"""Least half-width with a spline prefilter, which itself has fallen to 2e-5 there."""

_SAMPLED_TRUNCATION = 4.0
"""Half-width in sigmas, as in ``scipy.ndimage.gaussian_filter``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BlurCovariance:
    """Covariance of a blur in px^2, positive semi-definite; it may be singular, zero is no blur."""

    yy_px2: float
    xx_px2: float
    xy_px2: float = 0.0

    def __post_init__(self) -> None:
        ceiling = self.yy_px2 * self.xx_px2 * (1 + 1e-9)
        if not (self.yy_px2 >= 0 and self.xx_px2 >= 0 and self.xy_px2**2 <= ceiling):
            raise ValueError(f"a blur needs a positive semi-definite covariance, got {self}")


@dataclass(frozen=True, slots=True, eq=False)
class SeparableTerm:
    """One product ``along_y[i] * along_x[j]`` of a kernel; odd lengths, centred at 0 px."""

    along_y: FloatArray
    along_x: FloatArray


@lru_cache(maxsize=64)
def gaussian_terms(
    covariance: BlurCovariance,
    *,
    tail_tolerance: float,
    spline_prefilter: bool = False,
    form: GaussianForm = "transfer",
) -> tuple[SeparableTerm, ...]:
    """Kernels whose products sum to the blur of ``covariance``; the total is 1.

    The transfer function has a kink at the Nyquist frequency, so the kernel's tail falls only with
    the square of the distance, with alternating signs. It is cut off once it is below
    ``tail_tolerance`` and the Gaussian itself has ended, with half weight on the last pixel. An
    uncorrelated Gaussian takes one product. With ``spline_prefilter`` the transfer function is
    divided by that of the quintic B-spline, so that the kernel gives the coefficients of the spline
    through the blurred pixels. The form ``"sampled"`` is the Gaussian of ``scipy.ndimage``, for
    comparison; it supports no prefilter.
    """
    if form == "sampled" and spline_prefilter:
        raise ValueError("a sampled Gaussian cannot be divided by the spline's transfer function")
    if covariance.xy_px2 == 0:
        along_y, along_x = (
            _kernel_1d(variance, tail_tolerance, spline_prefilter, form)
            for variance in (covariance.yy_px2, covariance.xx_px2)
        )
        return (SeparableTerm(along_y, along_x),)
    return _correlated_terms(covariance, tail_tolerance, spline_prefilter, form)


def matched_terms(covariance: BlurCovariance) -> tuple[SeparableTerm, ...]:
    """Kernels from pixels to the coefficients of the quintic spline through the blurred pixels."""
    return gaussian_terms(covariance, tail_tolerance=_MATCHED_TAIL_TOLERANCE, spline_prefilter=True)


def _kernel_1d(
    variance_px2: float, tail_tolerance: float, spline_prefilter: bool, form: GaussianForm
) -> FloatArray:
    if variance_px2 == 0 and not spline_prefilter:
        return np.ones(1)
    sigma_px = np.sqrt(variance_px2)
    if form == "sampled":
        radius = int(_SAMPLED_TRUNCATION * sigma_px + 0.5)
        kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma_px) ** 2)
        return np.asarray(kernel / kernel.sum())
    size = _transform_size(sigma_px)
    freq: FloatArray = np.fft.fftfreq(size).astype(np.float64)
    transfer = np.exp(-2 * np.pi**2 * variance_px2 * freq**2)
    if spline_prefilter:
        transfer = transfer / spline_transfer(freq)
    half = np.fft.ifft(transfer).real[: size // 2]
    radius = _cut_radius(half, sigma_px, tail_tolerance)
    if spline_prefilter:
        radius = max(radius, _SPLINE_RADIUS_MIN_PX)
    kernel = np.concatenate([half[radius:0:-1], half[: radius + 1]])
    kernel[[0, -1]] *= 0.5
    return np.asarray(kernel / kernel.sum())


def _correlated_terms(
    covariance: BlurCovariance, tail_tolerance: float, spline_prefilter: bool, form: GaussianForm
) -> tuple[SeparableTerm, ...]:
    sigma_y_px, sigma_x_px = np.sqrt(covariance.yy_px2), np.sqrt(covariance.xx_px2)
    if form == "sampled":
        radii = [int(_SAMPLED_TRUNCATION * s + 0.5) for s in (sigma_y_px, sigma_x_px)]
        y, x = np.ogrid[-radii[0] : radii[0] + 1, -radii[1] : radii[1] + 1]
        yy, xx, xy = covariance.yy_px2, covariance.xx_px2, covariance.xy_px2
        quadratic = (xx * y**2 - 2 * xy * x * y + yy * x**2) / (yy * xx - xy**2)
        kernel = np.exp(-0.5 * quadratic)
    else:
        size = _transform_size(max(sigma_y_px, sigma_x_px))
        freq: FloatArray = np.fft.fftfreq(size).astype(np.float64)
        fy, fx = freq[:, None], freq[None, :]
        transfer = np.exp(
            -2
            * np.pi**2
            * (
                covariance.yy_px2 * fy**2
                + covariance.xx_px2 * fx**2
                + 2 * covariance.xy_px2 * fx * fy
            )
        )
        # A pixel grid cannot distinguish +1/2 and -1/2 cycles/px: the real part is their mean.
        if spline_prefilter:
            transfer = transfer / (spline_transfer(fy) * spline_transfer(fx))
        full = np.fft.fftshift(np.fft.ifft2(transfer).real)
        radii = [
            len(_kernel_1d(v, tail_tolerance, spline_prefilter, form)) // 2
            for v in (covariance.yy_px2, covariance.xx_px2)
        ]
        mid = size // 2
        kernel = full[
            mid - radii[0] : mid + radii[0] + 1, mid - radii[1] : mid + radii[1] + 1
        ].copy()
        kernel[[0, -1], :] *= 0.5
        kernel[:, [0, -1]] *= 0.5
    u, singular, vt = np.linalg.svd(kernel / kernel.sum())
    left_out = singular.sum() - np.cumsum(singular)
    count = int(np.argmax(left_out <= _TERMS_TOLERANCE)) + 1
    gains = singular[:count] / sum(singular[k] * u[:, k].sum() * vt[k].sum() for k in range(count))
    return tuple(SeparableTerm(u[:, k] * gains[k], vt[k]) for k in range(count))


def spline_transfer(freq_cy_per_px: FloatArray) -> FloatArray:
    """Transfer function of the quintic B-spline sampled at the pixels (1, 26, 66, 26, 1)/120."""
    angle = 2 * np.pi * freq_cy_per_px
    return np.asarray((33 + 26 * np.cos(angle) + np.cos(2 * angle)) / 60)


def _transform_size(sigma_px: float) -> int:
    """Length of the transform, long enough that the kernel does not reach its periodic copy."""
    return int(2 ** np.ceil(np.log2(max(512.0, 24 * sigma_px))))


def _cut_radius(half_kernel: FloatArray, sigma_px: float, tail_tolerance: float) -> int:
    above = np.flatnonzero(np.abs(half_kernel) > tail_tolerance)
    return max(int(above[-1]) + 1, ceil(_CUT_SIGMAS * sigma_px))
