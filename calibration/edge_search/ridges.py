"""Ridges of an image's gradient, grouped into regions of one direction, each with its line.

The loops are compiled: an image has hundreds of regions of a hundred pixels each, and numpy's cost
per call would be most of the time. ``benchmarks/bench_edge_fit.py`` shows what that gains.
"""

from dataclasses import dataclass
from math import atan2, cos, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from calibration.edge_search.gradient import Gradient, RidgePixels
from calibration.edge_search.segments import ROUNDED_PX, EdgeLine
from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray
from simulation.compiled import compiled, compiled_part

SHORTEST_REGION_PX = 8
_NOISE_MEAN, _NOISE_SOLID = 4.0, 8.0  # of a region's mean gradient
_DIRECTION_COSINE = cos(pi / 8)
_SMALLEST_NEIGHBOUR_PX, _FAINT_NEIGHBOUR_PX = 6, 16
_LARGEST_SAGITTA = 0.02  # of the length: a bend the fit's curvature takes up
_ROUGHEST_PX = 0.7  # rms distance of the ridge from its line
_LINE_BAND_PX = 1.5  # a ridge's pixels are nearer to its line
_LINE_ROUNDS = 3


class ArtefactGradient(NamedTuple):
    """Gradient of the smoothed image that a compression makes by itself, in DN per px.

    ``dn_per_px`` is that at each of ``levels_dn``, which rise; shape ``(n,)`` both.
    """

    levels_dn: FloatArray
    dn_per_px: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Ridges:
    """Lines through the ridges of an image, and the ridge pixels.

    ``lines`` has a row per straight region: middle x and y (px), angle of the normal from the
    dark to the bright side (rad) and length (px). ``points`` holds x and y of all ridge pixels
    except specks of noise, from top to bottom, as ``pixels`` holds all.
    """

    lines: FloatArray
    points: FloatArray
    pixels: RidgePixels


def find_ridges(
    gradient: Gradient, image_dn: FloatArray, artefacts: ArtefactGradient | None = None
) -> Ridges:
    """Group the ridge pixels into regions and put a line through each that is no artefact."""
    found = gradient.ridge
    height = image_dn.shape[0]
    is_strong = found.strength >= gradient.high
    pixels = found.where(
        _beside_strong(found.rows, found.cols, _first_of(found, height), is_strong)
    )
    members, starts = _regions(
        pixels.rows, pixels.cols, _first_of(pixels, height), pixels.x, pixels.y
    )
    sizes = np.diff(starts)
    if sizes.size == 0:
        return Ridges(np.empty((0, 4)), np.empty((0, 2)), pixels)
    level_dn = image_dn[pixels.rows[members], pixels.cols[members]]
    level_dn = np.add.reduceat(level_dn, starts[:-1]) / sizes
    noise = gradient.noise[np.searchsorted(gradient.levels_dn, level_dn, side="right")]
    strength = np.add.reduceat(pixels.strength[members], starts[:-1]) / sizes
    least = np.zeros(sizes.size)
    if artefacts is not None:
        least = np.interp(level_dn, artefacts.levels_dn, artefacts.dn_per_px) / gradient.span_dn
    is_real = strength >= np.maximum(_NOISE_MEAN * noise, least)
    gradient_of = pixels.x, pixels.y, pixels.shift
    lines = _lines(pixels.rows, pixels.cols, gradient_of, members, starts, is_real)
    # Noise beside a faint edge makes short, faint ridges; only what is neither spoils a fit.
    is_solid = (sizes >= _SMALLEST_NEIGHBOUR_PX) & (strength >= _NOISE_SOLID * noise)
    is_solid &= strength >= least
    is_solid |= (sizes >= _FAINT_NEIGHBOUR_PX) & is_real
    solid = np.sort(members[np.repeat(is_solid, sizes)])
    points = np.column_stack([pixels.cols[solid], pixels.rows[solid]]).astype(np.float64)
    return Ridges(lines, points, pixels)


def _first_of(pixels: RidgePixels, height: int) -> IntArray:
    """Index of the first pixel of each row, and the number of all."""
    return np.searchsorted(pixels.rows, np.arange(height + 1))


@compiled_part()
def _first_near(cols: IntArray, first_of: IntArray, row: int, col: int) -> tuple[int, int]:
    """First index in a row that is not left of ``col``, and the row's end."""
    if row < 0 or row >= len(first_of) - 1:
        return 0, 0
    low, end = first_of[row], first_of[row + 1]
    high = end
    while low < high:
        middle = (low + high) // 2
        if cols[middle] < col:
            low = middle + 1
        else:
            high = middle
    return low, end


@compiled()
def _beside_strong(
    rows: IntArray, cols: IntArray, first_of: IntArray, is_strong: BoolArray
) -> BoolArray:
    """Which pixels are strong or connected with one that is (Canny's hysteresis)."""
    kept = is_strong.copy()
    waiting = np.empty(len(rows), np.int64)
    count = 0
    for i in range(len(rows)):
        if is_strong[i]:
            waiting[count] = i
            count += 1
    while count:
        count -= 1
        i = waiting[count]
        for row in range(rows[i] - 1, rows[i] + 2):
            j, end = _first_near(cols, first_of, row, cols[i] - 1)
            while j < end and cols[j] <= cols[i] + 1:
                if not kept[j]:
                    kept[j] = True
                    waiting[count] = j
                    count += 1
                j += 1
    return kept


@compiled()
def _regions(
    rows: IntArray, cols: IntArray, first_of: IntArray, gx: Float32Array, gy: Float32Array
) -> tuple[IntArray, IntArray]:
    """Connected ridge pixels whose gradient stays near the direction of the region's sum.

    Returns their indices, region by region, and where each region starts.
    """
    total = len(rows)
    taken = np.zeros(total, np.bool_)
    members = np.empty(total, np.int64)
    starts = np.empty(total + 1, np.int64)
    filled = count = 0
    for seed in range(total):
        if taken[seed]:
            continue
        starts[count] = filled
        count += 1
        taken[seed] = True
        members[filled] = seed
        looked_at = filled
        filled += 1
        sum_x = sum_y = 0.0
        while looked_at < filled:
            i = members[looked_at]
            looked_at += 1
            norm = max(sqrt(gx[i] ** 2 + gy[i] ** 2), 1e-30)
            sum_x += gx[i] / norm
            sum_y += gy[i] / norm
            for row in range(rows[i] - 1, rows[i] + 2):
                j, end = _first_near(cols, first_of, row, cols[i] - 1)
                while j < end and cols[j] <= cols[i] + 1:
                    if not taken[j]:
                        x, y = gx[j], gy[j]
                        along = x * sum_x + y * sum_y
                        norms = (x * x + y * y) * (sum_x * sum_x + sum_y * sum_y)
                        if along > 0 and along * along >= _DIRECTION_COSINE**2 * norms:
                            taken[j] = True
                            members[filled] = j
                            filled += 1
                    j += 1
    starts[count] = filled
    return members, starts[: count + 1]


@compiled()
def _lines(
    rows: IntArray,
    cols: IntArray,
    gradient: tuple[Float32Array, Float32Array, Float32Array],
    members: IntArray,
    starts: IntArray,
    is_real: BoolArray,
) -> FloatArray:
    """Lines of the straight ones of the regions; ``gradient`` is x, y and the ridge's shift."""
    lines = np.empty((len(starts), 4))
    count = 0
    for k in range(len(starts) - 1):
        first, last = starts[k], starts[k + 1]
        if last - first < SHORTEST_REGION_PX or not is_real[k]:
            continue
        line, is_straight = _line(rows, cols, gradient, members[first:last])
        if is_straight:
            for i in range(4):
                lines[count, i] = line[i]
            count += 1
    return lines[:count]


@compiled_part()
def _line(
    rows: IntArray,
    cols: IntArray,
    gradient: tuple[Float32Array, Float32Array, Float32Array],
    members: IntArray,
) -> tuple[tuple[float, float, float, float], bool]:
    """Line through a region's pixels: middle x, y, normal, length; whether they lie along it."""
    none = (0.0, 0.0, 0.0, 0.0)
    gx, gy, shifts = gradient
    n = len(members)
    x, y, weight = np.empty(n), np.empty(n), np.empty(n)
    sum_x = sum_y = 0.0
    for i in range(n):
        k = members[i]
        dx, dy = gx[k], gy[k]
        sum_x += dx
        sum_y += dy
        weight[i] = dx * dx + dy * dy
        x[i], y[i] = cols[k], rows[k]
        if abs(dx) >= abs(dy):
            x[i] += shifts[k]
        else:
            y[i] += shifts[k]
    normal = atan2(sum_y, sum_x)
    cx, cy = x.mean(), y.mean()
    kept, away = np.ones(n, np.bool_), np.empty(n)
    for _ in range(_LINE_ROUNDS):
        along, across = _projected(x, y, cx, cy, normal)
        slope, shift = _weighted_line(along, across, weight, kept)
        if not np.isfinite(slope):
            return none, False
        cx += shift * cos(normal)
        cy += shift * sin(normal)
        normal -= np.arctan(slope)
        # The ridge runs around a corner for its last pixels: they are not part of this line.
        for i in range(n):
            away[i] = abs(across[i] - slope * along[i] - shift)
        limit = max(_ROUGHEST_PX, 2.5 * np.median(away))
        for i in range(n):
            kept[i] = away[i] <= limit
    along, across = _projected(x, y, cx, cy, normal)
    along, across = along[kept], across[kept]
    if len(along) < max(SHORTEST_REGION_PX, 0.6 * n):
        return none, False
    low, high = along.min(), along.max()
    length = high - low
    if not _is_straight(along, across, length):
        # Pixels that turn with a corner within the distance kept above bend a short ridge.
        inner = 0
        for i in range(len(along)):
            if low + ROUNDED_PX <= along[i] <= high - ROUNDED_PX:
                along[inner], across[inner] = along[i], across[i]
                inner += 1
        if inner < SHORTEST_REGION_PX or not _is_straight(along[:inner], across[:inner], length):
            return none, False
    middle = 0.5 * (low + high)
    return (cx - middle * sin(normal), cy + middle * cos(normal), normal, length + 1), True


@compiled_part()
def _projected(
    x: FloatArray, y: FloatArray, cx: float, cy: float, normal: float
) -> tuple[FloatArray, FloatArray]:
    """Coordinates of points along a line and across it, from (cx, cy)."""
    c, s = cos(normal), sin(normal)
    along, across = np.empty(len(x)), np.empty(len(x))
    for i in range(len(x)):
        along[i] = -s * (x[i] - cx) + c * (y[i] - cy)
        across[i] = c * (x[i] - cx) + s * (y[i] - cy)
    return along, across


@compiled_part()
def _weighted_line(
    along: FloatArray, across: FloatArray, weight: FloatArray, kept: BoolArray
) -> tuple[float, float]:
    """Slope and value at 0 of the line through what is kept; NaN where that is too short."""
    w = wt = wa = wtt = wta = 0.0
    first, last, count = np.inf, -np.inf, 0
    for i in range(len(along)):
        if kept[i]:
            t, a = along[i], across[i]
            w += weight[i]
            wt += weight[i] * t
            wa += weight[i] * a
            wtt += weight[i] * t * t
            wta += weight[i] * t * a
            first, last, count = min(first, t), max(last, t), count + 1
    spread = w * wtt - wt * wt
    if count < SHORTEST_REGION_PX or last - first < SHORTEST_REGION_PX - 1 or not spread > 0:
        return np.nan, np.nan
    slope = (w * wta - wt * wa) / spread
    return slope, (wa - slope * wt) / w


@compiled_part()
def _is_straight(along: FloatArray, across: FloatArray, length: float) -> bool:
    """Whether points lie along a line so long with a bend that a fit takes up, and no more."""
    bend, rough = _parabola(along, across)
    sagitta = abs(bend) * length**2 / 4
    return bool(rough <= _ROUGHEST_PX and sagitta <= max(_LARGEST_SAGITTA * length, 0.5))


@compiled_part()
def _parabola(along: FloatArray, across: FloatArray) -> tuple[float, float]:
    """Second-order coefficient of the parabola through the points, and their rms distance."""
    scale = max(np.abs(along).max(), 1.0)
    mean, level = along.mean() / scale, across.mean()
    # Two more polynomials that are orthogonal over the points to the constant and to each other.
    linear, parabola = np.empty(len(along)), np.empty(len(along))
    squares = cubes = sloped = 0.0
    for i in range(len(along)):
        t = along[i] / scale - mean
        linear[i] = t
        squares += t * t
        cubes += t * t * t
        sloped += t * across[i]
    fourths = bent = 0.0
    for i in range(len(along)):
        parabola[i] = linear[i] * (linear[i] - cubes / squares) - squares / len(along)
        fourths += parabola[i] * parabola[i]
        bent += parabola[i] * across[i]
    rest = 0.0
    for i in range(len(along)):
        fitted = level + sloped / squares * linear[i] + bent / fourths * parabola[i]
        rest += (across[i] - fitted) ** 2
    return bent / fourths / scale**2, sqrt(rest / len(along))


@compiled()
def refined(
    rows: IntArray,
    cols: IntArray,
    gradient: tuple[Float32Array, Float32Array, Float32Array],
    line: EdgeLine,
) -> tuple[EdgeLine, float]:
    """Line through the gradient along a line, weighted with its square.

    Parameters
    ----------
    rows, cols
        Ridge pixels, from top to bottom.
    gradient
        Its x and y at them, and the moments across them, as in ``RidgePixels``.
    line
        Its approximate position.

    Returns
    -------
    line, variance
        Variance in px^2 of the squared gradient across the line; -1 where there is no gradient.
    """
    gx, gy, moments = gradient
    x_px, y_px, reach_px = line.x_px, line.y_px, line.half_length_px
    c, s = cos(line.normal_rad), sin(line.normal_rad)
    w = wt = wa = wtt = wta = waa = 0.0
    reach_x, reach_y = reach_px * abs(s) + 2, reach_px * abs(c) + 2
    for i in range(np.searchsorted(rows, int(y_px - reach_y)), len(rows)):
        if rows[i] > y_px + reach_y:
            break
        dx, dy = cols[i] - x_px, rows[i] - y_px
        if abs(dx) > reach_x:
            continue
        a, t = c * dx + s * dy, -s * dx + c * dy
        if abs(a) > _LINE_BAND_PX or abs(t) > reach_px or c * gx[i] + s * gy[i] <= 0:
            continue
        # A step along the axis nearer to the gradient goes so far across and along.
        step_a, step_t = (c, -s) if abs(gx[i]) >= abs(gy[i]) else (s, c)
        m0, m1, m2 = moments[i, 0], moments[i, 1], moments[i, 2]
        w += m0
        wt += m0 * t + m1 * step_t
        wa += m0 * a + m1 * step_a
        wtt += m0 * t * t + 2 * m1 * t * step_t + m2 * step_t * step_t
        wta += m0 * t * a + m1 * (t * step_a + a * step_t) + m2 * step_t * step_a
        waa += m0 * a * a + 2 * m1 * a * step_a + m2 * step_a * step_a
    spread = w * wtt - wt * wt
    if not spread > 0:
        return line, -1.0
    turn = (w * wta - wt * wa) / spread
    shift = (wa - turn * wt) / w
    variance = (waa - turn * wta - shift * wa) / w
    normal_rad = line.normal_rad - np.arctan(turn)
    return EdgeLine(x_px + shift * c, y_px + shift * s, normal_rad, reach_px), variance
