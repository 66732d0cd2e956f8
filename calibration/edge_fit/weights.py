"""Weights of the pixels of an edge: inverse variances, less where a pixel stands out."""

from math import log, sqrt
from typing import NamedTuple

import numpy as np

from calibration.edge_fit.residuals import between, cut_variance, outlier_weights
from simulation.arrays import BoolArray, FloatArray
from simulation.compiled import compiled_part

_UNEVEN_SIGMAS = 3.1  # one in a thousand
_SIDE_PIXELS = 30
_LEAST_NOISE = 1e-6  # of the contrast: less is rounding of the arithmetic
_SIDE = 0.02  # of the contrast: nearer to a level than this, a pixel tells the noise of its side


class PixelWeights(NamedTuple):
    """Weights, shape ``(n,)``, the outliers' part in them, and whether there are outliers."""

    weights: FloatArray
    outliers: FloatArray
    has_outliers: bool


@compiled_part()
def known_weights(
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


@compiled_part()
def pixel_weights(
    noise: tuple[FloatArray, BoolArray],
    edges: FloatArray,
    known: FloatArray,
    contrast: float,
    step_dn: float,
) -> PixelWeights:
    """Weigh each pixel by its noise, with Tukey's biweights where single pixels stand out.

    Parameters
    ----------
    noise
        Residuals less what depends on the distance from the edge alone, and which of them tell no
        noise as their pixels are clipped; shape ``(n,)`` each.
    edges
        The unit edge at each pixel.
    known
        Inverse variances; empty where the scatter has to tell them.
    contrast
        High minus low level, DN.
    step_dn
        Steps in which the levels come; 0 where they are fine.
    """
    scatter, is_clipped = noise
    least = step_dn**2 / 12 + (_LEAST_NOISE * contrast) ** 2
    weights = known if len(known) > 0 else _side_weights(scatter, edges, least)
    spread = np.empty(len(weights))
    for i in range(len(weights)):
        spread[i] = 1.0 / sqrt(weights[i])
    found, outliers = outlier_weights(scatter, is_clipped, spread, contrast, step_dn)
    return PixelWeights(weights * outliers if found else weights, outliers, found)


@compiled_part()
def _side_weights(scatter: FloatArray, edges: FloatArray, least_variance: float) -> FloatArray:
    """Inverse variances where one side of the edge is noisier than the other, else ones."""
    weights = np.ones(len(scatter))
    dark, bright = between(scatter, edges, -1.0, _SIDE), between(scatter, edges, 1 - _SIDE, 2.0)
    if min(len(dark), len(bright)) < _SIDE_PIXELS:
        return weights
    low = max(cut_variance(dark), least_variance)
    high = max(cut_variance(bright), least_variance)
    if min(low, high) <= 1e-12 * max(low, high):
        return weights
    # The logarithm of a ratio of two variances is nearly normal.
    scatter_of_log = sqrt(2.0 / len(dark) + 2.0 / len(bright))
    if abs(log(high / low)) < _UNEVEN_SIGMAS * scatter_of_log:
        return weights
    for i in range(len(weights)):
        weights[i] = sqrt(low * high) / (low + (high - low) * edges[i])
    return weights
