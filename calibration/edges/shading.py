"""Shading across an edge: a slope of either level, measured beyond the reach of the PSF.

Within the band that is fitted, a slope across the edge is confounded with the tails of the PSF: on
a real photograph fitting it there moves sigma by 2 % either way with the width of the band. Farther
out, shading goes on as it was and tails fade. So the slope is measured in two zones there, and
taken off the pixels near the edge where both agree.
"""

from math import ceil, erf, exp, floor, pi, sqrt

import numpy as np
from numba import njit

from calibration.edge_search import EdgeLine
from simulation.arrays import FloatArray

_ZONE_PX = 16.0  # width of either zone beyond the fitted band
_ZONE_LEAST_PX = 8.0
_ZONE_PIXELS = 30
_STRIDE_PX = 2  # along rows and columns: a quarter of the pixels is enough
_SLOPE_ERRORS = 5.0
_FAR_ERRORS = 4.0  # a tail has faded there: the slope has to be seen in the far zone alone
_AGREE_ERRORS = 3.0
_AGREE_SHARE = 0.25  # of the slope: vignetting is not quite straight
_SLOPE_LEAST = 5e-4  # of the contrast over half the band: less does not move sigma by 0.1 %


@njit(cache=True, error_model="numpy")
def slopes_across(
    image_dn: FloatArray,
    line: EdgeLine,
    half_width_px: float,
    clearance_px: float,
    contrast_dn: float,
) -> tuple[float, float]:
    """Slope of the dark and of the bright side in DN/px; 0 where it is absent or negligible.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``.
    line
        The edge.
    half_width_px, clearance_px
        Half width of the fitted band, and the distance to the next edge.
    contrast_dn
        Contrast of the edge.
    """
    zone = min(_ZONE_PX, (clearance_px - half_width_px) / 2)
    if zone < _ZONE_LEAST_PX:
        return 0.0, 0.0
    sums = _zone_sums(image_dn, line, half_width_px, zone)
    least = _SLOPE_LEAST * contrast_dn / half_width_px
    return _side_slope(sums[0], least), _side_slope(sums[1], least)


@njit(cache=True, error_model="numpy")
def shading_levels(
    slopes_dn_per_px: tuple[float, float], distances: FloatArray, sigma_px: float
) -> FloatArray:
    """What slopes of the dark and of the bright side add to pixels at signed distances, in DN."""
    dark, bright = slopes_dn_per_px
    levels = np.empty(len(distances))
    for i in range(len(distances)):
        # A ramp that begins at the edge, blurred by the Gaussian.
        u = distances[i] / sigma_px
        ramp = distances[i] * 0.5 * (1 + erf(u / sqrt(2.0)))
        ramp += sigma_px * exp(-0.5 * u * u) / sqrt(2 * pi)
        levels[i] = bright * ramp + dark * (distances[i] - ramp)
    return levels


@njit(cache=True, error_model="numpy")
def _side_slope(sums: FloatArray, least: float) -> float:
    """Slope of one side from the sums over its near and its far zone; 0 where they disagree."""
    near, near_error = _slope(sums[0])
    far, far_error = _slope(sums[1])
    slope, error = _slope(sums[0] + sums[1])
    apart = _AGREE_ERRORS * sqrt(near_error**2 + far_error**2)
    is_tail = abs(near - far) > max(apart, _AGREE_SHARE * abs(slope))
    if is_tail or abs(far) <= _FAR_ERRORS * far_error:
        return 0.0
    return slope if abs(slope) > max(least, _SLOPE_ERRORS * error) else 0.0


@njit(cache=True, error_model="numpy")
def _zone_sums(image_dn: FloatArray, line: EdgeLine, inner: float, zone: float) -> FloatArray:
    """Sums of the products that a plane needs, per side (dark, bright) and zone (near, far)."""
    sums = np.zeros((2, 2, 10))
    rows, cols = image_dn.shape
    x_px, y_px, half_length = line.x_px, line.y_px, line.half_length_px
    c, s = np.cos(line.normal_rad), np.sin(line.normal_rad)
    outer = inner + 2 * zone
    reach_x = outer * abs(c) + half_length * abs(s)
    reach_y = outer * abs(s) + half_length * abs(c)
    left, right = max(ceil(x_px - reach_x), 0), min(floor(x_px + reach_x), cols - 1)
    middle_dn = image_dn[min(max(int(y_px), 0), rows - 1), min(max(int(x_px), 0), cols - 1)]
    row = max(ceil(y_px - reach_y), 0)
    while row <= min(floor(y_px + reach_y), rows - 1):
        dy = row - y_px
        for col in range(left, right + 1, _STRIDE_PX):
            dx = col - x_px
            across = c * dx + s * dy
            along = c * dy - s * dx
            away = abs(across) - inner
            if away <= 0 or away > 2 * zone or abs(along) > half_length:
                continue
            m = sums[int(across > 0), int(away > zone)]
            level = image_dn[row, col] - middle_dn
            m[0] += 1.0
            m[1] += across
            m[2] += along
            m[3] += level
            m[4] += across * across
            m[5] += across * along
            m[6] += along * along
            m[7] += across * level
            m[8] += along * level
            m[9] += level * level
        row += _STRIDE_PX
    return sums


@njit(cache=True, error_model="numpy")
def _slope(m: FloatArray) -> tuple[float, float]:
    """Slope of the level across the edge from the sums over a zone, and its standard error.

    A plane is fitted: at the border of the image, a slope along the edge would otherwise leak in.
    """
    n = m[0]
    if n < _ZONE_PIXELS:
        return 0.0, 0.0
    aa, at, tt = m[4] - m[1] * m[1] / n, m[5] - m[1] * m[2] / n, m[6] - m[2] * m[2] / n
    av, tv, vv = m[7] - m[1] * m[3] / n, m[8] - m[2] * m[3] / n, m[9] - m[3] * m[3] / n
    determinant = aa * tt - at * at
    if not determinant > 0:
        return 0.0, 0.0
    across = (tt * av - at * tv) / determinant
    along = (aa * tv - at * av) / determinant
    variance = max(vv - across * av - along * tv, 0.0) / (n - 3)
    return across, sqrt(variance * tt / determinant)
