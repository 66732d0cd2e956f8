"""Resampling and blurring along one axis, as banded matrices.

The border is mirrored at the image's edge (``d c b a | a b c d | d c b a``, the ``reflect`` of
``scipy.ndimage``), except for Pillow's antialiased cubic, which omits what is outside and
normalises the rest.
"""

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.resampling.banded import BandedMatrix

_KEYS_A = -0.5
"""Slope parameter of Pillow's BICUBIC (Resample.c) and of R. G. Keys, 1981."""


def antialiased_cubic(positions_px: FloatArray, zoom: float, size: int) -> BandedMatrix:
    """Pillow's ``resize(..., BICUBIC, box=...)`` along one axis.

    Parameters
    ----------
    positions_px
        Input coordinates of the outputs, spaced by ``zoom``.
    zoom
        Input pixels per output pixel; the cubic is widened by it if it is above 1.
    size
        Pixels of the input.

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
    """Convolution with a kernel of odd length, mirrored at the border.

    Parameters
    ----------
    kernel
        Centre at 0 px.
    size
        Pixels along the axis.
    """
    return blur_at(np.arange(size), kernel, size)[0]


def blur_at(pixels: IntArray, kernel: FloatArray, size: int) -> tuple[BandedMatrix, slice]:
    """Convolution at pixels in and around the mirrored image, and the pixels that it reads."""
    radius = len(kernel) // 2
    # Output i takes kernel[radius + offset] from input i - offset.
    column = _mirrored(pixels[:, None] - np.arange(-radius, radius + 1), size)
    first, last = int(column.min()), int(column.max()) + 1
    weights = np.broadcast_to(kernel, column.shape)
    return _from_taps(column - first, weights, last - first), slice(first, last)


def spline_sampling(positions_px: FloatArray, prefilter: FloatArray, size: int) -> BandedMatrix:
    """Blur, and point-sample the quintic spline through the blurred pixels, in one matrix.

    Parameters
    ----------
    positions_px
        Input coordinates of the outputs.
    prefilter
        Kernel from pixels to spline coefficients, including the blur; odd length.
    size
        Pixels of the input.

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
    """Rows of weights at columns ``starts`` and following of an image mirrored at its edges.

    Parameters
    ----------
    starts
        First column of each row, shape ``(n,)``; it may lie outside the image.
    weights
        Shape ``(n, taps)``.
    size
        Pixels of the image.
    """
    return _from_taps(_mirrored(starts[:, None] + np.arange(weights.shape[1]), size), weights, size)


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
