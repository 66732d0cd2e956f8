"""The edge that is most likely before its levels were rounded or clipped."""

from typing import TypeAlias

import numpy as np

from calibration.edge_fit.clipping import level_intervals
from calibration.edge_fit.level_steps import LevelSteps
from calibration.edge_fit.likely_edge import Fits, LikelyEdge, WidthFit, likely_edge
from calibration.edge_fit.model import EdgeLevels, edge_values
from calibration.edge_fit.rounded import (
    Intervals,
    expected_residuals,
    is_more_likely,
    maximise_intervals,
    pixel_intervals,
)
from calibration.edge_fit.rounding import Rounding, rounding_of
from calibration.edge_fit.weights import PixelWeights
from calibration.edge_search import BandPixels
from simulation.arrays import BoolArray, FloatArray
from simulation.compiled import compiled, compiled_part

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
def within_bounds(found: Bounded) -> LikelyEdge:
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
    return likely_edge(fits, pixels, weighed, found[7], is_shaded, rounding)


@compiled_part()
def _interval_fits(data: Intervals, widths: tuple[FloatArray, FloatArray, bool]) -> Fits:
    """From the least squares to the most likely edges before rounding and clipping."""
    total, optical = maximise_intervals(data, (widths[0], widths[1]), widths[2])
    is_square = is_more_likely(optical, total)
    best = optical if is_square else total
    return Fits(
        WidthFit(total.is_found, total.parameters, total.log_sigma_variance),
        WidthFit(optical.is_found, optical.parameters, optical.log_sigma_variance),
        is_square,
        edge_values(data.pixels, best.parameters, is_square),
        expected_residuals(data, best, is_square),
        best.noise_dn,
    )
