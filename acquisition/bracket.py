"""Merge the exposures of a bracket to linear light, with the variance of each pixel.

The noise of a camera's frames by their light comes from the frames themselves.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict

from acquisition.averaging import AveragedFrames

QUANTISATION_DN2 = 1.0 / 12.0
"""Variance of rounding to whole DN (EMVA 1288 release 4.0, section 2.4)."""

_USED_RANGE = 0.9
"""Fraction of the range up to which pixels are used: the variance of those that clip collapses."""

_BINS = 128
_LINE_ROUNDS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class _NoiseLine:
    """Variance of one frame: dark noise and rounding, and shot noise that grows with the light.

    ``offset_dn2 + slope_dn * light``, with the light in DN above black.

    References
    ----------
    EMVA Standard 1288, release 4.0 linear, 2021, section 2.4.
    """

    offset_dn2: float
    slope_dn: float

    def variance_dn2(self, light_dn: NDArray[np.float64]) -> NDArray[np.float64]:
        """Variance at each light; light below black has that of black."""
        return self.offset_dn2 + self.slope_dn * np.maximum(light_dn, 0.0)


Sample = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Mean level and unbiased temporal variance of one frame, by pixel."""


def _fit_noise_line(
    samples: Iterable[Sample], *, black_level_dn: float, saturation_dn: float
) -> _NoiseLine:
    """Fit the line to all pixels of several exposures together.

    Means and variances are averaged over pixels of like level first. The line never falls, and is
    at black at least the variance of rounding.
    """
    top_dn = black_level_dn + _USED_RANGE * (saturation_dn - black_level_dn)
    count, light, variance = np.zeros(_BINS), np.zeros(_BINS), np.zeros(_BINS)
    for mean_dn, variance_dn2 in samples:
        is_used = mean_dn < top_dn
        level = mean_dn[is_used].astype(np.float64)
        # Square-root bins: shot noise is then as fine in each.
        share = np.sqrt(np.maximum(level - black_level_dn, 0.0) / (top_dn - black_level_dn))
        index = np.minimum((_BINS * share).astype(np.intp), _BINS - 1)
        count += np.bincount(index, minlength=_BINS)
        light += np.bincount(index, level - black_level_dn, minlength=_BINS)
        variance += np.bincount(index, variance_dn2[is_used].astype(np.float64), minlength=_BINS)
    is_seen = count > 0
    if not is_seen.any():
        return _NoiseLine(offset_dn2=QUANTISATION_DN2, slope_dn=0.0)
    count = count[is_seen]
    return _weighted_line(count, light[is_seen] / count, variance[is_seen] / count)


def _weighted_line(
    count: NDArray[np.float64], light: NDArray[np.float64], variance: NDArray[np.float64]
) -> _NoiseLine:
    """Least squares, weighted by the scatter of a mean variance: in proportion to it."""
    overall = max(float(np.average(variance, weights=count)), QUANTISATION_DN2)
    line = _NoiseLine(offset_dn2=overall, slope_dn=0.0)
    for _ in range(_LINE_ROUNDS):
        weight = count / line.variance_dn2(light) ** 2
        centre = float(np.average(light, weights=weight))
        middle = float(np.average(variance, weights=weight))
        moment = float(np.sum(weight * (light - centre) ** 2))
        slope = float(np.sum(weight * (light - centre) * variance)) / moment if moment > 0 else 0.0
        slope = max(slope, 0.0)
        offset = middle - slope * centre
        if offset < QUANTISATION_DN2:
            # Without dark noise the line goes through what rounding leaves.
            offset = QUANTISATION_DN2
            power = float(np.sum(weight * light**2))
            slope = max(float(np.sum(weight * light * (variance - offset))) / power, 0.0)
        line = _NoiseLine(offset_dn2=offset, slope_dn=slope)
    return line


_CLEAR_OF_CLIPPING = 4.0
"""Standard deviations of a frame between a level and the ends of the range: of the frames nearer
than that some are cut off, and their mean is biased. Beyond it the bias is 1e-5 of a deviation."""

_SURELY_SATURATED = 1.5
"""Of the range: pixels to which a shorter exposure gives so much light show where it ends."""

_BRIGHT = 0.25
"""Of the range: pixels as bright as this compare the light of two exposures."""

_FEWEST_PIXELS = 100
_ROUNDS = 3
_BLOCK_PIXELS = 2**18
"""Pixels that are merged at once, so that large sensors need little memory."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BracketExposure:
    """One exposure of a bracket, for the record of its capture.

    ``mean_dn`` and ``variance_dn2`` are over all its pixels; in ``used_pixels`` it counts.
    ``light_ratio`` is the light that it shows over that of the next shorter exposure, None where
    too few pixels are well exposed in both.
    """

    exposure_us: float
    frames_used: int
    incomplete_frames: int
    stale_frames: int
    mean_dn: float
    variance_dn2: float
    min_dn: float
    max_dn: float
    saturated_pixels: int
    used_pixels: int
    light_ratio: float | None

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid", strict=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class MergedBracket:
    """A bracket as one capture, in DN of its shortest exposure.

    Pixels that are saturated in every exposure have the largest level. ``exposures_used`` counts by
    pixel the exposures on which its level rests, float32 of shape ``(rows, cols)``: 0 where it is
    not valid.
    """

    averaged: AveragedFrames
    exposures_used: NDArray[np.float32]
    exposures: tuple[BracketExposure, ...]


def merge_bracket(
    exposures_us: Sequence[float],
    averages: Sequence[AveragedFrames],
    *,
    black_level_dn: float,
    max_level_dn: float,
) -> MergedBracket:
    """Merge the averages of several exposures to light, by the noise model of the camera.

    The light of a pixel is the mean over its exposures, each weighted by ``N t^2 / v(x t)``: the
    reciprocal variance that the line of photon transfer, fitted to all pixels, gives to the
    *pooled* estimate x. Weights from an exposure's own noisy level would favour what happened to be
    dark. The pooled estimate covaries with every exposure alike, by its own variance; so, as the
    weights sum to one, their dependence on it cancels to first order and no bias is left. For the
    same reason it is the pooled estimate that decides whether an exposure clips.

    An exposure counts in a pixel that is 4 standard deviations of a frame clear of both ends of the
    range, and that no frame saw saturated. Where the camera saturates below the largest level (a
    full well), the pixels that the next shorter exposure knows to be brighter show it.

    The exposures ascend, as read back from the camera; the averages are all of one shape.

    References
    ----------
    Debevec and Malik, "Recovering high dynamic range radiance maps from photographs", SIGGRAPH
    1997. Granados et al., "Optimal HDR reconstruction with linear digital cameras", CVPR 2010:
    weights by the reciprocal variance, iterated. Hasinoff, Durand and Freeman, "Noise-optimal
    capture for high dynamic range photography", CVPR 2010. EMVA Standard 1288, release 4.0.
    """
    _require_ascending(exposures_us, averages)
    reference_us = exposures_us[0]
    top_dn = _saturation_dn(exposures_us, averages, black_level_dn, max_level_dn)
    line = _fit_noise_line(
        [(one.mean_dn, one.variance_dn2) for one in averages],
        black_level_dn=black_level_dn,
        saturation_dn=top_dn,
    )
    merging = _Merging(
        ratios=tuple(exposure_us / reference_us for exposure_us in exposures_us),
        frames=tuple(one.frames_used for one in averages),
        line=line,
        lowest_dn=-black_level_dn,
        top_dn=top_dn - black_level_dn,
    )
    shape = averages[0].mean_dn.shape
    light, variance = np.empty(shape), np.empty(shape)
    is_used = np.empty((len(averages), *shape), np.bool_)
    for rows in _row_blocks(shape):
        lights = [one.mean_dn[rows].astype(np.float64) - black_level_dn for one in averages]
        seen = [None if s is None else s[rows] for s in (one.is_saturated for one in averages)]
        light[rows], variance[rows], is_used[:, rows] = merging.merged(lights, seen)
    used = is_used.sum(axis=0)
    # Dark in every exposure, below the lowest level: what the longest one says, not valid.
    dark_dn = (averages[-1].mean_dn - black_level_dn) * (reference_us / exposures_us[-1])
    is_bright = (used == 0) & ~(averages[0].mean_dn < (black_level_dn + top_dn) / 2)
    light = np.where(used > 0, light, np.where(is_bright, max_level_dn - black_level_dn, dark_dn))
    frames = sum(one.frames_used for one in averages)
    last_dn2 = averages[-1].variance_dn2 * (reference_us / exposures_us[-1]) ** 2
    mean_variance = np.where(used > 0, variance, last_dn2 / averages[-1].frames_used)
    first = averages[0]
    return MergedBracket(
        averaged=replace(
            first,
            mean_dn=(light + black_level_dn).astype(np.float32),
            variance_dn2=(mean_variance * frames).astype(np.float32),
            frames_used=frames,
            incomplete_frames=sum(one.incomplete_frames for one in averages),
            stale_frames=sum(one.stale_frames for one in averages),
            resent_packets=sum(one.resent_packets for one in averages),
            saturated_pixels=int(np.count_nonzero(is_bright)),
            is_saturated=is_bright,
            min_dn=min(one.min_dn for one in averages),
            max_dn=max(one.max_dn for one in averages),
            last_timestamp_ns=averages[-1].last_timestamp_ns,
        ),
        exposures_used=used.astype(np.float32),
        exposures=tuple(
            _summary(number, exposures_us, averages, is_used, black_level_dn, max_level_dn)
            for number in range(len(averages))
        ),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Merging:
    """Exposures as multiples of the reference, and the range, in DN above black."""

    ratios: tuple[float, ...]
    frames: tuple[int, ...]
    line: _NoiseLine
    lowest_dn: float
    top_dn: float

    def merged(
        self,
        lights: Sequence[NDArray[np.float64]],
        saturated: Sequence[NDArray[np.bool_] | None],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """Light at the reference exposure, its variance, and which exposures count."""
        shape = lights[0].shape
        is_used = np.zeros((len(lights), *shape), np.bool_)
        is_open = np.ones(shape, np.bool_)
        for number, ratio in enumerate(self.ratios):
            if (seen := saturated[number]) is not None:
                is_open &= ~seen
            is_used[number] = is_open
            pooled, _ = self._estimate(lights, is_used)
            level = pooled * ratio
            reach = _CLEAR_OF_CLIPPING * np.sqrt(self.line.variance_dn2(level))
            # Longer exposures of a pixel that saturates in this one saturate as well.
            is_open &= level + reach < self.top_dn
            is_used[number] &= is_open & (level - reach > self.lowest_dn)
        light, variance = self._estimate(lights, is_used)
        return light, variance, is_used

    def _estimate(
        self, lights: Sequence[NDArray[np.float64]], is_used: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Weighted mean over the exposures used, and its variance; 0 and infinity for none."""
        each = zip(self.frames, self.ratios, is_used, strict=True)
        fixed = [used.astype(np.float64) * (count * ratio**2) for count, ratio, used in each]
        light, weights = _mean(lights, fixed, self.ratios), fixed
        for _ in range(_ROUNDS):
            weights = [
                weight / self.line.variance_dn2(ratio * light)
                for weight, ratio in zip(fixed, self.ratios, strict=True)
            ]
            light = _mean(lights, weights, self.ratios)
        with np.errstate(divide="ignore"):
            return light, np.asarray(1.0 / np.sum(weights, axis=0))


def _mean(
    lights: Sequence[NDArray[np.float64]],
    weights: Sequence[NDArray[np.float64]],
    ratios: Sequence[float],
) -> NDArray[np.float64]:
    total = np.sum(weights, axis=0)
    each = zip(weights, lights, ratios, strict=True)
    summed = np.sum([weight * (light / ratio) for weight, light, ratio in each], axis=0)
    return np.asarray(np.divide(summed, total, out=np.zeros_like(summed), where=total > 0))


def _require_ascending(exposures_us: Sequence[float], averages: Sequence[AveragedFrames]) -> None:
    if len(exposures_us) < 2 or len(exposures_us) != len(averages):
        raise ValueError(f"a bracket needs two exposures or more, got {len(exposures_us)}")
    if not exposures_us[0] > 0 or not all(one < other for one, other in pairwise(exposures_us)):
        raise ValueError(f"the exposures of a bracket must ascend, got {list(exposures_us)} us")


def _row_blocks(shape: tuple[int, ...]) -> Iterator[slice]:
    rows = max(1, _BLOCK_PIXELS // shape[1])
    return (slice(first, first + rows) for first in range(0, shape[0], rows))


def _saturation_dn(
    exposures_us: Sequence[float],
    averages: Sequence[AveragedFrames],
    black_level_dn: float,
    max_level_dn: float,
) -> float:
    """The level at which the camera saturates, where a shorter exposure proves that it does."""
    range_dn = max_level_dn - black_level_dn
    found = [max_level_dn]
    for number in range(1, len(averages)):
        shorter, longer = averages[number - 1], averages[number]
        ratio = exposures_us[number] / exposures_us[number - 1]
        expected = (shorter.mean_dn - black_level_dn) * ratio
        level = longer.mean_dn[expected > _SURELY_SATURATED * range_dn]
        if level.size >= _FEWEST_PIXELS:
            # Full wells differ by pixel: the first of a hundred to fill counts for all.
            found.append(float(np.percentile(level, 1)))
    return min(found)


def _summary(
    number: int,
    exposures_us: Sequence[float],
    averages: Sequence[AveragedFrames],
    is_used: NDArray[np.bool_],
    black_level_dn: float,
    max_level_dn: float,
) -> BracketExposure:
    averaged = averages[number]
    light_ratio = None
    if number > 0:
        shorter = averages[number - 1]
        light = averaged.mean_dn.astype(np.float64) - black_level_dn
        is_bright = is_used[number] & is_used[number - 1]
        is_bright &= light > _BRIGHT * (max_level_dn - black_level_dn)
        if np.count_nonzero(is_bright) >= _FEWEST_PIXELS:
            less = float(shorter.mean_dn[is_bright].astype(np.float64).mean()) - black_level_dn
            scale = exposures_us[number - 1] / exposures_us[number]
            light_ratio = float(light[is_bright].mean()) * scale / less if less > 0 else None
    return BracketExposure(
        exposure_us=exposures_us[number],
        frames_used=averaged.frames_used,
        incomplete_frames=averaged.incomplete_frames,
        stale_frames=averaged.stale_frames,
        mean_dn=float(averaged.mean_dn.mean(dtype=np.float64)),
        variance_dn2=float(averaged.variance_dn2.mean(dtype=np.float64)),
        min_dn=float(averaged.min_dn),
        max_dn=float(averaged.max_dn),
        saturated_pixels=averaged.saturated_pixels,
        used_pixels=int(np.count_nonzero(is_used[number])),
        light_ratio=light_ratio,
    )
