"""Sampling the filtered reference along a warp; compiled.

Along a row of the follow-up the warp is evaluated every few pixels and interpolated by cubics
between, which is exact to 1e-6 px wherever its derivative changes slowly; elsewhere, and where the
sharper of the two images is in doubt, every pixel is evaluated. Measured by
``benchmarks/bench_pose.py``.
"""

from typing import NamedTuple

import numpy as np

from simulation.arrays import BoolArray, FloatArray, FloatImage, IntArray
from simulation.compiled import compiled, compiled_part
from simulation.pose.missing_blur import NEARER_TOLERANCE_PX2, BlurredWarp, surveyed

BORDER_PX = 0.5 + 1e-6
"""How far outside the outermost pixel centres a position still counts as inside."""

KERNEL_REACH_PX = 3
"""Coefficients on either side of a position."""

_BLOCK_PX = 32
"""Longest piece of a row that is interpolated; it is halved until its cubic is nearly straight."""

_LEAST_BLOCK_PX = 4
"""Shorter pieces are evaluated pixel by pixel."""

_CUBIC_PX = 0.01
"""Largest cubic part of a piece. What a cubic leaves is less by the piece over the distance on
which the warp changes, and by 16: below 1e-5 px for a tilt, 3e-4 px for a frame of 100 px that is
distorted by 5 %."""

_DOUBT = 2.0
"""Changes of the least eigenvalue over a piece within which its sign is not interpolated."""


class CoefficientWindow(NamedTuple):
    """A part of the filtered reference, including what is beyond its border.

    Element (0, 0) of ``coefficients`` belongs to the reference pixel ``origin`` (row, col);
    ``size`` are the rows and columns of the whole reference, ``pieces`` those of the sampling
    kernel in the dtype of the coefficients, shape (3, 6).
    """

    coefficients: FloatImage
    origin: tuple[int, int]
    size: tuple[int, int]
    pieces: FloatImage


class Tile(NamedTuple):
    """A part of the follow-up; where it looks past the reference, 0 and not nearer."""

    image: FloatImage
    nearer: BoolArray
    outside: BoolArray


# Sums may be reordered, which vectorises them; NaN and infinity keep their meaning.
_FREE_ORDER = {"fastmath": {"reassoc", "contract", "nsz"}, "nogil": True}


@compiled(**_FREE_ORDER)
def render(
    view: BlurredWarp, window: CoefficientWindow, first: tuple[int, int], shape: tuple[int, int]
) -> Tile:
    """Tile of the follow-up whose first pixel is ``first``, both as (row, col).

    A missing variance below ``-NEARER_TOLERANCE_PX2`` marks it ``nearer``.
    """
    coefficients, origin, size, pieces = window
    image = np.zeros(shape, coefficients.dtype)
    nearer, outside = np.zeros(shape, np.bool_), np.ones(shape, np.bool_)
    places = np.empty((3, shape[1]))
    weights = np.empty((12, shape[1]), coefficients.dtype)
    corners = np.empty(shape[1], np.int64)
    x, y, least = places[0], places[1], places[2]  # unpacked, they would count as strided
    right, bottom = size[1] - 1 + BORDER_PX, size[0] - 1 + BORDER_PX
    for i in range(shape[0]):
        _place_row(view, first[0] + i, first[1], places)
        start, stop = shape[1], 0
        for j in range(shape[1]):
            if -BORDER_PX <= x[j] <= right and -BORDER_PX <= y[j] <= bottom:
                outside[i, j] = False
                nearer[i, j] = least[j] < -NEARER_TOLERANCE_PX2
                start, stop = min(start, j), j + 1
        if start < stop:
            _sample_row(
                coefficients,
                (x[start:stop], origin[1], y[start:stop], origin[0]),
                (weights[:, : stop - start], corners[: stop - start], pieces),
                outside[i, start:stop],
                image[i, start:stop],
            )
    return Tile(image, nearer, outside)


@compiled_part(**_FREE_ORDER)
def _place_row(view: BlurredWarp, row: int, first: int, places: FloatArray) -> None:
    """Fill in positions x, y and the least eigenvalues of the missing blur for a row's pixels."""
    matrix, lens, psf, frame = view
    x, y, least = places[0], places[1], places[2]  # unpacked, they would count as strided
    count = len(x)
    x0, y0, a0, c0, least0 = surveyed(matrix, lens, psf, frame, first, row)
    start, length = 0, _BLOCK_PX
    while start < count:
        length = min(length, count - start)
        x1, y1, a1, c1, least1 = surveyed(matrix, lens, psf, frame, first + start + length, row)
        mean_x, mean_y = (x1 - x0) / length, (y1 - y0) / length
        skew_x, skew_y = a0 + a1 - 2 * mean_x, c0 + c1 - 2 * mean_y
        # Written so that infinite positions are not straight.
        is_straight = length * (abs(skew_x) + abs(skew_y)) <= _CUBIC_PX
        if not is_straight and length > _LEAST_BLOCK_PX:
            length = length // 2
            continue
        is_sure = min(
            abs(least0 + NEARER_TOLERANCE_PX2), abs(least1 + NEARER_TOLERANCE_PX2)
        ) >= _DOUBT * abs(least1 - least0)
        if is_straight and is_sure:
            bend_x, bend_y = (mean_x - a0 - skew_x) / length, (mean_y - c0 - skew_y) / length
            skew_x, skew_y = skew_x / length**2, skew_y / length**2
            to_x, to_y = x[start : start + length], y[start : start + length]
            for k in range(length):
                t = np.float64(np.int32(k))
                to_x[k] = x0 + t * (a0 + t * (bend_x + t * skew_x))
                to_y[k] = y0 + t * (c0 + t * (bend_y + t * skew_y))
            least[start : start + length] = least0
        else:
            for k in range(start, start + length):
                x[k], y[k], _, _, least[k] = surveyed(matrix, lens, psf, frame, first + k, row)
        x0, y0, a0, c0, least0 = x1, y1, a1, c1, least1
        start, length = start + length, min(2 * length, _BLOCK_PX)


@compiled_part(**_FREE_ORDER)
def _put_weights(fraction: FloatImage, pieces: FloatImage, out: FloatImage) -> None:
    """Sampling kernel at ``t + 2 ... t - 3`` for every t from 0 to 1, shape (6, n)."""
    a0, a1, a2 = pieces[2, 0], pieces[2, 1], pieces[2, 2]
    a3, a4, a5 = pieces[2, 3], pieces[2, 4], pieces[2, 5]
    b0, b1, b2 = pieces[1, 0], pieces[1, 1], pieces[1, 2]
    b3, b4, b5 = pieces[1, 3], pieces[1, 4], pieces[1, 5]
    one = fraction.dtype.type(1)
    w0, w1, w2, w3, w4, w5 = out[0], out[1], out[2], out[3], out[4], out[5]
    for j in range(len(fraction)):
        t = fraction[j]
        s = one - t
        first = a0 + t * (a1 + t * (a2 + t * (a3 + t * (a4 + t * a5))))
        second = b0 + t * (b1 + t * (b2 + t * (b3 + t * (b4 + t * b5))))
        fifth = b0 + s * (b1 + s * (b2 + s * (b3 + s * (b4 + s * b5))))
        last = a0 + s * (a1 + s * (a2 + s * (a3 + s * (a4 + s * a5))))
        # The middle two make constants and ramps exact.
        fourth = t + (first + first + second) - (fifth + fifth) - (last + last + last)
        w0[j], w1[j], w4[j], w5[j] = first, second, fifth, last
        w2[j], w3[j] = one - (first + second) - (fifth + last) - fourth, fourth


@compiled_part(**_FREE_ORDER)
def _sample_row(
    coefficients: FloatImage,
    places: tuple[FloatArray, int, FloatArray, int],
    scratch: tuple[FloatImage, IntArray, FloatImage],
    outside: BoolArray,
    out: FloatImage,
) -> None:
    """Write the image at reference positions, except where they are outside.

    ``places`` are x and y, each with the origin of the coefficients; ``scratch`` has room for 12
    weights and an index for every position, and the sampling kernel's pieces.
    """
    x, left, y, top = places
    weights, corners, pieces = scratch
    stride, pixels = coefficients.shape[1], coefficients.reshape(-1)
    # The fractions are written where the last weights will be.
    part_x, part_y = weights[5], weights[11]
    for j in range(len(out)):
        col, row = np.floor(x[j]), np.floor(y[j])
        corners[j] = (int(row) - 2 - top) * stride + int(col) - 2 - left
        part_x[j], part_y[j] = x[j] - col, y[j] - row
    _put_weights(part_x, pieces, weights[:6])
    _put_weights(part_y, pieces, weights[6:])
    w0, w1, w2, w3, w4, w5 = weights[0], weights[1], weights[2], weights[3], weights[4], weights[5]
    v0, v1, v2, v3, v4, v5 = (
        weights[6],
        weights[7],
        weights[8],
        weights[9],
        weights[10],
        weights[11],
    )
    for j in range(len(out)):
        if outside[j]:
            continue
        along = w0[j], w1[j], w2[j], w3[j], w4[j], w5[j]
        i = corners[j]
        upper = v0[j] * _dot(pixels, i, along)
        middle = v1[j] * _dot(pixels, i + stride, along)
        lower = v2[j] * _dot(pixels, i + 2 * stride, along)
        upper += v3[j] * _dot(pixels, i + 3 * stride, along)
        middle += v4[j] * _dot(pixels, i + 4 * stride, along)
        lower += v5[j] * _dot(pixels, i + 5 * stride, along)
        out[j] = upper + middle + lower


@compiled_part(**_FREE_ORDER, forceinline=True)
def _dot(
    pixels: FloatImage, i: int, along: tuple[float, float, float, float, float, float]
) -> float:
    a0, a1, a2, a3, a4, a5 = along
    value: float = (
        (pixels[i] * a0 + pixels[i + 1] * a1)
        + (pixels[i + 2] * a2 + pixels[i + 3] * a3)
        + (pixels[i + 4] * a4 + pixels[i + 5] * a5)
    )
    return value
