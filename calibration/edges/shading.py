"""Shading across an edge: a slope of either level, measured beyond the reach of the PSF.

Within the band that is fitted, a slope across the edge cannot be told from the tails of the PSF: on
a real photograph fitting it there moves sigma by 2 % either way with the width of the band. Farther
out, shading goes on as it was and tails fade. So the slope is measured in two zones there, and
taken off the pixels near the edge where both agree.
"""

from math import ceil, erf, exp, floor, pi, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["without_slopes_across"]

Array = NDArray[np.float64]

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
def without_slopes_across(
    image_dn: Array,
    x_px: float,
    y_px: float,
    normal_rad: float,
    half_length: float,
    half_width: float,
    clearance_px: float,
    contrast: float,
    sigma_px: float,
    distances: Array,
    values: Array,
) -> bool:
    """Take the slopes off ``values`` in place; whether there were any.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``.
    x_px, y_px, normal_rad, half_length
        The edge.
    half_width, clearance_px
        How far from it is fitted, and how far nothing else is near; px.
    contrast, sigma_px
        Of the edge, in DN and px.
    distances, values
        Signed distance and level of the pixels that are fitted.
    """
    zone = min(_ZONE_PX, (clearance_px - half_width) / 2)
    if zone < _ZONE_LEAST_PX:
        return False
    sums = np.zeros((2, 2, 10))
    _add_zones(image_dn, x_px, y_px, normal_rad, half_length, half_width, zone, sums)
    slopes = np.zeros(2)
    for side in range(2):
        near, near_error = _slope(sums[side, 0])
        far, far_error = _slope(sums[side, 1])
        slope, error = _slope(sums[side, 0] + sums[side, 1])
        apart = _AGREE_ERRORS * sqrt(near_error**2 + far_error**2)
        is_tail = abs(near - far) > max(apart, _AGREE_SHARE * abs(slope))
        if is_tail or abs(far) <= _FAR_ERRORS * far_error:
            continue
        if abs(slope) * half_width > _SLOPE_LEAST * contrast and abs(slope) > _SLOPE_ERRORS * error:
            slopes[side] = slope
    if slopes[0] == 0.0 and slopes[1] == 0.0:
        return False
    for i in range(len(values)):
        # A ramp that begins at the edge, blurred by the Gaussian.
        u = distances[i] / sigma_px
        ramp = distances[i] * 0.5 * (1 + erf(u / sqrt(2.0)))
        ramp += sigma_px * exp(-0.5 * u * u) / sqrt(2 * pi)
        values[i] -= slopes[1] * ramp + slopes[0] * (distances[i] - ramp)
    return True


@njit(cache=True, error_model="numpy")
def _add_zones(
    image_dn: Array,
    x_px: float,
    y_px: float,
    normal_rad: float,
    half_length: float,
    inner: float,
    zone: float,
    sums: Array,
) -> None:
    """Add up the products that a plane needs, per side (dark, bright) and zone (near, far)."""
    rows, cols = image_dn.shape
    c, s = np.cos(normal_rad), np.sin(normal_rad)
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


@njit(cache=True, error_model="numpy")
def _slope(m: Array) -> tuple[float, float]:
    """Slope of the level across the edge from the sums over a zone, and its standard error.

    A plane is fitted: at the border of the image, a slope along the edge would else leak in.
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
