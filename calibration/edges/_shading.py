"""Shading across an edge: a slope of either level, measured beyond the reach of the PSF.

Within the band that is fitted, a slope across the edge is confounded with the tails of the PSF: on
a real photograph fitting it there moves sigma by 2 % either way with the width of the band. Farther
out, shading goes on as it was and tails fade. So the slope is measured in two zones there, and
taken off the pixels near the edge where both agree, or where the slope changes as that of a tail
never does: vignetting bends.

Where a side does not tell, as the frame cuts its zones or a tail reaches into them, the difference
of both sides does: light that falls off does so in proportion to the level, and a tail is alike on
either side.
"""

from math import ceil, erf, exp, floor, isfinite, pi, sqrt
from typing import NamedTuple

import numpy as np

from calibration.edges._model import inverse_element, solved
from calibration.edges._segments import EdgeLine
from simulation.arrays import FloatArray
from simulation.compiled import compiled, compiled_part

_ZONE_PX = 16.0  # width of either zone beyond the fitted band
_ZONE_LEAST_PX = 8.0
_LIGHT_LEAST_PX = 3.5  # of a zone whose slope is compared with that of the other side alone
# Of a slope taken off for light: a lens need not be alike on both sides, and stray light or a black
# level make the dark one's light another.
_LIGHT_UNSURE, _DARK_UNSURE = 0.1, 0.5
_ZONE_PIXELS = 30
# Variance of the distances, and of the squared positions along: a zone that the frame cuts down to
# a column shows no slope, one cut to a tip no bend. A whole zone of 8 px has 5 px^2, and 0.09.
_SPREAD_PX2, _SPREAD_ALONG = 3.0, 1e-3
_ALONG_LEAST = 2e-3  # of the contrast, at the ends: less does not move sigma by 0.02 %
_TERMS = 4
_RIDGE = 1e-13
_STRIDE_PX = 2  # along rows and columns: a quarter of the pixels is enough
_SLOPE_ERRORS = 5.0
_FAR_ERRORS = 4.0  # a tail has faded there: the slope has to be seen in the far zone alone
_AGREE_ERRORS = 3.0
_AGREE_SHARE = 0.25  # of the slope: vignetting is not quite straight
_BEND_ERRORS = 4.0
_LEFT_ERRORS = 2.0
_SLOPE_LEAST = 5e-4  # of the contrast over half the band: less does not move sigma by 0.1 %


class _Shading(NamedTuple):
    """How the levels of the dark and of the bright side go on from the edge.

    Slopes across it, at the edge, in DN/px; bends (halves of second derivatives) across it and
    along it in DN/px^2. Slopes along it are fitted with the edge.
    """

    dark: float
    bright: float
    dark_bend: float
    bright_bend: float
    dark_bend_along: float
    bright_bend_along: float


class _Side(NamedTuple):
    """What is taken off one side: slope at the edge and bend, with the standard error.

    ``is_told`` where its own zones tell, even if there is nothing to take off.
    """

    slope: float
    bend: float
    error: float
    is_told: bool


@compiled()
def slopes_across(
    image_dn: FloatArray,
    line: EdgeLine,
    half_width_px: float,
    clearance_px: float,
    contrast_dn: float,
) -> _Shading:
    """Slopes and bends of the dark and of the bright side; 0 where absent or negligible."""
    zones = _zones_px(image_dn, line, half_width_px, clearance_px)
    sums = _zone_sums(image_dn, line, half_width_px, zones)
    dark, bright = _sides(image_dn, line, half_width_px, zones, sums, contrast_dn)
    least = _ALONG_LEAST * contrast_dn
    dark_along = _bend_along(sums[0], least) / line.half_length_px**2
    bright_along = _bend_along(sums[1], least) / line.half_length_px**2
    return _Shading(dark.slope, bright.slope, dark.bend, bright.bend, dark_along, bright_along)


@compiled()
def slope_left(
    image_dn: FloatArray,
    line: EdgeLine,
    half_width_px: float,
    clearance_px: float,
    levels_dn: tuple[float, float],
) -> float:
    """Slope across the edge that may be left in its pixels, both sides together, in DN/px.

    Of a side whose slope is taken off, that is its error. Elsewhere light that falls off shows in
    the difference of both sides, a PSF's tail does not. What noise explains counts as none.
    """
    low, high = levels_dn
    contrast = high - low
    if contrast <= 0:
        return 0.0
    zones = _zones_px(image_dn, line, half_width_px, clearance_px)
    sums = _zone_sums(image_dn, line, half_width_px, zones)
    sides = _sides(image_dn, line, half_width_px, zones, sums, contrast)
    relative = _relative_slope(sums, low, high)
    squares = 0.0
    for side in range(2):
        one = sides[side]
        is_taken_off = one.slope != 0.0 or one.bend != 0.0
        left = one.error if is_taken_off else relative * (high if side else low)
        squares += left * left
    return sqrt(squares)


@compiled_part()
def _relative_slope(sums: FloatArray, low: float, high: float) -> float:
    """Slope over the level that light may have where none is taken off; 0 if noise explains it."""
    dark, bright = _zone(sums[0, 2]), _zone(sums[1, 2])
    if not isfinite(dark.error + bright.error):  # of one side alone, with its tail
        seen, level = (dark, low) if isfinite(dark.error) else (bright, high)
        is_light = isfinite(seen.error) and abs(seen.slope) > _LEFT_ERRORS * seen.error
        return seen.slope / level if is_light and level > 0 else 0.0
    apart, error = bright.slope - dark.slope, sqrt(bright.error**2 + dark.error**2)
    return apart / (high - low) if abs(apart) > _LEFT_ERRORS * error else 0.0


@compiled_part()
def _zones_px(
    image_dn: FloatArray, line: EdgeLine, half_width_px: float, clearance_px: float
) -> tuple[float, float]:
    """Width of either zone beside the dark and the bright side, as far as frame and edges allow."""
    rows, cols = image_dn.shape
    c, s = np.cos(line.normal_rad), np.sin(line.normal_rad)
    widths = np.empty(2)
    for side in range(2):
        reach = clearance_px
        for step, place, last in ((c, line.x_px, cols - 1), (s, line.y_px, rows - 1)):
            ahead = step if side else -step
            if ahead > 0:
                reach = min(reach, (last - place) / ahead)
            elif ahead < 0:
                reach = min(reach, place / -ahead)
        widths[side] = min(_ZONE_PX, max((reach - half_width_px) / 2, 0.0))
    return widths[0], widths[1]


@compiled_part()
def _sides(
    image_dn: FloatArray,
    line: EdgeLine,
    half_width_px: float,
    zones: tuple[float, float],
    sums: FloatArray,
    contrast_dn: float,
) -> tuple[_Side, _Side]:
    """What is taken off the dark and the bright side."""
    least = _SLOPE_LEAST * contrast_dn / half_width_px
    dark = _side_slope(sums[0], least, zones[0])
    bright = _side_slope(sums[1], least, zones[1])
    low, high = sums[0, 2, _TERMS + 1, 0], sums[1, 2, _TERMS + 1, 0]
    if (dark.is_told and bright.is_told) or low <= 0 or high <= low:
        return dark, bright
    common = min(zones[0], zones[1])
    if bright.is_told or (dark.is_told and common < _LIGHT_LEAST_PX):
        seen, level, other = bright, high, low
        if not bright.is_told:
            # A slope that is negligible on the dark side need not be so on the other.
            seen, level, other = _side_slope(sums[0], 0.0, zones[0]), low, high
        ratio = other / level
        unsure = (_LIGHT_UNSURE if ratio < 1 else _DARK_UNSURE) * seen.slope
        error = ratio * sqrt(seen.error**2 + unsure**2)
        by_other = _Side(ratio * seen.slope, ratio * seen.bend, error, False)
        return (by_other, bright) if bright.is_told else (dark, by_other)
    if common < _LIGHT_LEAST_PX:
        return dark, bright
    if zones[0] != zones[1]:
        sums = _zone_sums(image_dn, line, half_width_px, (common, common))
    of_dark, of_bright = _by_light(sums, least, common, dark.bend / low)
    return (dark if dark.is_told else of_dark), of_bright


@compiled_part()
def _by_light(sums: FloatArray, least: float, zone_px: float, bend: float) -> tuple[_Side, _Side]:
    """Slopes and bends of light in proportion to the level, from the difference of both sides.

    ``level (1 + a d + b d^2)`` has slopes at d that differ by ``a (H - L) + 2 b d (H + L)``.
    """
    none = _Side(0.0, 0.0, np.inf, False)
    dark, bright = _zone(sums[0, 2]), _zone(sums[1, 2])
    low, high = sums[0, 2, _TERMS + 1, 0], sums[1, 2, _TERMS + 1, 0]
    apart, error = bright.slope - dark.slope, sqrt(bright.error**2 + dark.error**2)
    apart -= 2 * bend * bright.distance_px * (high + low)
    a, b = apart / (high - low), bend
    if b == 0.0 and zone_px >= _ZONE_LEAST_PX:
        near = _zone(sums[1, 0]).slope - _zone(sums[0, 0]).slope
        far = _zone(sums[1, 1]).slope - _zone(sums[0, 1]).slope
        errors = _zone(sums[1, 0]).error ** 2 + _zone(sums[0, 0]).error ** 2
        errors += _zone(sums[1, 1]).error ** 2 + _zone(sums[0, 1]).error ** 2
        if abs(far - near) > _BEND_ERRORS * sqrt(errors):
            first, second = _zone(sums[1, 0]).distance_px, _zone(sums[1, 1]).distance_px
            b = (far - near) / (2 * (second - first) * (high + low))
            a = (near - 2 * b * first * (high + low)) / (high - low)
            error = sqrt(errors) * (first + second) / (second - first)
    if b == 0.0 and abs(apart) <= max(least, _SLOPE_ERRORS * error):
        return none, none
    error /= high - low
    unsure = _LIGHT_UNSURE * a
    of_dark = low * sqrt(error * error + unsure * unsure)
    of_bright = high * sqrt(error * error + unsure * unsure)
    return _Side(a * low, b * low, of_dark, False), _Side(a * high, b * high, of_bright, False)


@compiled_part()
def unclipped_slopes(shading: _Shading, clipped_distances_px: FloatArray) -> _Shading:
    """The shading of those sides of the edge that have no clipped pixels."""
    dark = 0.0 if np.any(clipped_distances_px < 0) else 1.0
    bright = 0.0 if np.any(clipped_distances_px > 0) else 1.0
    return _Shading(
        dark * shading.dark,
        bright * shading.bright,
        dark * shading.dark_bend,
        bright * shading.bright_bend,
        dark * shading.dark_bend_along,
        bright * shading.bright_bend_along,
    )


@compiled_part()
def is_even(shading: _Shading) -> bool:
    """Whether there is no shading."""
    for value in shading:  # noqa: SIM110 - numba compiles no generator
        if value != 0.0:
            return False
    return True


@compiled()
def shading_levels(
    shading: _Shading, distances: FloatArray, along: FloatArray, sigma_px: float
) -> FloatArray:
    """What shading adds to pixels at signed distances and positions along the edge, in DN."""
    levels = np.empty(len(distances))
    for i in range(len(distances)):
        # A ramp and a parabola that begin at the edge, blurred by the Gaussian.
        d = distances[i]
        u = d / sigma_px
        share = 0.5 * (1 + erf(u / sqrt(2.0)))
        density = sigma_px * exp(-0.5 * u * u) / sqrt(2 * pi)
        ramp = d * share + density
        parabola = (d * d + sigma_px * sigma_px) * share + d * density
        levels[i] = shading.bright * ramp + shading.dark * (d - ramp)
        whole = d * d + sigma_px * sigma_px
        levels[i] += shading.bright_bend * parabola + shading.dark_bend * (whole - parabola)
        bend = shading.bright_bend_along * share + shading.dark_bend_along * (1 - share)
        levels[i] += bend * along[i] * along[i]
    return levels


class _Zone(NamedTuple):
    """What a zone shows, with standard errors: slope across the edge at a mean distance from it.

    ``bend_along`` is per square of the half length. Errors are infinite where nothing is shown.
    """

    slope: float
    error: float
    distance_px: float
    bend_along: float
    bend_along_error: float


@compiled_part()
def _side_slope(sums: FloatArray, least: float, zone_px: float) -> _Side:
    """Slope at the edge and bend of one side, from the sums over its near and its far zone.

    A tail rises towards the bright side, less the farther out; all else is vignetting.
    """
    if zone_px < _ZONE_LEAST_PX:
        return _Side(0.0, 0.0, np.inf, False)
    near, far, both = _zone(sums[0]), _zone(sums[1]), _zone(sums[2])
    apart = sqrt(near.error**2 + far.error**2)
    may_be_tail = near.slope > far.slope > -_FAR_ERRORS * far.error
    if abs(near.slope - far.slope) > _BEND_ERRORS * apart and not may_be_tail:
        bend = (far.slope - near.slope) / (far.distance_px - near.distance_px)
        return _Side(near.slope - bend * near.distance_px, 0.5 * bend, both.error, True)
    is_tail = abs(near.slope - far.slope) > max(
        _AGREE_ERRORS * apart, _AGREE_SHARE * abs(both.slope)
    )
    if is_tail or abs(far.slope) <= _FAR_ERRORS * far.error:
        return _Side(0.0, 0.0, both.error, not is_tail and isfinite(far.error))
    is_seen = abs(both.slope) > max(least, _SLOPE_ERRORS * both.error)
    return _Side(both.slope if is_seen else 0.0, 0.0, both.error, True)


@compiled_part()
def _bend_along(sums: FloatArray, least: float) -> float:
    """Bend along the edge of one side, per square of its half length."""
    both = _zone(sums[2])
    is_seen = abs(both.bend_along) > max(least, _SLOPE_ERRORS * both.bend_along_error)
    return both.bend_along if is_seen else 0.0


@compiled_part()
def _zone_sums(
    image_dn: FloatArray, line: EdgeLine, inner: float, zones: tuple[float, float]
) -> FloatArray:
    """Products of the levels' terms, per side (dark, bright) and zone (near, far, both).

    The terms are 1, the distance, the position along the edge and its square, and the level; a last
    row holds the mean level.
    """
    sums = np.zeros((2, 3, _TERMS + 2, _TERMS + 1))
    rows, cols = image_dn.shape
    x_px, y_px, half_length = line.x_px, line.y_px, line.half_length_px
    c, s = np.cos(line.normal_rad), np.sin(line.normal_rad)
    outer = inner + 2 * max(zones[0], zones[1])
    reach_x = outer * abs(c) + half_length * abs(s)
    reach_y = outer * abs(s) + half_length * abs(c)
    left, right = max(ceil(x_px - reach_x), 0), min(floor(x_px + reach_x), cols - 1)
    middle_dn = image_dn[min(max(int(y_px), 0), rows - 1), min(max(int(x_px), 0), cols - 1)]
    term = np.ones(_TERMS + 1)
    row = max(ceil(y_px - reach_y), 0)
    while row <= min(floor(y_px + reach_y), rows - 1):
        dy = row - y_px
        for col in range(left, right + 1, _STRIDE_PX):
            dx = col - x_px
            across = c * dx + s * dy
            along = c * dy - s * dx
            zone = zones[int(across > 0)]
            away = abs(across) - inner
            if away <= 0 or away > 2 * zone or abs(along) > half_length:
                continue
            term[1], term[2] = across, along / half_length
            term[3] = term[2] * term[2]
            term[4] = image_dn[row, col] - middle_dn
            m = sums[int(across > 0), int(away > zone)]
            for j in range(_TERMS + 1):
                for k in range(j + 1):
                    m[j, k] += term[j] * term[k]
        row += _STRIDE_PX
    for side in range(2):
        for j in range(_TERMS + 1):
            for k in range(j + 1):
                sums[side, 2, j, k] = sums[side, 0, j, k] + sums[side, 1, j, k]
        for one in range(3):
            count = max(sums[side, one, 0, 0], 1.0)
            sums[side, one, _TERMS + 1, 0] = middle_dn + sums[side, one, _TERMS, 0] / count
    return sums


@compiled_part()
def _zone(m: FloatArray) -> _Zone:
    """Slope of the level across the edge from the products over a zone.

    It is fitted beside a parabola along the edge: at the border of the image, and under vignetting,
    what changes along the edge would otherwise leak in.
    """
    n = m[0, 0]
    if n < _ZONE_PIXELS:
        return _Zone(0.0, np.inf, 0.0, 0.0, np.inf)
    matrix, right = np.empty((_TERMS, _TERMS)), np.empty(_TERMS)
    for j in range(_TERMS):
        right[j] = m[_TERMS, j]
        for k in range(j + 1):
            matrix[j, k] = matrix[k, j] = m[j, k]
        matrix[j, j] *= 1 + _RIDGE
    by_slope, by_bend = inverse_element(matrix, 1), inverse_element(matrix, 3)
    if not 0.0 < n * _SPREAD_PX2 * by_slope <= 1.0:
        return _Zone(0.0, np.inf, 0.0, 0.0, np.inf)
    found = solved(matrix, right, 0.0)
    left = m[_TERMS, _TERMS]
    for j in range(_TERMS):
        left -= found[j] * right[j]
    variance = max(left, 0.0) / (n - _TERMS)
    across_error = sqrt(variance * by_slope)
    along_error = sqrt(variance * by_bend) if n * _SPREAD_ALONG * by_bend <= 1.0 else np.inf
    return _Zone(found[1], across_error, m[1, 0] / n, found[3], along_error)
