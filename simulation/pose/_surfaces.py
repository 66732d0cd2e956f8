"""Which point of a depth map each pixel of a follow-up sees; compiled.

Neighbouring pixels of the reference belong to one surface unless their depths part: then what lies
between them was hidden from the reference. Surfaces are drawn as triangles between pixel centres,
and along their rims to half a pixel beyond the outermost; of several, the nearest is seen. A pixel
on which nothing is drawn sees what the reference did not.
"""

from math import ceil, floor, hypot, isnan, sqrt
from typing import NamedTuple

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.compiled import compiled, compiled_part
from simulation.pose._warp import ideal_factor, seen_factor
from simulation.pose.depth import DepthView

_STEP_PX = 0.5
"""Parallax between two pixels beyond that of the slope on either side, from which on they are of
two surfaces: half a pixel of the follow-up is hidden between them."""

_STEEPEST_PX = 1.5
"""The same, whatever the slope: seen by one photograph at a grazing angle, by the other from
behind or stretched by more than that."""

_SLACK = 1e-9


class Sight(NamedTuple):
    """A view as compiled functions take it; see `DepthView`."""

    plane: FloatArray
    pupil: FloatArray
    base: FloatArray
    lens: FloatArray


class SeenPoints(NamedTuple):
    """What the follow-up's pixels see, shape ``(rows, cols)`` each.

    ``x, y``: reference positions, NaN where nothing is seen. ``closeness``: inverse depth in the
    follow-up, in the depth map's unit; 0 there.
    """

    x: FloatArray
    y: FloatArray
    closeness: FloatArray


def sight_of(view: DepthView) -> Sight:
    """The view as compiled functions take it."""
    return Sight(view.plane, view.pupil, view.base, view.lens)


@compiled_part()
def _placed(sight: Sight, col: float, row: float, inverse: float) -> tuple[float, float, float]:
    """Position (x, y) in the follow-up and depth there over that in the reference."""
    plane, pupil, base, lens = sight
    k1 = lens[0]
    x, y = col, row
    if k1 != 0:
        dx, dy = x - lens[3], y - lens[4]
        factor = ideal_factor(k1 * (dx * dx + dy * dy), 0.0)
        x, y = lens[3] + factor * dx, lens[4] + factor * dy
    beside = inverse - (base[0] * x + base[1] * y + base[2])
    depth = plane[2, 0] * x + plane[2, 1] * y + plane[2, 2] + pupil[2] * beside
    to_x = (plane[0, 0] * x + plane[0, 1] * y + plane[0, 2] + pupil[0] * beside) / depth
    to_y = (plane[1, 0] * x + plane[1, 1] * y + plane[1, 2] + pupil[1] * beside) / depth
    if k1 != 0:
        dx, dy = to_x - lens[1], to_y - lens[2]
        factor = seen_factor(k1, 0.0, dx * dx + dy * dy, hypot(lens[1] + 1, lens[2] + 1))
        to_x, to_y = lens[1] + factor * dx, lens[2] + factor * dy
    return to_x, to_y, depth


@compiled_part()
def _parts(
    sight: Sight, col: float, row: float, inverses: tuple[float, float, float, float]
) -> bool:
    """Whether the second of four pixels in a row and the third are of two surfaces.

    The others tell the slopes on either side, where they are known.
    """
    before, one, other, after = inverses
    step = other - one
    if step == 0:
        return False
    x, y, _ = _placed(sight, col, row, one)
    to_x, to_y, _ = _placed(sight, col, row, other)
    parallax = hypot(to_x - x, to_y - y)
    if parallax > _STEEPEST_PX:
        return True
    left = abs(step - (one - before)) if not isnan(before) else abs(step)
    right = abs(step - (after - other)) if not isnan(after) else abs(step)
    return parallax * min(left, right) > _STEP_PX * abs(step)


@compiled(nogil=True)
def parted(sight: Sight, inverse: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Whether pixels and their right and lower neighbours are of two surfaces.

    ``inverse``: inverse depth, shape ``(rows, cols)``, NaN where it is not known. The results have
    that shape; True in the last column and in the last row.
    """
    rows, cols = inverse.shape
    right, below = np.ones((rows, cols), np.bool_), np.ones((rows, cols), np.bool_)
    for i in range(rows):
        for j in range(cols):
            own = inverse[i, j]
            if isnan(own):
                continue
            if j + 1 < cols and not isnan(inverse[i, j + 1]):
                before = inverse[i, j - 1] if j > 0 else np.nan
                after = inverse[i, j + 2] if j + 2 < cols else np.nan
                right[i, j] = _parts(sight, j, i, (before, own, inverse[i, j + 1], after))
            if i + 1 < rows and not isnan(inverse[i + 1, j]):
                before = inverse[i - 1, j] if i > 0 else np.nan
                after = inverse[i + 2, j] if i + 2 < rows else np.nan
                below[i, j] = _parts(sight, j, i, (before, own, inverse[i + 1, j], after))
    return right, below


@compiled(nogil=True)
def slopes_of(
    inverse: FloatArray, right: BoolArray, below: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Slopes of the inverse depth along x and y, within each surface; 0 where none is known."""
    rows, cols = inverse.shape
    along_x, along_y = np.zeros((rows, cols)), np.zeros((rows, cols))
    for i in range(rows):
        for j in range(cols):
            total, count = 0.0, 0
            if not right[i, j]:
                total, count = inverse[i, j + 1] - inverse[i, j], 1
            if j > 0 and not right[i, j - 1]:
                total, count = total + inverse[i, j] - inverse[i, j - 1], count + 1
            along_x[i, j] = total / max(count, 1)
            total, count = 0.0, 0
            if not below[i, j]:
                total, count = inverse[i + 1, j] - inverse[i, j], 1
            if i > 0 and not below[i - 1, j]:
                total, count = total + inverse[i, j] - inverse[i - 1, j], count + 1
            along_y[i, j] = total / max(count, 1)
    return along_x, along_y


_Corner = tuple[float, float, float, float, float]
"""Follow-up position x, y, inverse depth there, and reference position x, y."""


@compiled_part()
def _draw(seen: SeenPoints, one: _Corner, two: _Corner, three: _Corner) -> None:
    """Draw a triangle where it is nearer than what is drawn, unless it is seen from behind."""
    x, y, closeness = seen
    rows, cols = closeness.shape
    ax, ay = two[0] - one[0], two[1] - one[1]
    bx, by = three[0] - one[0], three[1] - one[1]
    area = ax * by - ay * bx
    if not area > _SLACK:
        return
    top = max(ceil(min(one[1], two[1], three[1]) - _SLACK), 0)
    bottom = min(floor(max(one[1], two[1], three[1]) + _SLACK), rows - 1)
    left = max(ceil(min(one[0], two[0], three[0]) - _SLACK), 0)
    right = min(floor(max(one[0], two[0], three[0]) + _SLACK), cols - 1)
    for i in range(top, bottom + 1):
        for j in range(left, right + 1):
            dx, dy = j - one[0], i - one[1]
            s, t = (dx * by - dy * bx) / area, (ax * dy - ay * dx) / area
            if s < -_SLACK or t < -_SLACK or s + t > 1 + _SLACK:
                continue
            near = one[2] + s * (two[2] - one[2]) + t * (three[2] - one[2])
            if near > closeness[i, j]:
                closeness[i, j] = near
                x[i, j] = one[3] + s * (two[3] - one[3]) + t * (three[3] - one[3])
                y[i, j] = one[4] + s * (two[4] - one[4]) + t * (three[4] - one[4])


@compiled_part()
def _corner(sight: Sight, col: float, row: float, inverse: float) -> _Corner:
    to_x, to_y, depth = _placed(sight, col, row, inverse)
    if not depth > 0:  # behind the camera
        return np.nan, np.nan, np.nan, col, row
    return to_x, to_y, inverse / depth, col, row


@compiled_part()
def _draw_cell(seen: SeenPoints, one: _Corner, two: _Corner, three: _Corner, four: _Corner) -> None:
    """Draw a quadrangle, its corners from above left clockwise."""
    if isnan(one[0] + two[0] + three[0] + four[0]):
        return
    _draw(seen, one, two, three)
    _draw(seen, one, three, four)


@compiled(nogil=True)
def seen_points(
    sight: Sight,
    inverse: FloatArray,
    parts: tuple[BoolArray, BoolArray],
    slopes: tuple[FloatArray, FloatArray],
    follow_up: tuple[int, int],
) -> SeenPoints:
    """Draw a depth map, as ``parted`` and ``slopes_of`` describe it; frame ``(rows, cols)``."""
    (right, below), (along_x, along_y) = parts, slopes
    x, y = np.full(follow_up, np.nan), np.full(follow_up, np.nan)
    seen = SeenPoints(x, y, np.zeros(follow_up))
    rows, cols = inverse.shape
    for i in range(-1, rows):
        for j in range(-1, cols):
            is_whole = (
                0 <= i < rows - 1
                and 0 <= j < cols - 1
                and not (right[i, j] or right[i + 1, j] or below[i, j] or below[i, j + 1])
            )
            if is_whole:
                _draw_cell(
                    seen,
                    _corner(sight, j, i, inverse[i, j]),
                    _corner(sight, j + 1, i, inverse[i, j + 1]),
                    _corner(sight, j + 1, i + 1, inverse[i + 1, j + 1]),
                    _corner(sight, j, i + 1, inverse[i + 1, j]),
                )
                continue
            for row in range(max(i, 0), min(i + 2, rows)):
                for col in range(max(j, 0), min(j + 2, cols)):
                    own = inverse[row, col]
                    if isnan(own):
                        continue
                    slope = along_x[row, col], along_y[row, col]
                    _draw_rim(seen, sight, (col, row, own), slope, (j + 0.5, i + 0.5))
    return seen


@compiled_part()
def _draw_rim(
    seen: SeenPoints,
    sight: Sight,
    pixel: tuple[int, int, float],
    slope: tuple[float, float],
    middle: tuple[float, float],
) -> None:
    """Draw a quarter of a pixel, between its centre and the middle of a cell, on its surface."""
    col, row, own = pixel
    low_x, high_x = min(float(col), middle[0]), max(float(col), middle[0])
    low_y, high_y = min(float(row), middle[1]), max(float(row), middle[1])
    left, right = (low_x - col) * slope[0], (high_x - col) * slope[0]
    up, down = (low_y - row) * slope[1], (high_y - row) * slope[1]
    _draw_cell(
        seen,
        _corner(sight, low_x, low_y, own + left + up),
        _corner(sight, high_x, low_y, own + right + up),
        _corner(sight, high_x, high_y, own + right + down),
        _corner(sight, low_x, high_y, own + left + down),
    )


@compiled(nogil=True)
def local_slopes(
    sight: Sight, points: FloatArray, inverse: FloatArray, slopes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Follow-up positions ``(n, 2)`` of reference pixels, and the derivative of the way back.

    ``points``: shape (n, 2), order (x, y); ``inverse``: of their inverse depths, shape (n,), with
    their slopes, shape (n, 2). The derivative is that of the reference's position by the
    follow-up's, shape (n, 2, 2); NaN where the surface is seen from behind.
    """
    places, found = np.empty_like(points), np.full((len(points), 2, 2), np.nan)
    for k in range(len(points)):
        x, y, own = points[k, 0], points[k, 1], inverse[k]
        dx, dy = slopes[k, 0] / 2, slopes[k, 1] / 2
        places[k, 0], places[k, 1], depth = _placed(sight, x, y, own)
        ax, ay, _ = _placed(sight, x + 0.5, y, own + dx)
        bx, by, _ = _placed(sight, x - 0.5, y, own - dx)
        cx, cy, _ = _placed(sight, x, y + 0.5, own + dy)
        ex, ey, _ = _placed(sight, x, y - 0.5, own - dy)
        a, b, c, d = ax - bx, cx - ex, ay - by, cy - ey
        area = a * d - b * c
        if depth > 0 and area > sqrt(_SLACK):
            found[k, 0, 0], found[k, 0, 1] = d / area, -b / area
            found[k, 1, 0], found[k, 1, 1] = -c / area, a / area
    return places, found
