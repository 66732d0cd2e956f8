"""An edge as few numbers: its pixels averaged in narrow bins of distance.

The bins are the same for all edges: 1/16 px wide at the edge, and wider with the distance, where no
PSF has detail. The mean of a bin's levels is that at the mean distance of its pixels, which is
kept: along rows and columns all pixels of a bin may lie to one side of its centre. What the edge
bends within a bin is taken out with the Gaussian that was fitted to it.

The e-SFR and the fits of a lens to many edges start from them.
"""

from dataclasses import dataclass, field
from math import sinh
from typing import NamedTuple

import numpy as np

from calibration.edge_fit import (
    EdgeFit,
    EdgeShape,
    Rounding,
    edge_shape,
    rounding_bias,
    shape_value,
)
from calibration.edges.samples import EdgeSamples
from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.compiled import compiled, compiled_part

_STEP = 1 / 16  # px, at the edge
_WIDENS_PX = 2.0  # from about this distance on, bins grow in proportion to it
_FEWEST_BINS = 20  # along rows and columns there is one a pixel
_FEWEST_PIXELS = 60
_LEAST_REACH_PX = 3.0
_FLAT = 0.02  # of the contrast: nearer to a level than this, a pixel tells the noise
_SUSPECT_SIGMAS = 5.0  # one pixel in two million, in Gaussian noise
_OUTLIER_SIGMAS = 6.0
_OUTLIER_LEAST = 0.01  # of the contrast
_MEDIAN_PIXELS = 25  # at nearly the same distance, for the median that shows an outlier
_LEAST_NOISE = 2e-4  # of the contrast: no camera is better, and the model is no more exact


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BinnedEdge:
    """Levels across one edge in units of its contrast; shape ``(n,)`` each.

    ``bin_index`` counts the bins of ``bin_centres_px`` from the edge, negative on the dark side;
    ``levels`` hold at ``away_px`` from their centres, and ``weights`` are their inverse variances.
    ``along_px`` is the pixels' mean position along the edge. ``normal_rad`` is the direction of the
    normal, ``sigma_px`` the total width of the fitted Gaussian and ``optical_sigma_px`` that
    without the pixel, None where the pixel alone is as wide. Lengths are in sensor pixels, of which
    ``pitch_px`` lie between the centres of neighbours that were used. ``blur_px2`` is a variance
    that this edge has beyond that of the camera, below 0 for less: of its focus or its target.
    """

    bin_index: IntArray = field(repr=False)
    away_px: FloatArray = field(repr=False)
    along_px: FloatArray = field(repr=False)
    levels: FloatArray = field(repr=False)
    weights: FloatArray = field(repr=False)
    normal_rad: float
    sigma_px: float
    optical_sigma_px: float | None = None
    pitch_px: int = 1
    blur_px2: float = 0.0

    @property
    def distance_px(self) -> FloatArray:
        """Signed distances of the levels from the edge: means of the bins' pixels."""
        return bin_centres_px(self.bin_index) + self.away_px


def bin_centres_px(bin_index: IntArray) -> FloatArray:
    """Signed distances from the edge of the centres of bins."""
    return np.asarray(_WIDENS_PX * np.sinh(np.asarray(bin_index) * _STEP / _WIDENS_PX))


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
    distance = samples.distance_px * pitch_px
    if distance.size < _FEWEST_PIXELS:
        return None
    if min(-float(distance.min()), float(distance.max())) < _LEAST_REACH_PX * pitch_px:
        return None
    shape = edge_shape(fit.sigma_px, fit.optical_sigma_px, fit.normal_rad)
    levels, least_noise = samples.unit_levels, _LEAST_NOISE
    if fit.rounding is not None:
        contrast = samples.high_dn - samples.low_dn
        levels = _without_rounding(samples, distance, shape, fit.rounding)
        least_noise = max(least_noise, fit.rounding.error_dn / contrast)
    bins = _binned(distance, levels, samples.along_px * pitch_px, shape, least_noise)
    if bins.numbers.size < _FEWEST_BINS:
        return None
    return BinnedEdge(
        bin_index=bins.numbers,
        away_px=bins.distance - bin_centres_px(bins.numbers),
        along_px=bins.along,
        levels=bins.level,
        weights=bins.weight,
        normal_rad=samples.normal_rad,
        sigma_px=fit.sigma_px,
        optical_sigma_px=fit.optical_sigma_px,
        pitch_px=pitch_px,
    )


def _without_rounding(
    samples: EdgeSamples, distance_px: FloatArray, shape: EdgeShape, rounding: Rounding
) -> FloatArray:
    """Unit levels less the mean error that rounding has at the levels of the fitted edge."""
    contrast = samples.high_dn - samples.low_dn
    bright = _shape_values(shape, distance_px)
    bias = rounding_bias(samples.levels_dn, samples.low_dn + contrast * bright, bright, rounding)
    return samples.unit_levels - bias / contrast


class _Bins(NamedTuple):
    """What is in each bin with a pixel in it: its number, and means over its pixels."""

    numbers: IntArray
    distance: FloatArray
    along: FloatArray
    level: FloatArray
    weight: FloatArray


@compiled()
def _shape_values(shape: EdgeShape, distance_px: FloatArray) -> FloatArray:
    values = np.empty(distance_px.size)
    for i in range(distance_px.size):
        values[i] = shape_value(shape, distance_px[i])
    return values


@compiled()
def _binned(
    distance: FloatArray,
    levels: FloatArray,
    along: FloatArray,
    shape: EdgeShape,
    least_noise: float,
) -> _Bins:
    number, first = _numbers(distance)
    left = levels - _shape_values(shape, distance)
    sums = _sums(number, distance, along, left)
    pooled = np.sqrt(np.sum(sums.squares) / max(np.sum(sums.pixels) - sums.pixels.size, 1.0))
    limit = max(_SUSPECT_SIGMAS * pooled, _OUTLIER_LEAST)
    if _farthest(number, left, sums.left) > limit:
        kept = np.flatnonzero(_without_outliers(distance, left))
        sums = _sums(number[kept], distance[kept], along[kept], left[kept])
    filled = np.flatnonzero(sums.pixels > 0)
    count, at = sums.pixels[filled], sums.distance[filled]
    level = _shape_values(shape, at)
    variance = _variances(count, sums.squares[filled], level, least_noise)
    return _Bins(
        filled + first, at, sums.along[filled], level + sums.left[filled], count / variance
    )


@compiled_part()
def _numbers(distance: FloatArray) -> tuple[IntArray, int]:
    """Bin of each distance, counted from the first one, and the first one's index."""
    farthest = np.abs(distance).max()
    last = int(_WIDENS_PX / _STEP * np.arcsinh(farthest / _WIDENS_PX)) + 2
    # A table over the distance is near enough to begin with: bins are never narrower.
    table = np.empty(int(farthest / _STEP) + 2, np.int64)
    for k in range(table.size):
        table[k] = int(np.floor(_WIDENS_PX / _STEP * np.arcsinh(k * _STEP / _WIDENS_PX) + 0.5))
    end = np.empty(last + 2)
    for k in range(end.size):
        end[k] = _WIDENS_PX * sinh((k + 0.5) * _STEP / _WIDENS_PX)
    number = np.empty(distance.size, np.int64)
    for i in range(distance.size):
        away = abs(distance[i])
        k = table[int(away / _STEP)]
        while away > end[k]:
            k += 1
        number[i] = k if distance[i] > 0 else -k
    first = number.min()
    return number - first, first


class _Sums(NamedTuple):
    """Number of the pixels in each bin, their means, and the squares of what differs from one."""

    pixels: FloatArray
    distance: FloatArray
    along: FloatArray
    left: FloatArray
    squares: FloatArray


@compiled_part()
def _sums(number: IntArray, distance: FloatArray, along: FloatArray, left: FloatArray) -> _Sums:
    """Sums over the pixels of each bin; ``left`` is what the Gaussian leaves of their levels."""
    bins = number.max() + 1
    table = np.zeros((bins, 5))
    for i in range(left.size):
        bin_ = table[number[i]]
        bin_[0] += 1.0
        bin_[1] += distance[i]
        bin_[2] += along[i]
        bin_[3] += left[i]
        bin_[4] += left[i] * left[i]
    count = table[:, 0].copy()
    per_pixel = 1.0 / np.maximum(count, 1.0)
    mean = table[:, 3] * per_pixel
    # What is left is so small that the difference of the squares is exact enough.
    squares = np.maximum(table[:, 4] - count * mean * mean, 0.0)
    return _Sums(count, table[:, 1] * per_pixel, table[:, 2] * per_pixel, mean, squares)


@compiled_part()
def _farthest(number: IntArray, left: FloatArray, mean: FloatArray) -> float:
    """Largest distance of a pixel from the mean of its bin."""
    farthest = 0.0
    for i in range(left.size):
        farthest = max(farthest, abs(left[i] - mean[number[i]]))
    return farthest


@compiled_part()
def _without_outliers(distance: FloatArray, left: FloatArray) -> BoolArray:
    """Pixels that are not far from the median at their distance: dust and defects are."""
    order = np.argsort(distance)
    away = np.empty(distance.size)
    for start in range(0, distance.size, _MEDIAN_PIXELS):
        some = order[start : start + _MEDIAN_PIXELS]
        median = np.median(left[some])
        for i in some:
            away[i] = left[i] - median
    limit = max(_OUTLIER_SIGMAS * robust_sigma(away), _OUTLIER_LEAST)
    return np.abs(away) <= limit


@compiled_part()
def _variances(
    count: FloatArray, squares: FloatArray, level: FloatArray, least_noise: float
) -> FloatArray:
    """Variance of one pixel in each bin, from the scatter within the bins of either side.

    Between the sides it changes in proportion to the level, as that of shot noise does.
    """
    freedom, sums = np.zeros(3), np.zeros(3)  # of the dark side, the bright one, and all
    for k in range(count.size):
        side = 0 if level[k] < _FLAT else 1 if level[k] > 1 - _FLAT else 2
        freedom[side] += count[k] - 1
        sums[side] += squares[k]
    if min(freedom[0], freedom[1]) > 0:
        low, high = sums[0] / freedom[0], sums[1] / freedom[1]
    else:
        low = high = np.sum(sums) / max(np.sum(freedom), 1.0)
    low, high = max(low, least_noise**2), max(high, least_noise**2)
    variance: FloatArray = low + (high - low) * level
    return variance
