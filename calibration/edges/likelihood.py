"""The most likely edge for the pixels of a rotated rectangle, compiled as a whole.

The stages: a band of pixels that fits the edge's width, with a rough fit; slopes across the edge
taken off; weights from the residuals; the total and the optical width; slopes along the edge, where
the pixels ask for them. Together they take some six passes over the pixels of 50 us each; calls
from Python in between would double that, as ``benchmarks/bench_edge_fit.py`` says.
``calibration.edges.fit`` makes the result readable.
"""

from math import log, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from calibration.edge_search import (
    BandPixels,
    EdgeLine,
    band_half_width,
    band_pixels,
    side_level,
)
from calibration.edges.model import (
    FLAT_PARAMETERS,
    HIGH,
    LOG_SIGMA,
    LOW,
    SHADED_PARAMETERS,
    EdgeLevels,
    Minimum,
    edge_values,
    levenberg_marquardt,
    slopes_gain,
)
from calibration.edges.residuals import (
    ProfileFigures,
    noise_part,
    outlier_weights,
    profile_figures,
)
from calibration.edges.shading import is_even, shading_levels, slopes_across
from calibration.robust import robust_sigma
from simulation.arrays import FloatArray

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


class WidthFit(NamedTuple):
    """One edge shape fitted to the pixels; valid only if ``is_found``.

    The parameters are in the order of ``calibration.edges.model``, the width as log sigma; its
    variance is for weights that are inverse variances.
    """

    is_found: bool
    parameters: FloatArray
    log_sigma_variance: float
    squares: float


class LikelyEdge(NamedTuple):
    """The fitted edges: plain (total width) and behind pixel squares (optical width).

    If ``total`` is not found, the rest is not valid. ``pixels`` counts those that have a weight.
    """

    total: WidthFit
    optical: WidthFit
    pixels: int
    noise_dn: float
    clipped_fraction: float
    has_outliers: bool
    is_shaded: bool
    profile: ProfileFigures


class _Window(NamedTuple):
    """The pixels that are fitted, their weights and a rough fit; void where none is found."""

    rough: Minimum
    pixels: BandPixels
    weights: FloatArray
    half_width_px: float


class _Widths(NamedTuple):
    """The plain edge and the one behind pixel squares, fitted to the same pixels."""

    total: Minimum
    optical: Minimum


@njit(cache=True, error_model="numpy")
def maximise(
    image_dn: FloatArray,
    line: EdgeLine,
    sigma_px: float,
    clearance_px: float,
    noise_line: FloatArray,
    saturation_dn: float,
) -> LikelyEdge:
    """Fit total and optical width to the pixels around one edge.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``.
    line, sigma_px, clearance_px
        As in ``EdgeSegment``.
    noise_line
        Offset (DN^2), slope (DN) and floor (DN^2) of the variance against the level; empty where
        the noise is to be taken from the residuals.
    saturation_dn
        Infinite if not known.
    """
    window = _window(image_dn, line, sigma_px, clearance_px, noise_line)
    if not window.rough.is_found or window.rough.parameters[HIGH] <= window.rough.parameters[LOW]:
        return _none()
    found = edge_values(window.pixels, window.rough.parameters, False)
    window, is_shaded = _without_shading(image_dn, line, clearance_px, window, found.distances)
    if not window.rough.is_found:
        return _none()
    if is_shaded:
        found = edge_values(window.pixels, window.rough.parameters, False)
    weights, has_outliers = _weighed(window, found, len(noise_line) > 0)
    flat = _widths(window.pixels, weights, window.rough.parameters)
    if not flat.total.is_found:
        return _none()
    found = _best_levels(window.pixels, flat)
    widths, has_slopes = _with_slopes_along(window.pixels, weights, flat, found)
    if has_slopes:
        found = _best_levels(window.pixels, widths)

    values = window.pixels.values
    counted = weights > 0
    residuals = (values - found.levels)[counted]
    clipped = np.count_nonzero(
        (values >= _NEARLY_SATURATED * saturation_dn) | (values <= _BLACK_DN)
    )
    sigma = np.exp(widths.total.parameters[LOG_SIGMA])
    return LikelyEdge(
        _width_fit(widths.total),
        _width_fit(widths.optical),
        int(np.count_nonzero(weights)),
        float(np.std(residuals)),
        clipped / len(values),
        has_outliers,
        is_shaded or has_slopes,
        profile_figures(values[counted], residuals, found.distances[counted], sigma),
    )


@njit(cache=True)
def _none() -> LikelyEdge:
    void = WidthFit(False, np.zeros(FLAT_PARAMETERS), 0.0, 0.0)
    profile = ProfileFigures(0.0, 0.0, 0.0, 0.0, 0, 0)
    return LikelyEdge(void, void, 0, 0.0, 0.0, False, False, profile)


@njit(cache=True, error_model="numpy")
def _window(
    image_dn: FloatArray,
    line: EdgeLine,
    sigma_px: float,
    clearance_px: float,
    noise_line: FloatArray,
) -> _Window:
    """Fit roughly, in a band as wide as the fitted width requires."""
    sigma = sigma_px
    start = np.zeros(FLAT_PARAMETERS)
    for attempt in range(_WINDOW_ROUNDS):
        half_width = min(band_half_width(sigma), clearance_px)
        pixels = band_pixels(image_dn, line, half_width)
        low = side_level(pixels.values, -pixels.across, sigma)
        high = side_level(pixels.values, pixels.across, sigma)
        weights = _known_weights(pixels.across, sigma, low, high, noise_line)
        if attempt == 0:
            start[LOG_SIGMA] = log(max(sigma, 0.2))
            start[LOW], start[HIGH] = low, high
        rough = Minimum(False, start, np.zeros((FLAT_PARAMETERS, FLAT_PARAMETERS)), 0.0)
        if len(pixels.values) >= 4 * SHADED_PARAMETERS:
            rough = levenberg_marquardt(pixels, weights, start, False, _ROUGH)
        if not rough.is_found or rough.parameters[HIGH] <= rough.parameters[LOW]:
            break
        start = rough.parameters
        before, sigma = sigma, np.exp(start[LOG_SIGMA])
        is_clipped = half_width < band_half_width(before)
        if abs(sigma - before) <= _WINDOW_AGREES * before or is_clipped:
            break
    return _Window(rough, pixels, weights, half_width)


@njit(cache=True, error_model="numpy")
def _without_shading(
    image_dn: FloatArray,
    line: EdgeLine,
    clearance_px: float,
    window: _Window,
    distances: FloatArray,
) -> tuple[_Window, bool]:
    """Subtract slopes across the edge and fit again; also whether there were any."""
    parameters = window.rough.parameters
    contrast = parameters[HIGH] - parameters[LOW]
    slopes = slopes_across(image_dn, line, window.half_width_px, clearance_px, contrast)
    if is_even(slopes):
        return window, False
    pixels = window.pixels
    along = np.cos(line.normal_rad) * pixels.y - np.sin(line.normal_rad) * pixels.x
    shading = shading_levels(slopes, distances, along, np.exp(parameters[LOG_SIGMA]))
    even = BandPixels(
        pixels.x,
        pixels.y,
        pixels.values - shading,
        pixels.across,
        pixels.normal_rad,
        pixels.half_length_px,
    )
    rough = levenberg_marquardt(even, window.weights, parameters, False, _ROUGH)
    return _Window(rough, even, window.weights, window.half_width_px), True


@njit(cache=True, error_model="numpy")
def _weighed(window: _Window, found: EdgeLevels, is_noise_known: bool) -> tuple[FloatArray, bool]:
    """Weights of the pixels from their residuals, and whether there are outliers."""
    parameters, weights = window.rough.parameters, window.weights
    scatter = noise_part(window.pixels.values - found.levels, found.distances)
    if not is_noise_known:
        weights = _side_weights(scatter, found.edges)
    contrast = parameters[HIGH] - parameters[LOW]
    has_outliers, outliers = outlier_weights(scatter, 1.0 / np.sqrt(weights), contrast)
    return (weights * outliers if has_outliers else weights), has_outliers


@njit(cache=True, error_model="numpy")
def _widths(pixels: BandPixels, weights: FloatArray, start: FloatArray) -> _Widths:
    """Fit the plain edge, and from there the one behind pixel squares."""
    total = levenberg_marquardt(pixels, weights, start, False, _FINE)
    start = total.parameters.copy()
    start[LOG_SIGMA] = 0.5 * log(max(np.exp(2 * start[LOG_SIGMA]) - 1 / 12, 0.02))
    return _Widths(total, levenberg_marquardt(pixels, weights, start, True, _FINE))


@njit(cache=True, error_model="numpy")
def _is_square(widths: _Widths) -> bool:
    """Whether the edge behind pixel squares fits better."""
    return bool(widths.optical.is_found and widths.optical.squares < widths.total.squares)


@njit(cache=True, error_model="numpy")
def _best_levels(pixels: BandPixels, widths: _Widths) -> EdgeLevels:
    if _is_square(widths):
        return edge_values(pixels, widths.optical.parameters, True)
    return edge_values(pixels, widths.total.parameters, False)


@njit(cache=True, error_model="numpy")
def _with_slopes_along(
    pixels: BandPixels, weights: FloatArray, flat: _Widths, found: EdgeLevels
) -> tuple[_Widths, bool]:
    """Also fit slopes of the levels along the edge, if significant; and whether they are."""
    is_square = _is_square(flat)
    best = flat.optical if is_square else flat.total
    gain = slopes_gain(pixels, weights, pixels.values - found.levels, found.edges)
    freedom = int(np.count_nonzero(weights)) - SHADED_PARAMETERS
    # The score estimates what the slopes could gain; mostly that is too little.
    if freedom <= 0 or _p_of_two_more(gain, best.squares - gain, freedom) > _SHADING_SCORE_P:
        return flat, False
    start = np.zeros(SHADED_PARAMETERS)
    start[:FLAT_PARAMETERS] = best.parameters
    # Constants, as each shape is compiled for itself.
    if is_square:
        trial = levenberg_marquardt(pixels, weights, start, True, _FINE)
    else:
        trial = levenberg_marquardt(pixels, weights, start, False, _FINE)
    slopes = trial.parameters[FLAT_PARAMETERS:]
    p = _p_of_two_more(best.squares - trial.squares, trial.squares, freedom)
    least = _SHADING_LEAST * (trial.parameters[HIGH] - trial.parameters[LOW])
    if not (trial.is_found and p <= _SHADING_P and np.abs(slopes).max() >= least):
        return flat, False
    start[:FLAT_PARAMETERS] = flat.total.parameters
    start[FLAT_PARAMETERS:] = slopes
    total = levenberg_marquardt(pixels, weights, start, False, _FINE)
    if not total.is_found:
        return flat, False
    start[:FLAT_PARAMETERS] = (
        flat.optical.parameters if flat.optical.is_found else total.parameters[:FLAT_PARAMETERS]
    )
    optical = levenberg_marquardt(pixels, weights, start, True, _FINE)
    is_found = flat.optical.is_found and optical.is_found
    optical = Minimum(is_found, optical.parameters, optical.hessian, optical.squares)
    return _Widths(total, optical), True


@njit(cache=True)
def _known_weights(
    across: FloatArray, sigma: float, low: float, high: float, noise_line: FloatArray
) -> FloatArray:
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
def _side_weights(scatter: FloatArray, edges: FloatArray) -> FloatArray:
    """Inverse variances where one side of the edge is noisier than the other, else ones."""
    even = np.ones(len(scatter))
    dark, bright = edges < 0.02, edges > 0.98
    n_dark, n_bright = np.count_nonzero(dark), np.count_nonzero(bright)
    if min(n_dark, n_bright) < _SIDE_PIXELS:
        return even
    low, high = robust_sigma(scatter[dark]) ** 2, robust_sigma(scatter[bright]) ** 2
    if min(low, high) <= 1e-12 * max(low, high):
        return even
    # The logarithm of a ratio of two variances is nearly normal.
    scatter_of_log = sqrt((2.0 / n_dark + 2.0 / n_bright) / _MAD_EFFICIENCY)
    if abs(log(high / low)) < _UNEVEN_SIGMAS * scatter_of_log:
        return even
    return sqrt(low * high) / (low + (high - low) * edges)


@njit(cache=True)
def _p_of_two_more(gain: float, left: float, freedom: int) -> float:
    """Probability that two superfluous parameters gain that much: F-test, in closed form."""
    if left <= 0:
        return 1.0 if gain <= 0 else 0.0
    return float((1.0 + max(gain, 0.0) / left) ** (-0.5 * freedom))


@njit(cache=True)
def _width_fit(minimum: Minimum) -> WidthFit:
    """Fit with the element of the inverse that belongs to log sigma."""
    hessian = minimum.hessian
    if not minimum.is_found:
        return WidthFit(False, minimum.parameters, 0.0, minimum.squares)
    scale = np.sqrt(np.diag(hessian)) + 1e-300
    unit = np.zeros(len(scale))
    unit[LOG_SIGMA] = 1.0
    scaled = hessian / scale / scale.reshape(-1, 1)
    for j in range(len(scale)):
        scaled[j, j] += 1e-14
    variance = max(np.linalg.solve(scaled, unit)[LOG_SIGMA], 0.0) / scale[LOG_SIGMA] ** 2
    return WidthFit(True, minimum.parameters, float(variance), minimum.squares)
