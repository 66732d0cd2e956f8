"""Ridges of an image's gradient, grouped into regions of one direction, each with its line.

The loops are compiled: an image has hundreds of regions of a hundred pixels each, and numpy's cost
per call would be most of the time. ``benchmarks/bench_edge_fit.py`` shows what that gains.
"""

from dataclasses import dataclass
from math import atan2, cos, pi, sin, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from calibration.edge_search.gradient import Gradient
from calibration.edge_search.segments import EdgeLine
from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray

SHORTEST_REGION_PX = 8
_NOISE_MEAN, _NOISE_SOLID = 4.0, 8.0  # of a region's mean gradient
_DIRECTION_COSINE = cos(pi / 8)
_SMALLEST_NEIGHBOUR_PX, _FAINT_NEIGHBOUR_PX = 6, 16
_LARGEST_SAGITTA = 0.02  # of the length: a bend the fit's curvature takes up
_ROUGHEST_PX = 0.7  # rms distance of the ridge from its line
_LINE_BAND_PX = 3.0
_LINE_ROUNDS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Ridges:
    """Lines through the ridges of an image, and all ridge pixels.

    ``lines`` has a row per straight region: middle x and y (px), angle of the normal from the
    dark to the bright side (rad) and length (px). ``points`` holds x and y of all ridge pixels
    except specks of noise, from top to bottom.
    """

    lines: FloatArray
    points: FloatArray


def find_ridges(gradient: Gradient, image_dn: FloatArray) -> Ridges:
    """Group the ridge pixels into regions and put a line through each."""
    rows, cols, starts = _regions(gradient.ridge, gradient.x, gradient.y)
    sizes = np.diff(starts)
    if sizes.size == 0:
        return Ridges(np.empty((0, 4)), np.empty((0, 2)))
    magnitude = np.hypot(gradient.x[rows, cols], gradient.y[rows, cols])
    level_dn = np.add.reduceat(image_dn[rows, cols], starts[:-1]) / sizes
    noise = gradient.noise[np.searchsorted(gradient.levels_dn, level_dn, side="right")]
    strength = np.add.reduceat(magnitude, starts[:-1]) / sizes
    is_real = strength >= _NOISE_MEAN * noise
    lines = _lines(gradient.x, gradient.y, rows, cols, starts, is_real)
    # Noise beside a faint edge makes short, faint ridges; only what is neither spoils a fit.
    is_solid = (sizes >= _SMALLEST_NEIGHBOUR_PX) & (strength >= _NOISE_SOLID * noise)
    is_solid |= (sizes >= _FAINT_NEIGHBOUR_PX) & is_real
    solid = np.repeat(is_solid, sizes)
    solid_rows, solid_cols = rows[solid], cols[solid]
    from_top = np.argsort(solid_rows, kind="stable")
    points = np.column_stack([solid_cols[from_top], solid_rows[from_top]]).astype(np.float64)
    return Ridges(lines, points)


@njit(cache=True, error_model="numpy")
def _regions(
    ridge: NDArray[np.uint8], gx: Float32Array, gy: Float32Array
) -> tuple[IntArray, IntArray, IntArray]:
    """Connected ridge pixels whose gradient stays near the direction of the region's sum.

    Returns their rows and columns, region by region, and where each region starts.
    """
    height, width = ridge.shape
    total = 0
    for r in range(height):
        for c in range(width):
            if ridge[r, c]:
                total += 1
    taken = np.zeros((height, width), np.bool_)
    rows = np.empty(total, np.int64)
    cols = np.empty(total, np.int64)
    starts = np.empty(total + 1, np.int64)
    filled = count = 0
    for r0 in range(height):
        for c0 in range(width):
            if not ridge[r0, c0] or taken[r0, c0]:
                continue
            starts[count] = filled
            count += 1
            taken[r0, c0] = True
            rows[filled], cols[filled] = r0, c0
            looked_at = filled
            filled += 1
            sum_x = sum_y = 0.0
            while looked_at < filled:
                r, c = rows[looked_at], cols[looked_at]
                looked_at += 1
                norm = max(sqrt(gx[r, c] ** 2 + gy[r, c] ** 2), 1e-30)
                sum_x += gx[r, c] / norm
                sum_y += gy[r, c] / norm
                for nr in range(max(r - 1, 0), min(r + 2, height)):
                    for nc in range(max(c - 1, 0), min(c + 2, width)):
                        if not ridge[nr, nc] or taken[nr, nc]:
                            continue
                        x, y = gx[nr, nc], gy[nr, nc]
                        along = x * sum_x + y * sum_y
                        norms = (x * x + y * y) * (sum_x * sum_x + sum_y * sum_y)
                        if along <= 0 or along * along < _DIRECTION_COSINE**2 * norms:
                            continue
                        taken[nr, nc] = True
                        rows[filled], cols[filled] = nr, nc
                        filled += 1
    starts[count] = filled
    return rows, cols, starts[: count + 1]


@njit(cache=True, error_model="numpy")
def _lines(
    gx: Float32Array,
    gy: Float32Array,
    rows: IntArray,
    cols: IntArray,
    starts: IntArray,
    is_real: BoolArray,
) -> FloatArray:
    lines = np.empty((len(starts), 4))
    count = 0
    for k in range(len(starts) - 1):
        first, last = starts[k], starts[k + 1]
        if last - first < SHORTEST_REGION_PX or not is_real[k]:
            continue
        line, is_straight = _line(gx, gy, rows[first:last], cols[first:last])
        if is_straight:
            lines[count] = line
            count += 1
    return lines[:count]


@njit(cache=True, error_model="numpy")
def _magnitude(gx: Float32Array, gy: Float32Array, row: int, col: int) -> float:
    r = min(max(row, 0), gx.shape[0] - 1)
    c = min(max(col, 0), gx.shape[1] - 1)
    return sqrt(gx[r, c] ** 2 + gy[r, c] ** 2)


@njit(cache=True, error_model="numpy")
def _line(
    gx: Float32Array, gy: Float32Array, rows: IntArray, cols: IntArray
) -> tuple[tuple[float, float, float, float], bool]:
    """Line through a region's pixels: middle x, y, normal, length; whether they lie along it."""
    none = (0.0, 0.0, 0.0, 0.0)
    n = len(rows)
    x, y, weight = np.empty(n), np.empty(n), np.empty(n)
    sum_x = sum_y = 0.0
    for i in range(n):
        r, c = rows[i], cols[i]
        dx, dy = gx[r, c], gy[r, c]
        sum_x += dx
        sum_y += dy
        weight[i] = dx * dx + dy * dy
        # Below the pixel, by a parabola along the axis nearer to the gradient.
        step_c, step_r = (1, 0) if abs(dx) >= abs(dy) else (0, 1)
        here = _magnitude(gx, gy, r, c)
        before = _magnitude(gx, gy, r - step_r, c - step_c)
        after = _magnitude(gx, gy, r + step_r, c + step_c)
        bend = 2 * here - before - after
        shift = min(max(0.5 * (after - before) / bend, -0.5), 0.5) if bend > 0 else 0.0
        x[i], y[i] = c + shift * step_c, r + shift * step_r
    normal = atan2(sum_y, sum_x)
    cx, cy = x.mean(), y.mean()
    kept = np.ones(n, np.bool_)
    for _ in range(_LINE_ROUNDS):
        along, across = _projected(x, y, cx, cy, normal)
        slope, shift = _weighted_line(along, across, weight, kept)
        if not np.isfinite(slope):
            return none, False
        cx += shift * cos(normal)
        cy += shift * sin(normal)
        normal -= np.arctan(slope)
        # The ridge runs around a corner for its last pixels: they are not part of this line.
        away = np.abs(across - slope * along - shift)
        kept = away <= max(_ROUGHEST_PX, 2.5 * np.median(away))
    along, across = _projected(x, y, cx, cy, normal)
    along, across = along[kept], across[kept]
    if len(along) < max(SHORTEST_REGION_PX, 0.6 * n):
        return none, False
    low, high = along.min(), along.max()
    length = high - low
    bend, rough = _parabola(along, across)
    if rough > _ROUGHEST_PX or abs(bend) * length**2 / 4 > max(_LARGEST_SAGITTA * length, 0.5):
        return none, False
    middle = 0.5 * (low + high)
    return (cx - middle * sin(normal), cy + middle * cos(normal), normal, length + 1), True


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def _parabola(along: FloatArray, across: FloatArray) -> tuple[float, float]:
    """Second-order coefficient of the parabola through the points, and their rms distance."""
    scale = max(np.abs(along).max(), 1.0)
    design = np.ones((len(along), 3))
    design[:, 1] = along / scale
    design[:, 2] = design[:, 1] ** 2
    transposed = np.ascontiguousarray(design.T)
    found = np.linalg.solve(transposed @ design, transposed @ across)
    rest = across - design @ found
    return found[2] / scale**2, sqrt(np.mean(rest**2))


@njit(cache=True, error_model="numpy")
def refined(gx: Float32Array, gy: Float32Array, line: EdgeLine) -> tuple[EdgeLine, float]:
    """Line through all gradient pixels near a line, by their squared slope across it.

    Parameters
    ----------
    gx, gy
        Gradient, shape ``(rows, cols)``.
    line
        Its approximate position.

    Returns
    -------
    line, variance
        Variance in px^2 of the squared gradient across the line; -1 where there is no gradient.
    """
    height, width = gx.shape
    x_px, y_px, reach_px = line.x_px, line.y_px, line.half_length_px
    c, s = cos(line.normal_rad), sin(line.normal_rad)
    w = wt = wa = wtt = wta = waa = 0.0
    first = max(int(y_px - reach_px * abs(c) - 4), 0)
    for row in range(first, min(int(y_px + reach_px * abs(c) + 5), height)):
        dy = row - y_px
        left, right = x_px - reach_px * abs(s) - 4, x_px + reach_px * abs(s) + 5
        if abs(c) > 1e-9:
            # Where the band around the line crosses this row.
            left = max(left, x_px - s * dy / c - _LINE_BAND_PX / abs(c))
            right = min(right, x_px - s * dy / c + _LINE_BAND_PX / abs(c) + 1)
        for col in range(max(int(np.ceil(left)), 0), min(int(np.ceil(right)), width)):
            dx = col - x_px
            a, t = c * dx + s * dy, -s * dx + c * dy
            if abs(a) > _LINE_BAND_PX or abs(t) > reach_px:
                continue
            slope = c * gx[row, col] + s * gy[row, col]
            if slope <= 0:
                continue
            weight = slope * slope
            w += weight
            wt += weight * t
            wa += weight * a
            wtt += weight * t * t
            wta += weight * t * a
            waa += weight * a * a
    spread = w * wtt - wt * wt
    if not spread > 0:
        return line, -1.0
    turn = (w * wta - wt * wa) / spread
    shift = (wa - turn * wt) / w
    variance = (waa - turn * wta - shift * wa) / w
    normal_rad = line.normal_rad - np.arctan(turn)
    return EdgeLine(x_px + shift * c, y_px + shift * s, normal_rad, reach_px), variance


@njit(cache=True, error_model="numpy")
def nearest_others(
    points: FloatArray, line: EdgeLine, own_px: float, reach_px: float
) -> FloatArray:
    """Distance to the nearest ridge beside an edge that is not its own, in steps along it.

    Parameters
    ----------
    points
        Shape ``(n, 2)``: x and y of ridge pixels, from top to bottom.
    line
        The edge.
    own_px, reach_px
        Ridges nearer than the first belong to the edge; those farther than the second are not
        looked for.

    Returns
    -------
    ndarray of float64
        One distance in px per px of the edge's length; infinite where there is nothing.
    """
    c, s = cos(line.normal_rad), sin(line.normal_rad)
    length = 2.0 * line.half_length_px
    count = max(int(np.ceil(length)), 1)
    nearest = np.full(count, np.inf)
    reach_x = reach_px * abs(c) + line.half_length_px * abs(s)
    reach_y = reach_px * abs(s) + line.half_length_px * abs(c)
    for i in range(np.searchsorted(points[:, 1], line.y_px - reach_y), len(points)):
        dx, dy = points[i, 0] - line.x_px, points[i, 1] - line.y_px
        if dy > reach_y:
            break
        if abs(dx) > reach_x:
            continue
        across, along = abs(c * dx + s * dy), -s * dx + c * dy
        if across <= own_px or across > reach_px or abs(along) > line.half_length_px:
            continue
        k = min(int((along + line.half_length_px) / length * count), count - 1)
        nearest[k] = min(nearest[k], across)
    return nearest


@njit(cache=True, error_model="numpy")
def clear_stretches(nearest: FloatArray, least_px: float, margin_steps: int) -> IntArray:
    """First and last step of each stretch with nothing nearer than ``least_px``.

    ``nearest`` is as from ``nearest_others``; a stretch ends ``margin_steps`` before what is too
    near. Returned is an array of shape ``(stretches, 2)``.
    """
    count = len(nearest)
    stretches = np.empty((count + 1, 2), np.int64)
    found, first, blocked = 0, 0, -1
    for k in range(count + 1):
        if k < count and nearest[k] >= least_px:
            continue
        last = k - 1 - margin_steps if k < count else count - 1
        first = 0 if blocked < 0 else blocked + 1 + margin_steps
        if last >= first:
            stretches[found] = first, last
            found += 1
        blocked = k
    return stretches[:found]
