"""The most likely edge for the pixels of a turned rectangle, compiled in one go.

An edge takes some six passes over its pixels of 50 us each; calls from Python in between would
double that. ``benchmarks/bench_edge_fit.py`` says what that earns. ``edge_fit`` makes the result
readable.
"""

from math import log, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from calibration.edges.model import (
    FLAT_PARAMETERS,
    HIGH,
    LOG_SIGMA,
    LOW,
    SHADED_PARAMETERS,
    edge_values,
    levenberg_marquardt,
    slopes_gain,
)
from calibration.edges.residuals import (
    ProfileFigures,
    noise_part,
    outlier_weights,
    profile_figures,
    robust_variance,
)
from calibration.edges.segments import band_half_width, band_pixels, side_level
from calibration.edges.shading import without_slopes_across

__all__ = ["LikelyEdge", "maximise"]

Array = NDArray[np.float64]

_MAX_STEPS = 40
_ROUGH, _FINE = 1e-2, 1e-4  # last step of a fit, in px and parts of sigma
_WINDOW_ROUNDS = 4
_WINDOW_AGREES = 0.1  # relative change of sigma that needs no new window
_SHADING_P = 1e-3
_SHADING_SCORE_P = 1e-2  # the score is only an estimate of the F-test
_SHADING_LEAST = 2e-3  # of the contrast over half an edge: less does not move sigma by 0.01 %
_UNEVEN_SIGMAS = 3.1  # one in a thousand
_SIDE_PIXELS = 30
_MAD_EFFICIENCY = 0.368  # of the variance from the MAD, in Gaussian noise
_BLACK_DN = 0.0
_NEARLY_SATURATED = 0.995


class LikelyEdge(NamedTuple):
    """What the pixels say; parameters in the order of ``edge_model``, widths as log sigma.

    ``total`` is the plain edge, ``optical`` the one behind pixel squares; the variances of their
    log sigma are for weights that are inverse variances. ``is_found`` False leaves all else void,
    ``has_optical`` False the optical part.
    """

    is_found: bool
    total: Array
    total_variance: float
    total_squares: float
    has_optical: bool
    optical: Array
    optical_variance: float
    optical_squares: float
    half_length_px: float
    pixels: int
    noise_dn: float
    clipped_fraction: float
    has_outliers: bool
    is_shaded: bool
    profile: ProfileFigures


@njit(cache=True, error_model="numpy")
def maximise(
    image_dn: Array,
    x_px: float,
    y_px: float,
    normal_rad: float,
    length_px: float,
    clearance_px: float,
    sigma_px: float,
    noise_line: Array,
    saturation_dn: float,
) -> LikelyEdge:
    """Fit total and optical width to the pixels around one edge.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``.
    x_px, y_px, normal_rad, length_px, clearance_px, sigma_px
        Of the ``EdgeSegment``.
    noise_line
        Offset (DN^2), slope (DN) and floor (DN^2) of the variance against the level; empty where
        the noise is to be taken from the residuals.
    saturation_dn
        Infinite where not known.
    """
    half_length = 0.5 * length_px
    sigma = sigma_px
    start = np.zeros(FLAT_PARAMETERS)
    for attempt in range(_WINDOW_ROUNDS):
        half_width = min(band_half_width(sigma), clearance_px)
        x, y, values, across = band_pixels(
            image_dn, x_px, y_px, normal_rad, half_width, half_length
        )
        if len(values) < 4 * SHADED_PARAMETERS:
            return _none()
        low, high = side_level(values, -across, sigma), side_level(values, across, sigma)
        weights = _known_weights(across, sigma, low, high, noise_line)
        if attempt == 0:
            start[LOG_SIGMA] = log(max(sigma, 0.2))
            start[LOW], start[HIGH] = low, high
        rough, _, _, steps = levenberg_marquardt(
            x, y, values, weights, start, normal_rad, half_length, False, _ROUGH, _MAX_STEPS
        )
        if steps < 0 or not np.all(np.isfinite(rough)) or rough[HIGH] <= rough[LOW]:
            return _none()
        start = rough
        before, sigma = sigma, np.exp(rough[LOG_SIGMA])
        is_clipped = half_width < band_half_width(before)
        if abs(sigma - before) <= _WINDOW_AGREES * before or is_clipped:
            break
    levels, distances, edges = edge_values(x, y, rough, normal_rad, half_length, False)
    contrast = rough[HIGH] - rough[LOW]
    is_shaded = without_slopes_across(
        image_dn,
        x_px,
        y_px,
        normal_rad,
        half_length,
        half_width,
        clearance_px,
        contrast,
        sigma,
        distances,
        values,
    )
    if is_shaded:
        rough, _, _, steps = levenberg_marquardt(
            x, y, values, weights, rough, normal_rad, half_length, False, _ROUGH, _MAX_STEPS
        )
        if steps < 0 or not np.all(np.isfinite(rough)):
            return _none()
        levels, distances, edges = edge_values(x, y, rough, normal_rad, half_length, False)
    scatter = noise_part(values - levels, distances)
    if len(noise_line) == 0:
        _weigh_sides(scatter, edges, weights)
    has_outliers, outliers = outlier_weights(scatter, 1.0 / np.sqrt(weights), contrast)
    if has_outliers:
        weights *= outliers
    pixels = int(np.count_nonzero(weights))

    total, hessian, squares, steps = levenberg_marquardt(
        x, y, values, weights, rough, normal_rad, half_length, False, _FINE, _MAX_STEPS
    )
    if steps < 0 or not np.all(np.isfinite(total)):
        return _none()
    total_variance, total_squares = _log_sigma_variance(hessian), squares
    start = total.copy()
    start[LOG_SIGMA] = 0.5 * log(max(np.exp(2 * total[LOG_SIGMA]) - 1 / 12, 0.02))
    optical, hessian, squares, steps = levenberg_marquardt(
        x, y, values, weights, start, normal_rad, half_length, True, _FINE, _MAX_STEPS
    )
    has_optical = bool(steps >= 0 and np.all(np.isfinite(optical)))
    optical_variance, optical_squares = _log_sigma_variance(hessian), squares
    is_square = bool(has_optical and optical_squares < total_squares)

    flat, flat_squares = (optical, optical_squares) if is_square else (total, total_squares)
    levels, distances, edges = edge_values(x, y, flat, normal_rad, half_length, is_square)
    gain = slopes_gain(x, y, values - levels, edges, weights, normal_rad, half_length)
    freedom = pixels - SHADED_PARAMETERS
    has_slopes = False
    # The score tells beforehand what the slopes could gain; mostly that is the end of it.
    if freedom > 0 and _p_of_two_more(gain, flat_squares - gain, freedom) <= _SHADING_SCORE_P:
        start = np.zeros(SHADED_PARAMETERS)
        start[:FLAT_PARAMETERS] = flat
        trial, _, squares, steps = levenberg_marquardt(
            x, y, values, weights, start, normal_rad, half_length, is_square, _FINE, _MAX_STEPS
        )
        slopes = trial[FLAT_PARAMETERS:]
        p = _p_of_two_more(flat_squares - squares, squares, freedom)
        least = _SHADING_LEAST * (trial[HIGH] - trial[LOW])
        if steps >= 0 and p <= _SHADING_P and np.abs(slopes).max() >= least:
            start[:FLAT_PARAMETERS] = total
            start[FLAT_PARAMETERS:] = slopes
            shaded, hessian, squares, steps = levenberg_marquardt(
                x, y, values, weights, start, normal_rad, half_length, False, _FINE, _MAX_STEPS
            )
            if steps >= 0 and np.all(np.isfinite(shaded)):
                is_shaded = has_slopes = True
                total, total_squares = shaded, squares
                total_variance = _log_sigma_variance(hessian)
                start[:FLAT_PARAMETERS] = optical if has_optical else total[:FLAT_PARAMETERS]
                optical, hessian, squares, steps = levenberg_marquardt(
                    x, y, values, weights, start, normal_rad, half_length, True, _FINE, _MAX_STEPS
                )
                is_finite = bool(np.all(np.isfinite(optical)))
                has_optical = has_optical and steps >= 0 and is_finite
                optical_variance, optical_squares = _log_sigma_variance(hessian), squares
                is_square = bool(has_optical and optical_squares < total_squares)

    if has_slopes:
        best = optical if is_square else total
        levels, distances, edges = edge_values(x, y, best, normal_rad, half_length, is_square)
    counted = weights > 0
    residuals = (values - levels)[counted]
    clipped = np.count_nonzero(
        (values >= _NEARLY_SATURATED * saturation_dn) | (values <= _BLACK_DN)
    )
    return LikelyEdge(
        True,
        total,
        total_variance,
        total_squares,
        has_optical,
        optical,
        optical_variance,
        optical_squares,
        half_length,
        pixels,
        float(np.std(residuals)),
        clipped / len(values),
        has_outliers,
        is_shaded,
        profile_figures(values[counted], residuals, distances[counted], np.exp(total[LOG_SIGMA])),
    )


@njit(cache=True)
def _none() -> LikelyEdge:
    empty = np.zeros(FLAT_PARAMETERS)
    profile = ProfileFigures(0.0, 0.0, 0.0, 0.0, 0, 0)
    return LikelyEdge(
        False, empty, 0.0, 0.0, False, empty, 0.0, 0.0, 0.0, 0, 0.0, 0.0, False, False, profile
    )


@njit(cache=True)
def _known_weights(
    across: Array, sigma: float, low: float, high: float, noise_line: Array
) -> Array:
    """Inverse variances from a noise-free guess of each pixel's level; ones without a line."""
    weights = np.ones(len(across))
    if len(noise_line) == 0:
        return weights
    for i in range(len(across)):
        rise = min(max(0.5 + across[i] / (4.0 * max(sigma, 0.3)), 0.0), 1.0)
        level = low + (high - low) * rise
        weights[i] = 1.0 / max(noise_line[0] + noise_line[1] * level, noise_line[2])
    return weights


@njit(cache=True)
def _weigh_sides(scatter: Array, edges: Array, weights: Array) -> None:
    """Give inverse variances where one side of the edge is noisier than the other."""
    dark, bright = edges < 0.02, edges > 0.98
    n_dark, n_bright = np.count_nonzero(dark), np.count_nonzero(bright)
    if min(n_dark, n_bright) < _SIDE_PIXELS:
        return
    low, high = robust_variance(scatter[dark]), robust_variance(scatter[bright])
    if min(low, high) <= 1e-12 * max(low, high):
        return
    # The logarithm of a ratio of two variances is nearly normal.
    scatter_of_log = sqrt((2.0 / n_dark + 2.0 / n_bright) / _MAD_EFFICIENCY)
    if abs(log(high / low)) < _UNEVEN_SIGMAS * scatter_of_log:
        return
    weights[:] = sqrt(low * high) / (low + (high - low) * edges)


@njit(cache=True)
def _p_of_two_more(gain: float, left: float, freedom: int) -> float:
    """Chance that two superfluous parameters take off that much: F-test, closed for two."""
    if left <= 0:
        return 1.0 if gain <= 0 else 0.0
    return float((1.0 + max(gain, 0.0) / left) ** (-0.5 * freedom))


@njit(cache=True)
def _log_sigma_variance(hessian: Array) -> float:
    """Element of the inverse that belongs to log sigma."""
    scale = np.sqrt(np.diag(hessian)) + 1e-300
    unit = np.zeros(len(scale))
    unit[LOG_SIGMA] = 1.0
    scaled = hessian / scale / scale.reshape(-1, 1)
    for j in range(len(scale)):
        scaled[j, j] += 1e-14
    return float(max(np.linalg.solve(scaled, unit)[LOG_SIGMA], 0.0) / scale[LOG_SIGMA] ** 2)
