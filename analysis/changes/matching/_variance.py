"""What the difference of two matched photographs scatters by, as a sum of terms; its calibration.

Each term is an image: the level between the darkest and the brightest, either way, for noise that
may depend on it, half the squared gradient of the source for an alignment that is wrong by so much
(a shift by ``e`` px makes ``e |gradient|``), a quarter of its squared Laplacian for a wrong blur,
and the power of the finest detail of either photograph for aliasing, compression and sharpening;
where the steps of a file are not all alike in light, as with sRGB, their square, for noise that is
even in the stored levels. Their sizes are fitted to the squares of the difference, most of which
holds no change.

Pixels are then sorted into bins by their predicted variance. Where its terms do not hold, such as
on the sharpest edges or with heavy tails, the differences in the bin tell.
"""

from dataclasses import dataclass
from itertools import pairwise
from math import inf, pi, sqrt
from typing import Self

import cv2
import numpy as np
from scipy.optimize import nnls

from analysis.changes.matching._smoothed_warp import PixelPositions, away_from, sampled, smoothed
from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray
from simulation.compiled import compiled

_SIZE_ROUNDS = 6
_CLIP = 3.5
"""Standard deviations beyond which a pixel does not count; 0.05 % of normal ones."""

_MEDIAN_CHI2 = 0.4549
"""Median of chi-squared with one degree of freedom."""

_DETAIL_PX = 1.5
_BACKGROUND = 5.0
"""Percentile of the finest detail's power that is noise, which the constant has already."""

_LEAST_DN2 = 1e-12
_PERCENTILE_STEP = 4
"""Pixels from one to the next of those that percentiles are taken of."""

GRADIENT, LAPLACIAN = 2, 3
"""Places of these terms among the sizes."""

_STRUCTURES = 4
_UNLIKE_STEPS = 1.5
"""Variance of the coarse steps of a file over that of the fine ones, from which on it is a term."""

_DARKEST, _BRIGHTEST = 0.1, 99.9
"""Percentiles."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class VarianceTerms:
    """Images of the terms, shape ``(rows, cols)`` each.

    ``level``: from 0 at the darkest to 1 at the brightest. The first size is the variance at 0, the
    second that at 1. ``others``: squared gradient, squared Laplacian, the finest detail of target
    and source; then, of noise, the variance of the files' steps where these are not alike, and the
    squared slope of the target's tone curve, if it was given another one.
    """

    level: Float32Array
    others: tuple[Float32Array, ...]

    @classmethod
    def of(
        cls,
        seen: Float32Array,
        source: Float32Array,
        target: Float32Array,
        positions: PixelPositions,
        tone_slope: Float32Array | None = None,
        steps_dn2: Float32Array | None = None,
    ) -> Self:
        """Compute the terms.

        ``steps_dn2``: variance of the difference by the steps of the files, where it is known.
        ``tone_slope``: slope of the tone curve that was applied to the target, if one was: its
        noise is that many times as large.
        """
        source_detail = positions.seen(_finest_detail(source))
        source_detail[np.isnan(source_detail)] = 0
        others = [
            _gradient(seen),
            _laplacian(seen),
            _without_background(_finest_detail(target)),
            _without_background(source_detail),
        ]
        if steps_dn2 is not None:
            fine, coarse = np.percentile(steps_dn2[::_PERCENTILE_STEP, ::_PERCENTILE_STEP], [5, 95])
            if coarse > _UNLIKE_STEPS * fine:
                others.append(steps_dn2)
        if tone_slope is not None:
            others.append(smoothed(tone_slope * tone_slope, 1.0))
        return cls(level=_level(seen), others=tuple(others))

    def at(self, rows: IntArray, cols: IntArray) -> FloatArray:
        """Terms at pixels, shape ``(terms, pixels)``."""
        level = self.level[rows, cols].astype(np.float64)
        return np.stack([1 - level, level, *(image[rows, cols] for image in self.others)])

    def variance(self, sizes: FloatArray, floor_dn2: Float32Array | None = None) -> Float32Array:
        """Sum of the terms with their sizes, and no less than a floor."""
        dark, bright = sizes[:2].astype(np.float32)
        total = self.level * (bright - dark)
        total += dark + np.float32(_LEAST_DN2)
        for size, image in zip(sizes[2:].astype(np.float32), self.others, strict=True):
            if size > 0:
                total += size * image
        return np.asarray(total if floor_dn2 is None else np.maximum(total, floor_dn2))

    def noise_sizes(self, sizes: FloatArray) -> FloatArray:
        """Return the sizes with those of gradient, Laplacian and fine detail set to 0."""
        return np.asarray(sizes * is_noise(len(sizes)))

    def noise_dn2(self, sizes: FloatArray, valid: BoolArray) -> float:
        """Mean variance by noise."""
        level = float(self.level[valid].mean())
        further = zip(
            sizes[GRADIENT + _STRUCTURES :].tolist(), self.others[_STRUCTURES:], strict=True
        )
        by_others = sum(size * float(image[valid].mean()) for size, image in further)
        return float((1 - level) * sizes[0] + level * sizes[1] + by_others)


def is_noise(terms: int) -> BoolArray:
    """Which of so many terms are noise: all but gradient, Laplacian and fine detail."""
    found = np.ones(terms, dtype=np.bool_)
    found[GRADIENT : GRADIENT + _STRUCTURES] = False
    return found


def _level(image: Float32Array) -> Float32Array:
    """Level from 0 at the darkest to 1 at the brightest, clipped there."""
    low, high = np.nanpercentile(
        image[::_PERCENTILE_STEP, ::_PERCENTILE_STEP], [_DARKEST, _BRIGHTEST]
    )
    return np.asarray(np.clip((image - np.float32(low)) / np.float32(max(high - low, 1e-6)), 0, 1))


def _gradient(image: Float32Array) -> Float32Array:
    """Half the squared gradient."""
    slope = np.array([-0.5, 0.0, 0.5], dtype=np.float32)
    one = np.ones(1, dtype=np.float32)
    along_x, along_y = (
        cv2.sepFilter2D(image, -1, slope, one),
        cv2.sepFilter2D(image, -1, one, slope),
    )
    return np.asarray((along_x * along_x + along_y * along_y) / 2)


def _laplacian(image: Float32Array) -> Float32Array:
    """A quarter of the squared Laplacian."""
    curved = np.asarray(cv2.Laplacian(image, cv2.CV_32F, ksize=1))
    return np.asarray(curved * curved / 4)


def _finest_detail(image: Float32Array) -> Float32Array:
    """Power of what a Gaussian of 1 px takes from an image, gathered over 1.5 px."""
    detail = image - smoothed(image, 1.0)
    return smoothed(detail * detail, _DETAIL_PX)


def _without_background(power: Float32Array) -> Float32Array:
    """Subtract what the noise alone shows everywhere."""
    return np.asarray(
        np.maximum(
            power
            - np.float32(np.percentile(power[::_PERCENTILE_STEP, ::_PERCENTILE_STEP], _BACKGROUND)),
            0,
        )
    )


def fit_sizes(
    difference_dn: FloatArray, terms: FloatArray, floor_dn2: FloatArray | None
) -> FloatArray:
    """Sizes of the terms, none negative, shape ``(terms,)``.

    ``difference_dn``: at a sample of pixels, shape ``(n,)``. ``terms``: shape ``(terms, n)``.
    ``floor_dn2``: variance that a noise model gives the pixels, which the sum does not go below.
    """
    squares = difference_dn**2
    scale = np.maximum(np.mean(terms, axis=1), 1e-30)
    expected = np.full(len(squares), max(float(np.median(squares)) / _MEDIAN_CHI2, _LEAST_DN2))
    least = np.zeros(1) if floor_dn2 is None else floor_dn2
    sizes = np.zeros(len(terms))
    for _ in range(_SIZE_ROUNDS):
        counts = squares < _CLIP**2 * expected
        # A square has the variance 2 expected^2.
        weight = 1.0 / expected[counts]
        design = (terms[:, counts] / scale[:, None] * weight).T
        sizes = nnls(design, squares[counts] * weight)[0] / scale
        expected = np.maximum(np.maximum(sizes @ terms, least), _LEAST_DN2)
    return sizes


_EDGES = np.concatenate([np.linspace(0, 0.9, 13), [0.95, 0.98, 0.99, 1.0]])
"""Quantiles of the predicted variance between which the bins lie."""

_TAIL, _TAIL_SD = 0.99, 2.5758293035489004
"""Share of normal values within so many standard deviations."""

_TAIL_SCATTER = 1.33
"""Standard deviation of the tail's quantile over the spread, over the root of 1 / n; a tail must
exceed it to count."""

_LEAST_STEP = 0.1
"""Pixels whose predicted variances agree to 10 % are of one kind; a bin of them alone could be
filled by one change."""

_LEAST_PX = 30
_STRUCTURE = 0.2
"""Share of the predicted variance beside noise from which on a tail counts in full: noise has none,
and faint changes, which lie anywhere, would pass for one."""

_SAMPLE_PX = 500_000
_CHANGE_SD, _CHANGE_REACH_PX = 4.5, 5.0
"""Pixels that are taken as changed, and how far around them."""

_STEP, _LARGE_PX = 2, 1_000_000
_ROUNDS = 4
"""A change that is found is left out, with what is around it; what is none comes back."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _VarianceCalibration:
    """Factors of the standard deviation by the logarithm of the predicted variance.

    ``log_variance, log_factor``: shape ``(bins,)``, the first rising.
    """

    log_variance: FloatArray
    log_factor: FloatArray

    def factor(self, variance_dn2: Float32Array) -> Float32Array:
        """Factor of the standard deviation at each pixel."""
        return _interpolated(variance_dn2, self.log_variance, self.log_factor)


@compiled(nogil=True)
def _interpolated(
    variance_dn2: Float32Array, log_variance: FloatArray, log_factor: FloatArray
) -> Float32Array:
    factor = np.empty(variance_dn2.shape, dtype=np.float32)
    last = len(log_variance) - 1
    place = 0
    for row in range(variance_dn2.shape[0]):
        for col in range(variance_dn2.shape[1]):
            at = np.log(variance_dn2[row, col])
            # Neighbours have like variances: the search begins where the last one ended.
            while place < last - 1 and at > log_variance[place + 1]:
                place += 1
            while place > 0 and at < log_variance[place]:
                place -= 1
            value = log_factor[place]
            if last > 0:
                low, high = log_variance[place], log_variance[place + 1]
                share = min(max((at - low) / (high - low), 0.0), 1.0)
                value += share * (log_factor[place + 1] - value)
            factor[row, col] = np.exp(value)
    return factor


def _calibrate_variance(
    difference_dn: FloatArray, variance_dn2: FloatArray, noise_dn2: FloatArray, alike: float | None
) -> _VarianceCalibration:
    """Compare differences with their predicted variance.

    ``difference_dn, variance_dn2``: of a sample of pixels without a change, shape ``(n,)``.
    ``alike``: pixels of the sample to one that is independent of the others; None leaves the tails
    out.
    """
    ratio = np.abs(difference_dn) / np.sqrt(variance_dn2)
    log_variance = np.log(variance_dn2)
    edges = _apart(np.quantile(log_variance, _EDGES).tolist())
    middles, spreads, tails = [], [], []
    for low, high in pairwise(edges):
        inside = (log_variance >= low) & (log_variance < high)
        count = int(inside.sum())
        if count < _LEAST_PX:
            continue
        spread = robust_sigma(ratio[inside]) + 1e-6
        tail = 1.0
        if alike is not None:
            tail = float(np.quantile(ratio[inside], _TAIL)) / _TAIL_SD / spread
            tail = max(0.0, tail - _TAIL_SCATTER * sqrt(alike / count) - 1)
            share = 1 - float(np.mean(noise_dn2[inside] / variance_dn2[inside]))
            tail = 1 + tail * min(max(share, 0.0) / _STRUCTURE, 1.0)
        middles.append(float(np.median(log_variance[inside])))
        spreads.append(spread)
        tails.append(tail)
    if not middles:
        return _VarianceCalibration(log_variance=np.zeros(1), log_factor=np.zeros(1))
    factors = np.array(spreads) * np.array(tails)
    return _VarianceCalibration(log_variance=np.array(middles), log_factor=np.log(factors))


def _apart(edges: list[float]) -> list[float]:
    """Leave out edges that hardly differ from the one before; the last bin is open."""
    kept = edges[:1]
    for edge in edges[1:-1]:
        if edge - kept[-1] > _LEAST_STEP:
            kept.append(edge)
    return [*kept, inf]


def calibrated_factor(
    difference_dn: Float32Array,
    variance_dn2: Float32Array,
    noise_dn2: Float32Array,
    valid: BoolArray,
    smoothing_px: float,
    sample_px: int = _SAMPLE_PX,
) -> Float32Array:
    """Factor of the predicted standard deviation at every pixel, changes left out.

    ``difference_dn, variance_dn2, noise_dn2``: difference, its predicted variance and the part of
    it that is noise, shape ``(rows, cols)``. ``smoothing_px``: width of the Gaussian that makes
    neighbours alike.
    """
    # Smoothed images are known from every other pixel.
    seen = np.s_[::_STEP, ::_STEP] if valid.size > _LARGE_PX else np.s_[:, :]
    step = _STEP if valid.size > _LARGE_PX else 1
    difference, variance, part = difference_dn[seen], variance_dn2[seen], valid[seen]
    noise = noise_dn2[seen]
    independent = np.count_nonzero(valid) / (4 * pi * smoothing_px**2)
    kept = part
    for number in range(_ROUNDS):
        rows, cols = sampled(kept, sample_px)
        # A change in the tail would hide itself: the spread alone finds it first.
        alike = None if number == 0 else len(rows) / independent + 1
        calibration = _calibrate_variance(
            difference[rows, cols].astype(np.float64),
            variance[rows, cols].astype(np.float64),
            noise[rows, cols].astype(np.float64),
            alike,
        )
        if number == _ROUNDS - 1:
            break
        reach = np.square(_CHANGE_SD * calibration.factor(variance)) * variance
        found = part & (np.square(difference) > reach)
        remaining = part & away_from(found, _CHANGE_REACH_PX / step)
        # Of next to nothing, as in a drawing, the pixels that differ may reach all others.
        if not remaining.any() or (number > 0 and np.array_equal(remaining, kept)):
            break
        kept = remaining
    return calibration.factor(variance_dn2)
