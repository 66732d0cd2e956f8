"""The raw pixels around a fitted edge by their distance from it: roughness, straightness, bins.

Whether a border is the straight edge between two even levels that the fit takes it for. Along a
photographed edge nothing changes but noise, which differs from pixel to pixel. Texture went through
the lens, and does not: neighbouring pixels deviate together from the mean profile across the edge.
And no lens bends a straight edge as much as the rim of a small round thing.
``benchmarks/studies/no_edge.py`` has how often either is right.

An edge as few numbers: its pixels averaged in narrow bins of distance. The bins are the same for
all edges: 1/16 px wide at the edge, and wider with the distance, where no PSF has detail. The mean
of a bin's levels is that at the mean distance of its pixels, which is kept: along rows and columns
all pixels of a bin may lie to one side of its centre. What the edge bends within a bin is taken out
with the Gaussian that was fitted to it.

The e-SFR and the fits of a lens to many edges start from them.
"""

from dataclasses import dataclass, field, replace
from math import cos, pi, sin, sinh, sqrt
from typing import NamedTuple

import numpy as np

from calibration.edges._fit import EdgeFit
from calibration.edges._model import EdgeShape, edge_profile, edge_shape, shape_slopes, shape_value
from calibration.edges._residuals import Rounding, rounding_bias
from calibration.edges._segments import EdgeLine, EdgeSegment, band_half_width, band_pixels
from calibration.edges._shading import shading_levels, slopes_across
from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.compiled import compiled, compiled_part

_ROUGHNESS_PIECE_PX = 4.0
_ROUGHNESS_PIECES = 4  # fewer give no scatter
_NARROWEST_BAND_PX = 3.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeSamples:
    """Raw pixels around one edge, shape ``(n,)`` each, from the dark to the bright side.

    ``distance_px`` is signed, across the edge, its bend taken out; ``along_px`` is along it.
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
    """Collect the pixels around a fitted edge up to a half width or its clearance."""
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
    """Take off the slopes of the levels across the edge and along it, as the edge fit does."""
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

    Each piece is shifted to where it fits best, by one Gauss-Newton step; what the pixels' noise
    alone would scatter is subtracted. None with fewer than four pieces.
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


UNEVEN_LEAST, UNEVEN_LEAST_JPEG = 0.02, 0.04
"""Of the contrast. Of the sides of photographed chessboards in JPEG files, one of a hundred reaches
0.034; what is false has 0.06 in the median."""

CURVED_LEAST_PER_PX = 6e-3
"""A radius of 167 px. Lenses with 28 % of distortion leave 99 of 100 sides of chessboards below it;
1 % at the corner of 640 x 480 px makes a radius of 39,000 px."""

_UNEVEN_SIGMAS = 2.5
_CURVED_SIGMAS = 4.0
_BIN_PX = 0.5
_REACH_SIGMAS, _REACH_EXTRA_PX = 4.0, 2.0  # farther out, other things reach into the band
_SINGLE_SIGMAS, _SINGLE_LEAST = 4.0, 0.03  # larger ones are dust, or something beside the edge
_FEWEST_PAIRS = 20


class _Deviations(NamedTuple):
    """How the pixels along an edge deviate from their mean profile across it, of the contrast.

    ``shared`` is the covariance of ``pairs`` of neighbours, ``slope2`` sums squared slopes, px^-2.
    """

    shared: float
    variance: float
    pairs: int
    slope2: float

    @property
    def uneven(self) -> float:
        """RMS of what neighbours share, of the contrast."""
        return sqrt(max(self.shared, 0.0))

    @property
    def uneven_sigmas(self) -> float:
        """The shared part in standard deviations of what independent noise would give."""
        if not self.variance > 0:
            return 0.0
        return self.shared / self.variance * sqrt(self.pairs)

    @property
    def sagitta_err_px(self) -> float:
        """Standard error of the rise of an arc over its chord, from these deviations."""
        # Of (t^2 - 1/3) over t from -1 to 1, the mean square is 4/45.
        return sqrt(self.variance / (self.slope2 * 4 / 45)) if self.slope2 > 0 else np.inf


def border_flags(samples: EdgeSamples, fit: EdgeFit, *, is_jpeg: bool) -> tuple[str, ...]:
    """Flags ``uneven`` and ``curved`` of what is no straight edge between two even levels."""
    noise = fit.noise_dn / (samples.high_dn - samples.low_dn)
    found = _Deviations(
        *_deviations(
            samples.distance_px,
            samples.along_px,
            samples.unit_levels,
            fit.sigma_px,
            float(np.sin(samples.normal_rad)),
            max(_SINGLE_SIGMAS * noise, _SINGLE_LEAST),
        )
    )
    flags = []
    is_beyond_noise = found.pairs >= _FEWEST_PAIRS and found.uneven_sigmas > _UNEVEN_SIGMAS
    if is_beyond_noise and found.uneven > (UNEVEN_LEAST_JPEG if is_jpeg else UNEVEN_LEAST):
        flags.append("uneven")
    sagitta_px = 0.5 * abs(fit.curvature_per_px) * samples.half_length_px**2
    is_bent = abs(fit.curvature_per_px) > CURVED_LEAST_PER_PX
    if is_bent and sagitta_px > _CURVED_SIGMAS * found.sagitta_err_px:
        flags.append("curved")
    return tuple(flags)


@compiled()
def _deviations(
    distance: FloatArray,
    along: FloatArray,
    unit_levels: FloatArray,
    sigma_px: float,
    sine: float,
    largest: float,
) -> tuple[float, float, int, float]:
    """Compare neighbouring pixels near an edge: the fields of ``_Deviations``."""
    reach = _REACH_SIGMAS * sigma_px + _REACH_EXTRA_PX
    n = distance.size
    bins = int(2 * reach / _BIN_PX) + 2
    count, total = np.zeros(bins), np.zeros(bins)
    residuals, index = np.empty(n), np.empty(n, np.int64)
    shape = EdgeShape(sigma_px, 0.0, 0.0, False)
    slope2 = 0.0
    for i in range(n):
        index[i] = -1
        if abs(distance[i]) > reach:
            continue
        value, slope, _ = shape_slopes(shape, distance[i])
        slope2 += slope * slope
        residuals[i] = unit_levels[i] - value
        index[i] = int((distance[i] + reach) / _BIN_PX)
        count[index[i]] += 1
        total[index[i]] += residuals[i]
    squares = shared = 0.0
    kept = pairs = 0
    before = np.inf
    for i in range(n):
        here = np.inf
        if index[i] >= 0:
            here = residuals[i] - total[index[i]] / count[index[i]]
        if abs(here) <= largest:
            kept += 1
            squares += here * here
            # In a row the pixels follow each other; along the edge they are then so far apart.
            if abs(before) <= largest and abs(along[i] - along[i - 1] + sine) < 1e-6:
                pairs += 1
                shared += here * before
        before = here
    return shared / max(pairs, 1), squares / max(kept, 1), pairs, slope2


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
    ``levels`` hold at ``away_px`` from their centres, with inverse variances as ``weights``.
    Lengths are in sensor pixels, ``pitch_px`` between neighbours that were used.
    ``optical_sigma_px`` is None where the pixel alone is as wide; ``blur_px2`` is a variance that
    this edge has beyond that of the camera, below 0 for less.
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
    """Average the pixels around an edge in bins of distance; None for too few or one-sided ones.

    The samples are in pixels of their plane, the fit is in sensor pixels.
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
    bright = shape_values(shape, distance_px)
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
def shape_values(shape: EdgeShape, distance_px: FloatArray) -> FloatArray:
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
    left = levels - shape_values(shape, distance)
    sums = _sums(number, distance, along, left)
    pooled = np.sqrt(np.sum(sums.squares) / max(np.sum(sums.pixels) - sums.pixels.size, 1.0))
    limit = max(_SUSPECT_SIGMAS * pooled, _OUTLIER_LEAST)
    if _farthest(number, left, sums.left) > limit:
        kept = np.flatnonzero(_without_outliers(distance, left))
        sums = _sums(number[kept], distance[kept], along[kept], left[kept])
    filled = np.flatnonzero(sums.pixels > 0)
    count, at = sums.pixels[filled], sums.distance[filled]
    level = shape_values(shape, at)
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
