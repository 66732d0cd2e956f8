"""What the fit of an edge finds: two shapes, and what the pixels beside them say."""

from math import sqrt
from typing import NamedTuple

import numpy as np

from calibration.edge_fit.least_squares import Minimum, inverse_element
from calibration.edge_fit.model import FLAT_PARAMETERS, LOG_SIGMA, EdgeLevels
from calibration.edge_fit.residuals import ProfileFigures, profile_figures
from calibration.edge_fit.rounding import Rounding
from calibration.edge_fit.weights import PixelWeights
from calibration.edge_search import BandPixels
from simulation.arrays import BoolArray, FloatArray
from simulation.compiled import compiled_part


class WidthFit(NamedTuple):
    """One edge shape fitted to the pixels; valid only if ``is_found``.

    The parameters are in the order of ``calibration.edge_fit.model``, the width as log sigma.
    """

    is_found: bool
    parameters: FloatArray
    log_sigma_variance: float


class LikelyEdge(NamedTuple):
    """The fitted edges: plain (total width) and behind pixel squares (optical width).

    If ``total`` is not found, the rest is not valid. ``is_square`` tells whether the optical edge
    fits better; ``chi2_reduced`` is that of the better one, in terms of the weights. In a
    ``is_censored`` fit the clipped pixels are bounds, else levels like the others.
    ``rounding`` tells of rounding errors that noise does not make random.
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
def no_edge() -> LikelyEdge:
    """Return the result where no edge fits."""
    void = WidthFit(False, np.zeros(FLAT_PARAMETERS), 0.0)
    profile = ProfileFigures(0.0, 0.0, 0.0, 0.0, 0, 0)
    none = Rounding(0.0, 0.0, 0.0, 0.0)
    return LikelyEdge(void, void, False, 0.0, 0.0, 0.0, False, False, False, profile, none)


class Fits(NamedTuple):
    """Both shapes, the levels of the better one, its residuals and the noise before rounding."""

    total: WidthFit
    optical: WidthFit
    is_square: bool
    found: EdgeLevels
    residuals: FloatArray
    noise_dn: tuple[float, float]


class Widths(NamedTuple):
    """The plain edge and the one behind pixel squares, fitted to the same pixels."""

    total: Minimum
    optical: Minimum


@compiled_part()
def width_fit(minimum: Minimum, freedom: int) -> WidthFit:
    """Fit with the variance of log sigma from the inverse Hessian, scaled by the scatter."""
    if not minimum.is_found:
        return WidthFit(False, minimum.parameters, 0.0)
    variance = inverse_element(minimum.hessian, LOG_SIGMA)
    return WidthFit(True, minimum.parameters, variance * minimum.squares / freedom)


@compiled_part()
def likely_edge(
    fits: Fits,
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
