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
from simulation.pose.six_by_six import READ_PX, weighted_six_by_six

BORDER_PX = 0.5 + 1e-6
"""How far outside the outermost pixel centres a position still counts as inside."""

REACH_BEFORE_PX, REACH_AFTER_PX = 3, READ_PX - 3
"""Coefficients on either side of a position that are read: before it 3, after it 3 that have a
weight and those that are read with them."""

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
    ``size`` are the rows and columns of the whole reference, ``table`` the weights of the sampling
    kernel by `weight_table`, in the dtype of the coefficients.
    """

    coefficients: FloatImage
    origin: tuple[int, int]
    size: tuple[int, int]
    table: FloatImage


class Canvas(NamedTuple):
    """One plane of the follow-up to write to, and its masks, all of one shape.

    Where the follow-up looks past the reference, its image is left as it was; it is not nearer.
    """

    image: FloatImage
    nearer: BoolArray
    outside: BoolArray


# Sums may be reordered, which vectorises them; NaN and infinity keep their meaning.
_FREE_ORDER = {"fastmath": {"reassoc", "contract", "nsz"}, "nogil": True}


@compiled(**_FREE_ORDER)
def render(
    view: BlurredWarp,
    window: CoefficientWindow,
    canvas: Canvas,
    first: tuple[int, int],
    shape: tuple[int, int],
) -> None:
    """Write a tile of the follow-up, whose first pixel is ``first``; both as (row, col).

    A missing variance below ``-NEARER_TOLERANCE_PX2`` marks it ``nearer``.
    """
    coefficients, origin, size, table = window
    image, nearer, outside = canvas
    left = first[1]
    places = np.empty((3, shape[1]))
    room = np.empty((8, shape[1]), coefficients.dtype)
    corners = np.empty(shape[1], np.int64)
    x, y = places[0], places[1]  # unpacked, they would count as strided
    for i in range(shape[0]):
        row = first[0] + i
        gone, near = outside[row, left : left + shape[1]], nearer[row, left : left + shape[1]]
        _mark_row(view, (row, left), size, places, (gone, near))
        start, stop = 0, shape[1]
        while start < stop and gone[start]:
            start += 1
        while start < stop and gone[stop - 1]:
            stop -= 1
        if start < stop:
            _sample_row(
                coefficients,
                (x[start:stop], origin[1], y[start:stop], origin[0]),
                (room[:, : stop - start], corners[: stop - start], table),
                gone[start:stop],
                image[row, left + start : left + stop],
            )


@compiled(**_FREE_ORDER)
def mark(
    view: BlurredWarp,
    size: tuple[int, int],
    canvas: Canvas,
    first: tuple[int, int],
    shape: tuple[int, int],
) -> None:
    """Write the masks of a tile as `render` does; ``size`` is the whole reference's."""
    _, nearer, outside = canvas
    left = first[1]
    places = np.empty((3, shape[1]))
    for row in range(first[0], first[0] + shape[0]):
        gone, near = outside[row, left : left + shape[1]], nearer[row, left : left + shape[1]]
        _mark_row(view, (row, left), size, places, (gone, near))


@compiled_part(**_FREE_ORDER)
def _mark_row(
    view: BlurredWarp,
    first: tuple[int, int],
    size: tuple[int, int],
    places: FloatArray,
    masks: tuple[BoolArray, BoolArray],
) -> None:
    """Fill in the places of a row's pixels, and where they are outside and nearer."""
    _place_row(view, first[0], first[1], places)
    gone, near = masks
    x, y, least = places[0], places[1], places[2]  # unpacked, they would count as strided
    right, bottom = size[1] - 1 + BORDER_PX, size[0] - 1 + BORDER_PX
    for j in range(len(x)):
        # Without short cuts, which would keep it from being done in vectors.
        is_inside = (x[j] >= -BORDER_PX) & (x[j] <= right) & (y[j] >= -BORDER_PX) & (y[j] <= bottom)
        gone[j] = not is_inside
        near[j] = is_inside & (least[j] < -NEARER_TOLERANCE_PX2)


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
def _put_weights(part: FloatImage, table: FloatImage, out: FloatImage) -> None:
    """Weights of the six rows around every position, shape (6, n)."""
    for m in range(6):
        c0, c1, c2 = table[0, m], table[1, m], table[2, m]
        c3, c4, c5 = table[3, m], table[4, m], table[5, m]
        weight = out[m]
        for j in range(len(part)):
            t = part[j]
            weight[j] = c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5))))


@compiled_part(**_FREE_ORDER)
def _sample_row(
    coefficients: FloatImage,
    places: tuple[FloatArray, int, FloatArray, int],
    scratch: tuple[FloatImage, IntArray, FloatImage],
    outside: BoolArray,
    out: FloatImage,
) -> None:
    """Write the image at reference positions, except where they are outside.

    ``places`` are x and y, each with the origin of the coefficients; ``scratch`` has room for 8
    numbers and an index for every position, and the table of weights.
    """
    x, left, y, top = places
    room, corners, table = scratch
    stride, pixels = coefficients.shape[1], coefficients.reshape(-1)
    part_x, part_y = room[6], room[7]
    for j in range(len(out)):
        col, row = np.floor(x[j]), np.floor(y[j])
        corners[j] = (int(row) - 2 - top) * stride + int(col) - 2 - left
        part_x[j], part_y[j] = x[j] - col, y[j] - row
    _put_weights(part_y, table, room)
    v0, v1, v2, v3, v4, v5 = room[0], room[1], room[2], room[3], room[4], room[5]
    for j in range(len(out)):
        if not outside[j]:
            down = v0[j], v1[j], v2[j], v3[j], v4[j], v5[j]
            out[j] = weighted_six_by_six(pixels, (corners[j], stride), down, table, part_x[j])
