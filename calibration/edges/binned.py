"""An edge as few numbers: its pixels averaged in narrow bins of distance, for fits of the PSF.

The bins are the same for all edges: 1/16 px wide at the edge, and wider with the distance, where no
PSF has detail. The mean of a bin's levels is that at the mean distance of its pixels, which is
kept: along rows and columns all pixels of a bin may lie to one side of its centre. What the edge
bends within a bin is taken out with the Gaussian that was fitted to it.
"""

from dataclasses import dataclass, field
from math import asinh

import numpy as np

from calibration.edge_search import EdgeSegment, band_half_width
from calibration.edges.fit import EdgeFit
from calibration.edges.model import edge_profile
from calibration.edges.samples import EdgeSamples
from calibration.edges.shading import shading_levels, slopes_across
from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, FloatArray, IntArray

_STEP = 1 / 16  # px, at the edge
_WIDENS_PX = 2.0  # from about this distance on, bins grow in proportion to it
_FEWEST_BINS = 20  # along rows and columns there is one a pixel
_FEWEST_PIXELS = 60
_LEAST_REACH_PX = 3.0
_FLAT = 0.02  # of the contrast: nearer to a level than this, a pixel tells the noise
_OUTLIER_SIGMAS = 6.0
_OUTLIER_LEAST = 0.01  # of the contrast
_LEAST_NOISE = 2e-4  # of the contrast: no camera is better, and the model is no more exact


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BinnedEdge:
    """Levels across one edge in units of its contrast; shape ``(n,)`` each.

    ``bin_index`` counts the bins of ``bin_centres_px`` from the edge, negative on the dark side;
    ``levels`` hold at ``away_px`` from their centres, and ``weights`` are their inverse variances.
    ``along_px`` is the pixels' mean position along the edge. ``normal_rad`` is the direction of the
    normal, ``sigma_px`` the total width of the fitted Gaussian. Lengths are in sensor pixels.
    """

    bin_index: IntArray = field(repr=False)
    away_px: FloatArray = field(repr=False)
    along_px: FloatArray = field(repr=False)
    levels: FloatArray = field(repr=False)
    weights: FloatArray = field(repr=False)
    normal_rad: float
    sigma_px: float

    @property
    def distance_px(self) -> FloatArray:
        """Signed distances of the levels from the edge: means of the bins' pixels."""
        return bin_centres_px(self.bin_index) + self.away_px


def bin_centres_px(bin_index: IntArray) -> FloatArray:
    """Signed distances from the edge of the centres of bins."""
    return np.asarray(_WIDENS_PX * np.sinh(np.asarray(bin_index) * _STEP / _WIDENS_PX))


def bin_index_at(distance_px: float) -> int:
    """Index of the bin in which a distance lies."""
    return round(_WIDENS_PX / _STEP * asinh(distance_px / _WIDENS_PX))


def bin_edge(samples: EdgeSamples, fit: EdgeFit, pitch_px: int = 1) -> BinnedEdge | None:
    """Average the pixels around an edge in bins of distance.

    Parameters
    ----------
    samples
        Pixels around the edge, in pixels of their plane, without shading.
    fit
        The edge, in sensor pixels.
    pitch_px
        Sensor pixels between neighbours of the plane.

    Returns
    -------
    BinnedEdge or None
        None where the pixels are too few or reach too little to either side.
    """
    distance, levels = samples.distance_px * pitch_px, samples.unit_levels
    along = samples.along_px * pitch_px
    if distance.size < _FEWEST_PIXELS:
        return None
    if min(-float(distance.min()), float(distance.max())) < _LEAST_REACH_PX * pitch_px:
        return None
    edge = _gaussian_edge(distance, fit)
    index = np.rint(_WIDENS_PX / _STEP * np.arcsinh(distance / _WIDENS_PX)).astype(np.int64)
    bins = index - index.min()
    kept = ~_outliers(bins, levels - edge)
    bins, levels, edge, distance = bins[kept], levels[kept], edge[kept], distance[kept]
    along = along[kept]
    count = np.bincount(bins)
    filled = count > 0
    number = np.flatnonzero(filled) + int(index.min())
    if number.size < _FEWEST_BINS:
        return None
    count = count[filled]
    at = _means(bins, distance, filled)
    level = _gaussian_edge(at, fit)
    variance = _variances(bins, levels - edge, level, filled)
    return BinnedEdge(
        bin_index=number,
        away_px=at - bin_centres_px(number),
        along_px=_means(bins, along, filled),
        levels=level + _means(bins, levels - edge, filled),
        weights=count / variance,
        normal_rad=samples.normal_rad,
        sigma_px=fit.sigma_px,
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
    levels = samples.levels_dn - shading_levels(slopes, samples.distance_px, fit.sigma_px)
    bright = edge_profile(samples.distance_px, fit.sigma_px)
    design = samples.along_px[:, None] * np.column_stack([1 - bright, bright])
    left = levels - samples.low_dn - contrast * bright
    along = np.linalg.lstsq(design, left, rcond=None)[0]
    return EdgeSamples(
        distance_px=samples.distance_px,
        along_px=samples.along_px,
        levels_dn=levels - design @ along,
        low_dn=samples.low_dn,
        high_dn=samples.high_dn,
        normal_rad=samples.normal_rad,
        half_length_px=samples.half_length_px,
    )


def _gaussian_edge(distance_px: FloatArray, fit: EdgeFit) -> FloatArray:
    """The fitted edge, with the pixel's square where the lens is known apart from it."""
    if fit.optical_sigma_px is None:
        return edge_profile(distance_px, fit.sigma_px)
    return edge_profile(distance_px, fit.optical_sigma_px, fit.normal_rad)


def _means(bins: IntArray, values: FloatArray, filled: BoolArray) -> FloatArray:
    return np.asarray((np.bincount(bins, values)[filled]) / np.bincount(bins)[filled])


def _outliers(bins: IntArray, values: FloatArray) -> BoolArray:
    """Pixels far from their bin's mean: dust and defects."""
    mean = np.bincount(bins, values) / np.maximum(np.bincount(bins), 1)
    away = values - mean[bins]
    limit = max(_OUTLIER_SIGMAS * robust_sigma(away), _OUTLIER_LEAST)
    return np.asarray(np.abs(away) > limit)


def _variances(
    bins: IntArray, values: FloatArray, edge: FloatArray, filled: BoolArray
) -> FloatArray:
    """Variance of one pixel in each bin, from the scatter within the bins of either side.

    Between the sides it changes in proportion to the level, as that of shot noise does.
    """
    total, count = np.bincount(bins)[filled], np.zeros(2)
    mean = _means(bins, values, filled)
    position = np.cumsum(filled) - 1
    squares = np.bincount(bins, (values - mean[position[bins]]) ** 2)[filled]
    sides = np.array([edge < _FLAT, edge > 1 - _FLAT])
    count = np.array([np.sum((total - 1)[side]) for side in sides], dtype=np.float64)
    sums = np.array([np.sum(squares[side]) for side in sides])
    if not np.all(count > 0):
        count, sums = np.full(2, max(np.sum(total - 1), 1)), np.full(2, np.sum(squares))
    low, high = np.maximum(sums / count, _LEAST_NOISE**2).tolist()
    return np.asarray(low + (high - low) * edge)
