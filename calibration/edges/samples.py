"""The raw pixels around a fitted edge by their distance from it, and the edge's roughness."""

from dataclasses import dataclass, field
from math import cos, pi, sin, sqrt

import numpy as np

from calibration.edge_search import EdgeLine, EdgeSegment, band_pixels
from calibration.edges.fit import EdgeFit
from calibration.edges.model import edge_profile
from simulation.arrays import FloatArray

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


def roughness_px(samples: EdgeSamples, sigma_px: float) -> float | None:
    """RMS deviation of the edge from its line or arc over pieces of 4 px, noise removed.

    Each piece is shifted to where its pixels fit the Gaussian edge best, by one Gauss-Newton
    step; what the pixels' noise alone would scatter is subtracted in squares.

    Returns
    -------
    float or None
        None where there are fewer than four pieces with pixels on the edge.
    """
    near = np.abs(samples.distance_px) <= 2 * sigma_px + 1
    distance = samples.distance_px[near]
    slope = np.exp(-0.5 * (distance / sigma_px) ** 2) / (sigma_px * sqrt(2 * pi))
    residual = samples.unit_levels[near] - edge_profile(distance, sigma_px)
    position = np.floor((samples.along_px[near] + samples.half_length_px) / _ROUGHNESS_PIECE_PX)
    pieces = position.astype(np.int64)
    information = np.bincount(pieces, slope**2)
    right = np.bincount(pieces, residual * slope)
    whole = information > 0.5 * float(np.max(information, initial=0.0))
    if np.count_nonzero(whole) < _ROUGHNESS_PIECES:
        return None
    shift = right[whole] / information[whole]
    left = (
        residual
        - np.where(information > 0, right / np.where(whole, information, np.inf), 0.0)[pieces]
        * slope
    )
    noise2 = float(np.var(left)) / information[whole]
    return sqrt(max(float(np.mean(shift**2 - noise2)), 0.0))
