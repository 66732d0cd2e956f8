"""The raw pixels around a fitted edge by their distance from it, and the edge's roughness."""

from dataclasses import dataclass, field, replace
from math import cos, pi, sin, sqrt

import numpy as np

from calibration.edge_fit import (
    EdgeFit,
    EdgeShape,
    edge_profile,
    shading_levels,
    shape_slopes,
    slopes_across,
)
from calibration.edge_search import EdgeLine, EdgeSegment, band_half_width, band_pixels
from simulation.arrays import BoolArray, FloatArray
from simulation.compiled import compiled

_ROUGHNESS_PIECE_PX = 4.0
_ROUGHNESS_PIECES = 4  # fewer give no scatter
_NARROWEST_BAND_PX = 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeSamples:
    """Raw pixels around one edge, shape ``(n,)`` each, from the dark to the bright side.

    ``distance_px`` is signed, across the edge; its bend is taken out. ``along_px`` is the position
    along the edge. ``levels_dn`` are the pixels as they are.
    """

    distance_px: FloatArray = field(repr=False)
    along_px: FloatArray = field(repr=False)
    levels_dn: FloatArray = field(repr=False)
    low_dn: float
    high_dn: float
    normal_rad: float
    half_length_px: float

    @property
    def unit_levels(self) -> FloatArray:
        """Levels scaled so that the fitted ones are 0 and 1."""
        return (self.levels_dn - self.low_dn) / (self.high_dn - self.low_dn)


def edge_samples(
    image_dn: FloatArray, segment: EdgeSegment, fit: EdgeFit, half_width_px: float
) -> EdgeSamples:
    """Collect the pixels within ``half_width_px`` of a fitted edge, up to its clearance.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``.
    segment
        Where the edge was found: which side is bright, and how near the next edge is.
    fit
        The fit on the same image.
    half_width_px
        Reach on either side.
    """
    # A fit knows its normal modulo pi; the segment knows which side is bright.
    turn = (fit.normal_rad - segment.normal_rad + pi / 2) % pi - pi / 2
    normal = segment.normal_rad + turn
    half_width = min(max(half_width_px, _NARROWEST_BAND_PX), segment.clearance_px)
    line = EdgeLine(fit.x_px, fit.y_px, normal, 0.5 * segment.length_px)
    band = band_pixels(image_dn, line, half_width)
    along = -sin(normal) * band.x + cos(normal) * band.y
    return EdgeSamples(
        distance_px=band.across - 0.5 * fit.curvature_per_px * along**2,
        along_px=along,
        levels_dn=band.values,
        low_dn=fit.low_dn,
        high_dn=fit.high_dn,
        normal_rad=normal,
        half_length_px=line.half_length_px,
    )


def without_shading(
    samples: EdgeSamples, image_dn: FloatArray, segment: EdgeSegment, fit: EdgeFit
) -> EdgeSamples:
    """Take off the slopes of the levels across the edge and along it, as the edge fit does.

    ``samples`` and ``fit`` are in pixels of the image.
    """
    if "shaded" not in fit.flags:
        return samples
    half_width = min(band_half_width(fit.sigma_px), segment.clearance_px)
    contrast = samples.high_dn - samples.low_dn
    slopes = slopes_across(image_dn, segment.line, half_width, segment.clearance_px, contrast)
    levels = samples.levels_dn - shading_levels(
        slopes, samples.distance_px, samples.along_px, fit.sigma_px
    )
    bright = edge_profile(samples.distance_px, fit.sigma_px)
    design = samples.along_px[:, None] * np.column_stack([1 - bright, bright])
    left = levels - samples.low_dn - contrast * bright
    along = np.linalg.lstsq(design, left, rcond=None)[0]
    return replace(samples, levels_dn=levels - design @ along)


def roughness_px(samples: EdgeSamples, sigma_px: float) -> float | None:
    """RMS deviation of the edge from its line or arc over pieces of 4 px, noise removed.

    Each piece is shifted to where its pixels fit the Gaussian edge best, by one Gauss-Newton
    step; what the pixels' noise alone would scatter is subtracted in squares.

    Returns
    -------
    float or None
        None where there are fewer than four pieces with pixels on the edge.
    """
    variance = _roughness_px2(
        samples.distance_px,
        samples.along_px + samples.half_length_px,
        samples.unit_levels,
        sigma_px,
    )
    return sqrt(max(variance, 0.0)) if variance > -np.inf else None


@compiled()
def _roughness_px2(
    distance: FloatArray, along: FloatArray, unit_levels: FloatArray, sigma_px: float
) -> float:
    """Variance of the pieces' shifts less that of the noise; minus infinity with too few pieces."""
    pieces = int(along.max() / _ROUGHNESS_PIECE_PX) + 1
    information, right, squares = np.zeros(pieces), np.zeros(pieces), np.zeros(pieces)
    shape = EdgeShape(sigma_px, 0.0, 0.0, False)
    count = 0
    for i in range(distance.size):
        if abs(distance[i]) > 2 * sigma_px + 1:
            continue
        value, slope, _ = shape_slopes(shape, distance[i])
        residual = unit_levels[i] - value
        k = int(along[i] / _ROUGHNESS_PIECE_PX)
        information[k] += slope * slope
        right[k] += residual * slope
        squares[k] += residual * residual
        count += 1
    least = 0.5 * information.max()
    whole = shift2 = inverse = left = 0.0
    for k in range(pieces):
        left += squares[k]
        if information[k] > least:
            shift = right[k] / information[k]
            left -= shift * right[k]
            whole += 1
            shift2 += shift * shift
            inverse += 1 / information[k]
    if whole < _ROUGHNESS_PIECES:
        return -np.inf
    return (shift2 - left / count * inverse) / whole


def share_within(
    mask: BoolArray, segment: EdgeSegment, fit: EdgeFit, half_width_px: float
) -> float:
    """Share of the pixels near a fitted edge that a mask marks."""
    half_width = min(max(half_width_px, _NARROWEST_BAND_PX), segment.clearance_px)
    line = EdgeLine(fit.x_px, fit.y_px, fit.normal_rad, 0.5 * segment.length_px)
    return float(np.mean(band_pixels(mask, line, half_width).values))
