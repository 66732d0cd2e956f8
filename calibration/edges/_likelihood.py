"""The most likely edge for the pixels of a rotated rectangle.

The stages: a band of pixels that fits the edge's width, with a rough fit; slopes across the edge
taken off; weights from the residuals; the total and the optical width; slopes along the edge, where
the pixels ask for them. Together they take some six passes over the pixels, compiled as a whole:
calls from Python in between would double the time, as ``benchmarks/speed/edge_fit.py`` says. Where
levels are rounded or clipped so that it matters, a second part goes on from there.
``calibration.edges._fit`` makes the result readable.
"""

from math import log, sqrt
from typing import NamedTuple, TypeAlias

import numpy as np

from calibration.edges._model import (
    CURVATURE,
    FLAT_PARAMETERS,
    HIGH,
    LOG_SIGMA,
    LOW,
    OFFSET,
    SHADED_PARAMETERS,
    TURN,
    EdgeLevels,
    Minimum,
    edge_values,
    inverse_element,
    levenberg_marquardt,
    slopes_gain,
)
from calibration.edges._residuals import (
    COARSE,
    LevelSteps,
    PixelWeights,
    ProfileFigures,
    Rounding,
    is_coarse,
    known_weights,
    level_steps,
    noise_part,
    pixel_weights,
    profile_figures,
    rounding_of,
)
from calibration.edges._rounded import (
    Intervals,
    are_censored,
    clipped_pixels,
    expected_residuals,
    is_more_likely,
    level_intervals,
    maximise_intervals,
    pixel_intervals,
)
from calibration.edges._segments import (
    BandPixels,
    EdgeLine,
    band_half_width,
    band_pixels,
    side_level,
)
from calibration.edges._shading import is_even, shading_levels, slopes_across, unclipped_slopes
from simulation.arrays import BoolArray, FloatArray
from simulation.compiled import compiled, compiled_part


class WidthFit(NamedTuple):
    """One edge shape fitted to the pixels; valid only if ``is_found``.

    The parameters are in the order of ``calibration.edges._model``, the width as log sigma.
    """

    is_found: bool
    parameters: FloatArray
    log_sigma_variance: float


class LikelyEdge(NamedTuple):
    """The fitted edges: plain (total width) and behind pixel squares (optical width).

    If ``total`` is not found, the rest is not valid. ``is_square`` tells whether the optical edge
    fits better; ``chi2_reduced`` is that of the better one. In a ``is_censored`` fit the clipped
    pixels are bounds.
    """

    total: WidthFit
    optical: WidthFit
    is_square: bool
    chi2_reduced: float
    noise_dn: float
    clipped_fraction: float
    is_censored: bool
    has_outliers: bool
    is_shaded: bool
    profile: ProfileFigures
    rounding: Rounding


@compiled_part()
def _no_edge() -> LikelyEdge:
    """Return the result where no edge fits."""
    void = WidthFit(False, np.zeros(FLAT_PARAMETERS), 0.0)
    profile = ProfileFigures(0.0, 0.0, 0.0, 0.0, 0, 0)
    none = Rounding(0.0, 0.0, 0.0, 0.0)
    return LikelyEdge(void, void, False, 0.0, 0.0, 0.0, False, False, False, profile, none)


class _Fits(NamedTuple):
    """Both shapes, the levels of the better one, its residuals and the noise before rounding."""

    total: WidthFit
    optical: WidthFit
    is_square: bool
    found: EdgeLevels
    residuals: FloatArray
    noise_dn: tuple[float, float]


class _Widths(NamedTuple):
    """The plain edge and the one behind pixel squares, fitted to the same pixels."""

    total: Minimum
    optical: Minimum


@compiled_part()
def _width_fit(minimum: Minimum, freedom: int) -> WidthFit:
    """Fit with the variance of log sigma from the inverse Hessian, scaled by the scatter."""
    if not minimum.is_found:
        return WidthFit(False, minimum.parameters, 0.0)
    variance = inverse_element(minimum.hessian, LOG_SIGMA)
    return WidthFit(True, minimum.parameters, variance * minimum.squares / freedom)


@compiled_part()
def _likely_edge(
    fits: _Fits,
    pixels: BandPixels,
    weighed: PixelWeights,
    clipped: tuple[BoolArray, float],
    is_shaded: bool,
    rounding: Rounding,
) -> LikelyEdge:
    """The fits with what their residuals say, and with the pixels that were fitted as bounds."""
    values, weights = pixels.values, weighed.weights
    is_bound, clipped_fraction = clipped
    count, total, squares, weighed_squares = 0, 0.0, 0.0, 0.0
    for i in range(len(values)):
        if weights[i] > 0 and not is_bound[i]:
            residual = values[i] - fits.found.levels[i]
            count += 1
            total += residual
            squares += residual * residual
            weighed_squares += weights[i] * residual * residual
    sigma = np.exp(fits.total.parameters[LOG_SIGMA])
    return LikelyEdge(
        fits.total,
        fits.optical,
        fits.is_square,
        weighed_squares / max(count - FLAT_PARAMETERS, 1),
        sqrt(max(squares / count - (total / count) ** 2, 0.0)),
        clipped_fraction,
        bool(np.any(is_bound)),
        weighed.has_outliers,
        is_shaded,
        profile_figures(values, fits.residuals, fits.found.distances, weights, sigma),
        rounding,
    )


Bounded: TypeAlias = tuple[
    tuple[FloatArray, FloatArray, FloatArray, FloatArray, float],
    float,
    tuple[FloatArray, FloatArray, bool],
    tuple[FloatArray, FloatArray, FloatArray],
    tuple[FloatArray, FloatArray, bool],
    tuple[FloatArray, FloatArray, float],
    tuple[bool, FloatArray, FloatArray, float],
    tuple[BoolArray, float],
    tuple[bool, bool],
]
"""What least squares found: the fields of ``BandPixels``, ``PixelWeights`` and ``EdgeLevels``; both
shapes' parameters, and whether the second was found; the stored levels, their scatter and the
contrast; the fields of ``LevelSteps``; which pixels are clipped, and the share of those that were;
whether the levels are shaded, and rounded.

Plain tuples: for a named one its class is looked up at each return to Python, which takes 3 us."""


@compiled()
def _within_bounds(found: Bounded) -> LikelyEdge:
    """The edge that is most likely before rounding and clipping, if ``total`` is found."""
    (x, y, values, across, normal_rad), half_length_px = found[0], found[1]
    pixels = BandPixels(x, y, values, across, normal_rad, half_length_px)
    weighed = PixelWeights(found[2][0], found[2][1], found[2][2])
    by_squares = EdgeLevels(found[3][0], found[3][1], found[3][2])
    stored, scatter, contrast_dn = found[5]
    steps = LevelSteps(found[6][0], found[6][1], found[6][2], found[6][3])
    is_shaded, is_rounded = found[8]
    levels = level_intervals(stored, steps, scatter, found[7][0], contrast_dn)
    # Of mere noise, biweights take what is large: errors would come out 3 % small.
    is_weighed = is_rounded or weighed.has_outliers
    trust = weighed.outliers if is_weighed else np.ones(len(stored))
    data = pixel_intervals(pixels, stored, levels, trust, by_squares)
    fits = _interval_fits(data, found[4])
    rounding = Rounding(0.0, 0.0, 0.0, 0.0)
    if is_rounded:
        rounding = rounding_of(steps, by_squares.edges, fits.noise_dn)
    return _likely_edge(fits, pixels, weighed, found[7], is_shaded, rounding)


@compiled_part()
def _interval_fits(data: Intervals, widths: tuple[FloatArray, FloatArray, bool]) -> _Fits:
    """From the least squares to the most likely edges before rounding and clipping."""
    total, optical = maximise_intervals(data, (widths[0], widths[1]), widths[2])
    is_square = is_more_likely(optical, total)
    best = optical if is_square else total
    return _Fits(
        WidthFit(total.is_found, total.parameters, total.log_sigma_variance),
        WidthFit(optical.is_found, optical.parameters, optical.log_sigma_variance),
        is_square,
        edge_values(data.pixels, best.parameters, is_square),
        expected_residuals(data, best, is_square),
        best.noise_dn,
    )


_ROUGH, _FINE = 1e-2, 1e-4  # last step of a fit, in px and parts of sigma
_WINDOW_ROUNDS = 4
_WINDOW_AGREES = 0.1  # relative change of sigma that needs no new window
_SHADING_P = 1e-3
_SHADING_SCORE_P = 1e-2  # the score is only an estimate of the F-test
_SHADING_LEAST = 2e-3  # of the contrast over half an edge: less does not move sigma by 0.01 %


class _Window(NamedTuple):
    """The pixels that are fitted, their weights and a rough fit; void where none is found."""

    rough: Minimum
    pixels: BandPixels
    weights: FloatArray
    half_width_px: float


def maximise(
    image_dn: FloatArray,
    line: EdgeLine,
    sigma_px: float,
    clearance_px: float,
    noise_line: FloatArray,
    saturation_dn: float,
) -> LikelyEdge:
    """Fit total and optical width to the pixels around one edge.

    The noise line is offset (DN^2), slope (DN) and floor (DN^2), empty where the residuals have to
    tell it; an unknown saturation is infinite.
    """
    found = _by_squares(image_dn, line, sigma_px, clearance_px, noise_line, saturation_dn)
    if found is None:
        return _no_edge()
    likely, has_bounds, bounded = found
    if has_bounds:
        # What few edges need is compiled when the first one does.
        before = _within_bounds(bounded)
        if before.total.is_found:
            return before
    return likely


@compiled()
def _by_squares(
    image_dn: FloatArray,
    line: EdgeLine,
    sigma_px: float,
    clearance_px: float,
    noise_line: FloatArray,
    saturation_dn: float,
) -> tuple[LikelyEdge, bool, Bounded] | None:
    """The edge by least squares; whether levels were rounded or clipped so that it matters."""
    window = _window(image_dn, line, sigma_px, clearance_px, noise_line)
    if not _is_within(window.rough, window.half_width_px):
        return None
    stored = window.pixels.values
    found = edge_values(window.pixels, window.rough.parameters, False)
    is_clipped = clipped_pixels(stored, saturation_dn)
    clipped_fraction = float(np.mean(is_clipped))
    if not are_censored(is_clipped):
        is_clipped = np.zeros(len(stored), np.bool_)
    window, is_shaded = _without_shading(
        image_dn, line, clearance_px, window, (found.distances, is_clipped)
    )
    if not window.rough.is_found:
        return None
    pixels, parameters = window.pixels, window.rough.parameters
    if is_shaded:
        found = edge_values(pixels, parameters, False)
    steps = level_steps(stored)
    contrast = parameters[HIGH] - parameters[LOW]
    left = pixels.values - found.levels
    is_coarse_step = steps.step_dn > COARSE * contrast
    scatter = noise_part(left, found.distances, is_coarse_step)
    # Clipped pixels do not scatter: they would make theirs the quieter side.
    is_weighed = len(noise_line) > 0 or np.any(is_clipped)
    weighed = pixel_weights(
        (scatter, is_clipped),
        found.edges,
        window.weights if is_weighed else np.empty(0),
        contrast,
        steps.step_dn,
    )
    flat = _widths(pixels, weighed.weights, parameters)
    if not _is_within(flat.total, window.half_width_px):
        return None
    found = _best_levels(pixels, flat)
    widths, has_slopes = _with_slopes_along(pixels, weighed.weights, flat, found)
    if has_slopes:
        found = _best_levels(pixels, widths)
    fits = _smooth_fits(pixels, weighed.weights, widths, found)
    is_rounded = is_coarse(scatter, found.edges, steps)
    is_shaded |= has_slopes
    # Where the clipped pixels turn out to tell nothing, they are levels like the others.
    levels = np.zeros(len(stored), np.bool_), clipped_fraction
    none = Rounding(0.0, 0.0, 0.0, 0.0)
    likely = _likely_edge(fits, pixels, weighed, levels, is_shaded, none)
    bounded = (
        (pixels.x, pixels.y, pixels.values, pixels.across, pixels.normal_rad),
        pixels.half_length_px,
        (weighed.weights, weighed.outliers, weighed.has_outliers),
        (found.levels, found.distances, found.edges),
        (widths.total.parameters, widths.optical.parameters, widths.optical.is_found),
        (stored, scatter, contrast),
        (steps.is_found, steps.lower, steps.upper, steps.step_dn),
        (is_clipped, clipped_fraction),
        (is_shaded, is_rounded),
    )
    return likely, is_rounded or bool(np.any(is_clipped)), bounded


@compiled_part()
def _is_within(fit: Minimum, half_width_px: float) -> bool:
    """Whether an edge was found, and in its band: a fit to what is no edge may leave it for good.

    Turn, offset and curvature are what they move the middle or the ends by, in px.
    """
    p = fit.parameters
    moved_px = max(abs(p[TURN]), abs(p[OFFSET]), abs(p[CURVATURE]))
    return bool(fit.is_found and p[HIGH] > p[LOW] and moved_px <= half_width_px)


@compiled_part()
def _freedom(weights: FloatArray) -> int:
    return max(int(np.count_nonzero(weights)) - FLAT_PARAMETERS, 1)


@compiled_part()
def _smooth_fits(
    pixels: BandPixels, weights: FloatArray, widths: _Widths, found: EdgeLevels
) -> _Fits:
    """The least squares as they are, with their scatter as the noise."""
    freedom = _freedom(weights)
    return _Fits(
        _width_fit(widths.total, freedom),
        _width_fit(widths.optical, freedom),
        _is_square(widths),
        found,
        pixels.values - found.levels,
        (0.0, 0.0),
    )


@compiled_part()
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
        weights = known_weights(pixels.across, sigma, low, high, noise_line)
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


@compiled_part()
def _without_shading(
    image_dn: FloatArray,
    line: EdgeLine,
    clearance_px: float,
    window: _Window,
    sides: tuple[FloatArray, BoolArray],
) -> tuple[_Window, bool]:
    """Subtract slopes across the edge and fit again; also whether there were any.

    ``sides`` are the pixels' distances from the edge and which of them are clipped: levels that
    are cut off tell no slope.
    """
    distances, is_clipped = sides
    parameters = window.rough.parameters
    contrast = parameters[HIGH] - parameters[LOW]
    # The window is that of a rough width, often a wider one: what is taken off goes by the fit's.
    half_width = min(band_half_width(np.exp(parameters[LOG_SIGMA])), window.half_width_px)
    slopes = slopes_across(image_dn, line, half_width, clearance_px, contrast)
    slopes = unclipped_slopes(slopes, distances[is_clipped])
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


@compiled_part()
def _widths(pixels: BandPixels, weights: FloatArray, start: FloatArray) -> _Widths:
    """Fit the plain edge, and from there the one behind pixel squares."""
    total = levenberg_marquardt(pixels, weights, start, False, _FINE)
    start = total.parameters.copy()
    start[LOG_SIGMA] = 0.5 * log(max(np.exp(2 * start[LOG_SIGMA]) - 1 / 12, 0.02))
    return _Widths(total, levenberg_marquardt(pixels, weights, start, True, _FINE))


@compiled_part()
def _is_square(widths: _Widths) -> bool:
    """Whether the edge behind pixel squares fits better."""
    return bool(widths.optical.is_found and widths.optical.squares < widths.total.squares)


@compiled_part()
def _best_levels(pixels: BandPixels, widths: _Widths) -> EdgeLevels:
    if _is_square(widths):
        return edge_values(pixels, widths.optical.parameters, True)
    return edge_values(pixels, widths.total.parameters, False)


@compiled_part()
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
    start = _with_slopes(best.parameters, np.zeros(2))
    trial = levenberg_marquardt(pixels, weights, start, is_square, _FINE)
    slopes = trial.parameters[FLAT_PARAMETERS:]
    p = _p_of_two_more(best.squares - trial.squares, trial.squares, freedom)
    least = _SHADING_LEAST * (trial.parameters[HIGH] - trial.parameters[LOW])
    if not (trial.is_found and p <= _SHADING_P and np.abs(slopes).max() >= least):
        return flat, False
    start = _with_slopes(flat.total.parameters, slopes)
    total = levenberg_marquardt(pixels, weights, start, False, _FINE)
    if not total.is_found:
        return flat, False
    width = flat.optical.parameters if flat.optical.is_found else total.parameters
    start = _with_slopes(width, slopes)
    optical = levenberg_marquardt(pixels, weights, start, True, _FINE)
    is_found = flat.optical.is_found and optical.is_found
    optical = Minimum(is_found, optical.parameters, optical.hessian, optical.squares)
    return _Widths(total, optical), True


@compiled_part()
def _with_slopes(parameters: FloatArray, slopes: FloatArray) -> FloatArray:
    out = np.empty(SHADED_PARAMETERS)
    for k in range(SHADED_PARAMETERS):
        out[k] = parameters[k] if k < FLAT_PARAMETERS else slopes[k - FLAT_PARAMETERS]
    return out


@compiled_part()
def _p_of_two_more(gain: float, left: float, freedom: int) -> float:
    """Probability that two superfluous parameters gain that much: F-test, in closed form."""
    if left <= 0:
        return 1.0 if gain <= 0 else 0.0
    return float((1.0 + max(gain, 0.0) / left) ** (-0.5 * freedom))
