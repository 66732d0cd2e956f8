"""The difference of two photographs seen through Gaussians of several widths.

A change is found best by a filter of its own width; each level is twice as wide as the one before.
The noise of a level follows from that of the comparison, whose smoothing it was white behind: what
else scatters there is measured. So is the amplitude that a spot needs at every place to be found.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import ceil, exp, hypot, log, pi, sqrt
from typing import Self

import cv2
import numpy as np

from acquisition.photographs import CodedSteps
from analysis.changes._colour import Bounds, ColourPlanes, to_channels, to_luma_red_blue, to_rgb
from analysis.changes._comparison import Comparison
from analysis.changes._significance import (
    PLANES,
    POWER,
    SPREAD_ERR,
    FilterWidth,
    as_significance,
    equally_strict,
    height_for,
    response,
)
from analysis.changes.matching import away_from, sampled
from analysis.detection_limits import DetectionLimit, SpotLimit
from simulation.arrays import BoolArray, Float32Array, FloatArray, FloatImage

_CORRELATION_SAMPLE_PX = 50_000
_CORRELATION_CLIP_SD = 3.0
_CORRELATION_ROUNDS = 2
_PRIOR_VALUES = 100.0
"""Independent values that a correlation of none is worth: the planes were made so at first, and a
frame has few of a wide filter."""

Place = tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LevelColours:
    """Luma and the two planes of chroma at the places of a level, shape ``(3, rows, cols)`` each.

    ``difference_dn, sd_dn``: of the planes, each with its own scatter and with the width's
    allowance. ``whitening``: takes the planes in standard deviations to independent ones, shape (3,
    3). ``by_others``: levels of red by one of the luma's, of blue by one of it, and of blue by one
    of the first plane's. ``bounds``: of each plane, where something is hidden.
    """

    difference_dn: Float32Array
    sd_dn: Float32Array
    whitening: FloatArray
    by_others: Float32Array
    bounds: tuple[Bounds, ...] | None = None

    @classmethod
    def of(
        cls,
        planes: "Sequence[DetectionLevel]",
        width: float,
        by_others: Float32Array,
    ) -> Self:
        """Measure what correlation is left; ``width`` is that of the filter, in places."""
        difference, sd = (
            np.stack([np.asarray(image, dtype=np.float32) for image in images])
            for images in (
                [plane.difference_dn for plane in planes],
                [plane.sd_dn for plane in planes],
            )
        )
        told = np.logical_and.reduce([plane.is_told for plane in planes])
        rows, cols = sampled(told, _CORRELATION_SAMPLE_PX)
        scaled = (difference[:, rows, cols] / sd[:, rows, cols]).astype(np.float64)
        whitening = np.eye(PLANES)
        independent = max(np.count_nonzero(told) / (4 * pi * width**2), 1.0)
        for _ in range(_CORRELATION_ROUNDS):
            inside = np.linalg.norm(whitening @ scaled, axis=0) < _CORRELATION_CLIP_SD * 1.3
            if np.count_nonzero(inside) <= PLANES:
                break
            moments = scaled[:, inside] @ scaled[:, inside].T / np.count_nonzero(inside)
            # Where the steps of the files are more than the scatter, nothing is to be made of that.
            spread = np.sqrt(np.maximum(np.diag(moments), 1.0))
            correlation = moments / spread / spread[:, None]
            correlation *= independent / (independent + _PRIOR_VALUES)
            np.fill_diagonal(correlation, 1.0)
            whitening = np.linalg.inv(np.linalg.cholesky(correlation))
        bounds = tuple(plane.bounds for plane in planes if plane.bounds is not None)
        return cls(
            difference_dn=difference,
            sd_dn=sd,
            whitening=whitening,
            by_others=by_others,
            bounds=bounds or None,
        )

    def strict_as(self, factor: float) -> Self:
        """The planes with another allowance."""
        return replace(self, sd_dn=self.sd_dn * np.float32(factor))

    def whitened(self, difference_dn: Float32Array) -> Float32Array:
        """Planes of a difference in independent standard deviations."""
        scaled = difference_dn / self.sd_dn
        return np.tensordot(self.whitening.astype(np.float32), scaled, axes=1)

    @property
    def vectors(self) -> Float32Array:
        """The level's own difference, likewise."""
        return self.whitened(self.difference_dn)

    def vectors_without(self, light_dn: Float32Array) -> Float32Array:
        """The same, less the light of changes in the planes."""
        if self.bounds is None:
            return self.vectors - self.whitened(light_dn)
        left = [one.surely(light) for one, light in zip(self.bounds, light_dn, strict=True)]
        return self.whitened(np.stack(left))

    def change_dn(self, direction: FloatArray, at: Place) -> FloatArray:
        """Red, green and blue of a change in a whitened direction, at a place."""
        scaled = np.linalg.solve(self.whitening, direction) * self.sd_dn[:, *at]
        by_others = self.by_others[:, *at].astype(np.float64)
        return to_rgb(to_channels(np.asarray(scaled, dtype=np.float64), by_others))

    def along(self, rgb: FloatArray) -> tuple[Float32Array, Float32Array]:
        """Matched amplitude of a change in this direction at every place, and its standard error.

        ``rgb``: red, green and blue of a change of amplitude 1.
        """
        weights = self.whitened(self._planes_of(rgb))
        power = np.einsum("kij,kij->ij", weights, weights)
        amplitude = np.einsum("kij,kij->ij", weights, self.vectors) / power
        return amplitude, 1 / np.sqrt(power)

    def error_along(self, rgb: FloatArray) -> Float32Array:
        """The standard error alone."""
        weights = self.whitened(self._planes_of(rgb))
        return np.asarray(1 / np.sqrt(np.einsum("kij,kij->ij", weights, weights)))

    def _planes_of(self, rgb: FloatArray) -> Float32Array:
        """A change of the channels in the planes, shape ``(3, rows, cols)``."""
        luma, red, blue = to_luma_red_blue(np.asarray(rgb, dtype=np.float64)).tolist()
        red_by_luma, blue_by_luma, blue_by_red = self.by_others
        first = np.float32(red) - red_by_luma * np.float32(luma)
        second = np.float32(blue) - blue_by_luma * np.float32(luma) - blue_by_red * first
        whole = np.broadcast_to(np.float32(luma), self.difference_dn.shape[1:])
        return np.stack([whole, *(np.broadcast_to(one, whole.shape) for one in (first, second))])

    def part(self, part: tuple[slice, slice]) -> Self:
        """Some places of it."""
        return replace(
            self,
            difference_dn=self.difference_dn[:, *part],
            sd_dn=self.sd_dn[:, *part],
            by_others=self.by_others[:, *part],
            bounds=self.bounds and tuple(one.through(lambda of: of[part]) for one in self.bounds),
        )


def signed_significance(vectors: Float32Array, valid: BoolArray) -> Float32Array:
    """Significance of whitened vectors with the sign of the luma; 0 where it does not count."""
    norm = np.sqrt(np.einsum("kij,kij->ij", vectors, vectors))
    return np.where(valid, np.copysign(as_significance(norm), vectors[0]), np.float32(0))


_NARROWEST = sqrt(2.0)
"""Width of the narrowest level over the comparison's smoothing. A camera shows nothing narrower
than that smoothing, to which a filter of the same width would be matched: it finds 6 % fainter ones
of those, and has twice as many places at which chance, or what compression leaves, stands out."""

_STEPS = (1, 1, 2, 4)
"""Distances of the places, a quarter to half of a level's width; each is twice as wide as the one
before: 1.4 to 11 px, where the comparison's smoothing is 1 px."""

_LEAST_INDEPENDENT = 30.0
"""Independent places of a level, below which its scatter is not known."""

_PRIOR_ERR = 0.1
"""Relative difference, between a level and the next narrower one, of what scatters beside white
noise: 0.07 to 0.2 in photographs that differ in focus, tone curve or compression."""

_MOST_LESS = 0.5
"""By the logarithm: a frame without noise says nothing of it."""

_CLIP_SD, _CLIPPED_RMS = 3.0, 0.98658
"""Values beyond which a place does not count, and the root mean square of normal ones within."""

_CHANGE_SD, _SKIRT = 4.0, 2.0
"""Places taken for changed, and how many widths of the filter around them are left out."""

_SAMPLE = 500_000
_NEVER_DN = 1e30
_NEVER = 1e-6
"""Share of the independent places of a level of which none is told."""

_HIDDEN = 0.05
"""Share of a filter over pixels of which a part is hidden, up to which a place is told."""

_OF_CHROMA = 2.0
"""Variance of red by its chroma over that by luma, where both are as large: the square of 1.4."""

_LEAST_OF_STEPS = 0.25
"""Share of the variance by steps: wide filters that were far surer than narrow ones would take what
is side by side for one change."""

_ROUNDS = 4
_LEAST_WEIGHT = 0.5
_TAILS = 4.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DetectionLevel:
    """The difference behind one width; a place counts where ``valid``.

    ``filter_width``: its width and the distance of its places, in pixels of the comparison's grid;
    the first place is the first pixel. ``difference_dn, sd_dn``: shape ``(rows, cols)`` of places.
    The standard deviation holds the width's allowance, so that one threshold of significance is
    right for all levels. ``weight``: share of the filter that lies on pixels that count.
    ``colours``: of photographs in colour the luma and what red and blue say beside it; difference
    and standard deviation are the luma's. ``bounds``: see `Comparison`.
    """

    filter_width: FilterWidth
    difference_dn: FloatImage
    sd_dn: FloatImage
    valid: BoolArray
    weight: Float32Array
    colours: LevelColours | None = None
    bounds: Bounds | None = None

    @property
    def is_told(self) -> BoolArray:
        """Places whose difference no end of the scale hides."""
        return self.valid if self.bounds is None else self.valid & (self.bounds.hidden < _HIDDEN)

    @property
    def width_px(self) -> float:
        """Width of the whole smoothing."""
        return self.filter_width.width_px

    @property
    def step_px(self) -> int:
        """Pixels of the grid from one place to the next."""
        return self.filter_width.step_px

    @property
    def significance(self) -> FloatImage:
        """Difference over its standard deviation; 0 where it does not count.

        Of colours that of all planes together, with the sign of the luma.
        """
        if self.colours is not None:
            return signed_significance(self.colours.vectors, self.valid)
        none = np.zeros_like(self.difference_dn)
        return np.divide(self.difference_dn, self.sd_dn, out=none, where=self.valid)

    def strict_as(self, width: FilterWidth) -> "DetectionLevel":
        """The level with the allowance of ``width``."""
        sd_dn = self.sd_dn
        colours = self.colours
        if width.allowance != self.filter_width.allowance:
            factor = width.allowance / self.filter_width.allowance
            sd_dn = sd_dn * np.float32(factor)
            colours = None if colours is None else colours.strict_as(factor)
        return replace(self, filter_width=width, sd_dn=sd_dn, colours=colours)

    def significance_without(self, light_dn: Float32Array) -> FloatImage:
        """Significance less the light of changes, of photographs in grey."""
        if self.bounds is None:
            own = light_dn / self.sd_dn
            return np.asarray(self.significance - np.where(self.valid, own, np.float32(0)))
        left = self.bounds.surely(light_dn)
        return np.where(self.valid, left / self.sd_dn, np.float32(0))

    def smoothed_from(self, difference_dn: FloatImage, width_px: float) -> Float32Array:
        """Smooth a difference as this level is; it is behind ``width_px`` on the grid's pixels."""
        more = sqrt(self.width_px**2 - width_px**2)
        every = np.s_[:: self.step_px, :: self.step_px]
        smooth = _blurred(np.asarray(difference_dn, dtype=np.float32), more)[every]
        return np.where(self.valid, smooth / self.weight, np.float32(0))

    def error_along(self, rgb: tuple[float, float, float]) -> Float32Array:
        """Standard error of a change's amplitude; of colours, of one in this direction."""
        if self.colours is None:
            return np.asarray(self.sd_dn, dtype=np.float32)
        return self.colours.error_along(np.array(rgb))

    def sd_on_grid(self, sd_dn: FloatImage, shape: tuple[int, ...], every: int) -> Float32Array:
        """Bring a standard deviation there, beyond all measure where it does not count."""
        apart = max(every // self.step_px, 1) if every % self.step_px == 0 else 1
        part = np.s_[::apart, ::apart]
        valid, every = self.valid[part], max(every // apart, 1)
        known = self.on_grid(np.where(valid, sd_dn[part], np.float32(0)), shape, every)
        if valid.all():
            return known
        # Apart from each other, as float32 holds no sum of both.
        share = self.on_grid(valid.astype(np.float32), shape, every)
        return np.asarray(known + (1 - share) * np.float32(_NEVER_DN))

    def on_grid(self, image: FloatImage, shape: tuple[int, ...], every: int = 1) -> Float32Array:
        """Bring an image of the level to every so many pixels of the comparison's grid."""
        if every == self.step_px:
            return np.asarray(image, dtype=np.float32)
        shrink = np.array([[every / self.step_px, 0, 0], [0, every / self.step_px, 0]])
        return np.asarray(
            cv2.warpAffine(
                np.asarray(image, dtype=np.float32),
                shrink,
                (shape[1], shape[0]),
                flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                borderMode=cv2.BORDER_REPLICATE,
            )
        )


def usual_widths(smoothing_px: float, compared_px: int) -> tuple[FilterWidth, ...]:
    """Return the widths of the levels that a frame is expected to have, without allowances."""
    widths: list[FilterWidth] = []
    err = 0.0
    for number, step_px in enumerate(_STEPS):
        width_px = smoothing_px * _NARROWEST * 2**number
        measured_err = sqrt(0.5 * 4 * pi * width_px**2 / compared_px)
        prior_err = hypot(err, _PRIOR_ERR)
        err = prior_err * measured_err / hypot(prior_err, measured_err)
        spread_err = hypot(SPREAD_ERR, err)
        widths.append(FilterWidth(width_px=width_px, step_px=step_px, spread_err=spread_err))
    return tuple(widths)


def detection_levels(compared: Comparison, false_share: float) -> tuple[DetectionLevel, ...]:
    """Smooth a difference further, the narrowest level first.

    ``compared``: the difference behind the narrowest smoothing. ``false_share``: share of the
    pixels that chance may flag at any of the levels.
    """
    planes = compared.colours
    levels = list(_smoothed_further(compared) if planes is None else _of_colours(compared, planes))
    widths = equally_strict([level.filter_width for level in levels], false_share)
    return tuple(level.strict_as(width) for level, width in zip(levels, widths, strict=True))


def _of_colours(compared: Comparison, planes: ColourPlanes) -> Iterator[DetectionLevel]:
    """Levels of the luma with those of the two planes beside it, each by its own scatter."""
    every = [
        _smoothed_further(
            replace(
                compared,
                difference_dn=planes.difference_dn[plane],
                sd_dn=planes.sd_dn[plane],
                bounds=None if planes.bounds is None else planes.bounds[plane],
                steps_dn2=planes.steps_dn2[plane],
            ),
            is_chroma=plane > 0,
        )
        for plane in range(PLANES)
    ]
    for level, *beside in zip(*every, strict=True):
        places = np.s_[:: level.step_px, :: level.step_px]
        colours = LevelColours.of(
            (level, *beside), level.width_px / level.step_px, planes.by_others[:, *places]
        )
        width = replace(level.filter_width, planes=PLANES)
        yield replace(level, filter_width=width, colours=colours)


def _smoothed_further(compared: Comparison, *, is_chroma: bool = False) -> Iterator[DetectionLevel]:
    """The levels, as far as the frame has independent places of them.

    ``is_chroma``: of a plane of which the coefficients of chroma make most of what steps do.
    """
    compared_px, own = int(np.count_nonzero(compared.valid)), compared.smoothing_px
    sums = _Sums.of(compared)
    log_factor, err = 0.0, 0.0
    for number, step in enumerate(_STEPS):
        width = own * _NARROWEST * 2**number
        independent = max(compared_px / (4 * pi * width**2), 1.0)
        if number and independent < _LEAST_INDEPENDENT:
            return
        sums = sums.wider(width, step)
        # Of the narrowest, all that was compared; of the others, what has enough around it.
        counts = compared.valid[::step, ::step]
        if number:
            counts = counts & (sums.weight > _LEAST_WEIGHT)
        level = sums.level(own, counts)
        # Most probable, given how alike levels are and what this one measures.
        told = level.is_told
        measured = log(_spread(level.difference_dn, level.sd_dn, told, width / step))
        measured = max(measured, log_factor - _MOST_LESS)
        if level.bounds is not None:
            of = max(int(np.count_nonzero(level.valid)), 1)
            independent *= max(int(np.count_nonzero(told)) / of, _NEVER)
        measured_err = sqrt(0.5 / independent)
        prior = err**2 + _PRIOR_ERR**2
        log_factor += (measured - log_factor) * prior / (prior + measured_err**2)
        err = sqrt(prior * measured_err**2 / (prior + measured_err**2))
        sd_dn = level.sd_dn * np.float32(exp(log_factor))
        if sums.steps is not None:
            widths = own * _NARROWEST, width
            share = _share_of_steps(compared.coded_steps, widths, is_chroma=is_chroma)
            sd_dn = np.maximum(sd_dn, sums.steps_dn(own, counts) * np.float32(sqrt(share)))
        yield replace(
            level,
            filter_width=replace(level.filter_width, spread_err=hypot(SPREAD_ERR, err)),
            sd_dn=sd_dn,
        )


def _share_of_steps(
    coded_steps: Sequence[CodedSteps], widths_px: tuple[float, float], *, is_chroma: bool
) -> float:
    """Variance of the steps behind the second of two Gaussians, as white noise that is as large.

    Over that of white noise as large behind the first one. The steps of fine detail are the
    largest: a wide filter sees few of them, of chroma above all.
    """

    def behind(width_px: float) -> float:
        both = [coded.variance(width_px) for coded in coded_steps]
        return sum(luma + _OF_CHROMA * is_chroma * chroma for luma, chroma in both)

    narrow, wide = (behind(width_px) for width_px in widths_px)
    return max(wide / narrow, _LEAST_OF_STEPS)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Sums:
    """Weighted sums behind a width: of the difference, its variance, and the weights of both.

    A sum of white noise over a Gaussian's weights has the variance over their squares, which are
    those of a Gaussian narrower by sqrt(2). ``steps``: of the variance by the steps of JPEG files.
    """

    width_px: float
    step_px: int
    difference: Float32Array
    variance: Float32Array
    weight: Float32Array
    bounds: Bounds | None
    steps: Float32Array | None

    @classmethod
    def of(cls, compared: Comparison) -> "_Sums":
        weight = compared.valid.astype(np.float32)
        variance = np.where(compared.valid, np.square(compared.sd_dn), np.float32(0))
        return cls(
            width_px=compared.smoothing_px,
            step_px=1,
            difference=np.asarray(compared.difference_dn * weight, dtype=np.float32),
            variance=np.asarray(variance, dtype=np.float32),
            weight=weight,
            bounds=compared.bounds and compared.bounds.through(lambda one: one * weight),
            steps=None if compared.steps_dn2 is None else compared.steps_dn2 * weight,
        )

    def wider(self, width_px: float, step_px: int) -> "_Sums":
        """The same behind a wider Gaussian, every other place of it if the step is twice as far."""
        more = sqrt(width_px**2 - self.width_px**2) / self.step_px
        every = np.s_[:: step_px // self.step_px, :: step_px // self.step_px]
        bounds = self.bounds and self.bounds.through(lambda one: _blurred(one, more)[every])
        squares = partial(_blurred, sigma_px=more * 0.5**0.5)
        return _Sums(
            width_px=width_px,
            step_px=step_px,
            difference=_blurred(self.difference, more)[every],
            variance=squares(self.variance)[every],
            weight=_blurred(self.weight, more)[every],
            bounds=bounds,
            steps=None if self.steps is None else squares(self.steps)[every],
        )

    def level(self, own_px: float, valid: BoolArray) -> DetectionLevel:
        """The level at the places that count, whose scatter is that of white noise alone."""
        weight = np.where(valid, self.weight, np.float32(1))
        bounds = self.bounds and self.bounds.through(
            lambda one: np.where(valid, one / weight, np.float32(0))
        )
        return DetectionLevel(
            filter_width=FilterWidth(width_px=self.width_px, step_px=self.step_px),
            difference_dn=np.where(valid, self.difference / weight, np.float32(0))
            if bounds is None
            else bounds.surely(),
            sd_dn=self._sd_dn(self.variance, own_px, weight),
            valid=valid,
            weight=weight,
            bounds=bounds,
        )

    def steps_dn(self, own_px: float, valid: BoolArray) -> Float32Array:
        """Standard deviation that errors as large as those of the steps have, if they are white."""
        assert self.steps is not None, "compressed files"
        return self._sd_dn(self.steps, own_px, np.where(valid, self.weight, np.float32(1)))

    def _sd_dn(self, variance: Float32Array, own_px: float, weight: Float32Array) -> Float32Array:
        """That of white noise behind the width, from a sum of its variance."""
        narrower = np.float32((own_px / self.width_px) ** 2)
        behind = np.maximum(variance, np.float32(1e-30)) * narrower
        return np.asarray(np.sqrt(behind) / weight, dtype=np.float32)


def _blurred(image: Float32Array, sigma_px: float) -> Float32Array:
    """Convolve with a Gaussian; nothing lies beyond the border."""
    size = 2 * ceil(_TAILS * sigma_px) + 1
    blurred = cv2.GaussianBlur(image, (size, size), sigma_px, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(blurred, dtype=np.float32)


def _spread(
    difference_dn: Float32Array, sd_dn: Float32Array, valid: BoolArray, width: float
) -> float:
    """Standard deviations by which places scatter, changes left out with their blurred skirts.

    ``width`` is that of the filter, in places.
    """
    # Many more places are of no use: those within a width are alike.
    every = max(round((valid.size / _SAMPLE) ** 0.5), 1)
    part = np.s_[::every, ::every]
    valid, width = valid[part], width / every
    if not valid.any():
        return 1.0
    size = np.abs(difference_dn[part] / sd_dn[part])
    spread = float(np.median(size[valid])) / 0.6745 + 1e-6
    unchanged = valid & away_from(valid & (size > _CHANGE_SD * spread), _SKIRT * width)
    ratio: FloatArray = size[unchanged if unchanged.any() else valid]
    for _ in range(_ROUNDS):
        inside = ratio[ratio < _CLIP_SD * spread]
        spread = float(np.sqrt(np.mean(np.square(inside)))) / _CLIPPED_RMS + 1e-6
    return spread


_SPOT_SIGMAS_PX = (1.0, 1.5, 3.0, 6.0)
"""Sizes for which the limit is stated, beside the one that is asked for."""

_SAMPLE_PX = 1_000_000


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LimitMaps:
    """Amplitudes at which spots are found as often as asked, on the comparison's grid.

    ``threshold_sd``: significance beyond which a place counts as changed. ``levels, widths``: in
    which it is looked for, and their filters as they act on the follow-up. ``valid``: pixels that
    were compared. ``followup_px``: follow-up pixels to one of the grid, along a line.
    ``change_rgb``: change of colour of amplitude 1; None in grey. ``errors_dn``: standard error of
    an amplitude at each level, allowance included.
    """

    threshold_sd: float
    levels: tuple[DetectionLevel, ...]
    widths: tuple[FilterWidth, ...]
    valid: BoolArray
    followup_px: float
    errors_dn: tuple[Float32Array, ...]
    change_rgb: tuple[float, float, float] | None = None

    @classmethod
    def of(
        cls,
        compared: Comparison,
        levels: Sequence[DetectionLevel],
        threshold_sd: float,
        followup_px: float,
        rgb: tuple[float, float, float] = (1.0, 1.0, 1.0),
    ) -> "LimitMaps":
        """Take what limits detection from a comparison and its levels; in colour, of one change."""
        return cls(
            threshold_sd=threshold_sd,
            levels=tuple(levels),
            widths=tuple(_on_followup(level.filter_width, compared) for level in levels),
            valid=compared.valid,
            followup_px=followup_px,
            errors_dn=tuple(level.error_along(rgb) for level in levels),
            change_rgb=None if levels[0].colours is None else rgb,
        )

    def height_for(self, power: float) -> float:
        """Significance that a spot must have by itself to be found so often."""
        return height_for(power, self.threshold_sd, self.widths[0].planes)

    def limit_dn(self, spot_sigma_px: float, power: float = POWER, every: int = 1) -> Float32Array:
        """Amplitude of a spot in the follow-up's levels; infinite where nothing was compared.

        ``spot_sigma_px``: its width as the follow-up shows it, in follow-up pixels. ``every``:
        every so many pixels of the grid, along both of its sides.
        """
        height = self.height_for(power)
        sigma = np.array(spot_sigma_px / self.followup_px)
        valid = self.valid[::every, ::every]
        least = np.full(valid.shape, np.inf, dtype=np.float32)
        levels = zip(self.levels, self.widths, self.errors_dn, strict=True)
        for level, width, error_dn in levels:
            factor = np.float32(height / float(response(sigma, width)))
            np.minimum(least, level.sd_on_grid(error_dn, valid.shape, every) * factor, out=least)
        least[~valid] = np.inf
        return least


def _on_followup(width: FilterWidth, compared: Comparison) -> FilterWidth:
    """The filter that acts on the follow-up, smoothed otherwise than the grid's own photograph."""
    wider = width.width_px**2 - compared.smoothing_px**2
    return FilterWidth(
        width_px=(compared.followup_smoothing_px**2 + wider) ** 0.5,
        step_px=width.step_px,
        planes=width.planes,
    )


def detection_limit(
    maps: LimitMaps, spot_sigma_px: float, contrast_dn: float | None
) -> DetectionLimit:
    """State the limits over the compared pixels.

    ``spot_sigma_px``: width of the spots for which the limit is mapped; it is stated for others
    too. ``contrast_dn``: amplitude for which the share of the pixels is told where the limit is
    lower.
    """
    # Limits vary as slowly as the filters are wide.
    every = max(round((maps.valid.size / _SAMPLE_PX) ** 0.5), 1)
    spots = []
    for sigma_px in sorted({*_SPOT_SIGMAS_PX, spot_sigma_px}):
        limit = maps.limit_dn(sigma_px, every=every)
        if not np.isfinite(limit).any():
            # Of drawings so little is compared that a sample may miss it.
            limit = maps.limit_dn(sigma_px)
        limit = limit[np.isfinite(limit)]
        reached = None
        if contrast_dn is not None:
            reached = float(np.mean(limit <= contrast_dn)) if len(limit) else 0.0
        median, high, worst = np.quantile(limit, [0.5, 0.95, 1.0]).tolist()
        spots.append(
            SpotLimit(
                spot_sigma_px=sigma_px,
                median_dn=median,
                p95_dn=high,
                worst_dn=worst,
                reached_fraction=reached,
            )
        )
    return DetectionLimit(
        power=POWER,
        spots=tuple(spots),
        contrast_dn=contrast_dn,
        map_spot_sigma_px=spot_sigma_px,
        change_rgb=maps.change_rgb,
    )
