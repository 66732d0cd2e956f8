"""Two photographs in the roles that their comparison gives them."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from analysis.changes.matching import (
    KERNEL_RADIUS_PX,
    PixelPositions,
    RelativeBlur,
    Smoothing,
    ToneCurve,
    WhiteNoiseGain,
    away_from,
    relative_blur,
    rounding_variance,
    smoothed,
)
from analysis.changes.options import ChangeOptions
from analysis.changes.unusable import clipped_at_black, clipped_at_white
from calibration.registration import DistortedPose
from simulation.arrays import AnyArray, BoolArray, Float32Array

_COMMON_PSF_PX2 = 0.64
"""Variance of a common camera's PSF, for a first guess of how blurry one is against the other."""

Ends = tuple[BoolArray, BoolArray]
"""Pixels at black, and at white."""

_BORDER_SD = 3.0
_LEAST_SHARE, _LEAST_PIXELS = 0.2, 1000
"""Of the pixels within the border, between the ends of the scale, for models to be fitted there."""

_LEAST_OF_A_LEVEL, _MOST_OF_TWO_LEVELS = 0.01, 0.9
"""Share of the pixels at black and at white, each and both, from which on a picture counts as a
drawing of these two levels."""

_UNLIKE_OUTLINES = 0.02
"""Share of the pixels beside outlines that differ, from which on these were drawn anew."""

_BETWEEN_LEVELS = np.float32(3.0)
"""Light half-way between two levels takes either by chance: a quarter of the squared step, where a
twelfth is the mean over all light. Of a smooth surface whole places lie there."""

_AROUND_PX, _MOSTLY = 2.0, 0.8
"""Share of the pixels around one, by a Gaussian, from which on a channel is at an end of its scale
there. Half of them are where noise about that end is cut off, and this is seen in both."""

_CLIPPED_BY_CHANCE_SD = np.float32(4.0)
"""How far below its end a level of a bracket may have been clipped by the noise of one exposure."""

_CLIPPED_SD, _CLIPPED_PX = 2.0, 3.0
"""Reach of a clipped pixel: so many widths of the smoothing, and pixels."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PhotographPair:
    """The two photographs in the roles that the comparison gives them.

    Parameters
    ----------
    is_on_followup
        Whether the target is the follow-up.
    source, target
        The nearer photograph and the other one.
    positions
        Where the target's pixels lie in the source.
    source_finite, target_finite
        Pixels that count.
    source_ends, target_ends
        Those at black and those at white.
    is_drawn
        Whether both are drawings of two levels, each with outlines of its own: the ends of the
        scale are the scene, and beside an outline the step of the levels is that between them.
    tone_slope
        Slope of the tone curve that took the target to the source's levels, at its pixels; None
        if it is as it was.
    tone_variance_dn2
        Variance of that curve at the pixels.
    source_variance_dn2, target_variance_dn2
        Variance of their pixels, where it is known.
    source_steps_dn2, target_steps_dn2
        Their variance by the steps of their files, where it is known.
    """

    is_on_followup: bool
    source: Float32Array = field(repr=False)
    target: Float32Array = field(repr=False)
    positions: PixelPositions = field(repr=False)
    source_finite: BoolArray = field(repr=False)
    target_finite: BoolArray = field(repr=False)
    source_ends: Ends = field(repr=False)
    target_ends: Ends = field(repr=False)
    is_drawn: bool = False
    tone_slope: Float32Array | None = None
    tone_variance_dn2: Float32Array | None = None
    source_variance_dn2: Float32Array | None = field(default=None, repr=False)
    target_variance_dn2: Float32Array | None = field(default=None, repr=False)
    source_steps_dn2: Float32Array | None = field(default=None, repr=False)
    target_steps_dn2: Float32Array | None = field(default=None, repr=False)

    @classmethod
    def of(
        cls, reference: AnyArray, followup: AnyArray, pose: DistortedPose, options: ChangeOptions
    ) -> "PhotographPair":
        """Give the photographs their roles: the coarser one is the target."""
        is_on_followup = pose.zoom >= 1
        images, usable, ends, variances = [], [], [], []
        for image, white, known in zip(
            (reference, followup), options.white_level_dn, options.variance_dn2, strict=True
        ):
            levels = np.asarray(image, dtype=np.float32)
            finite = np.isfinite(levels)
            levels = np.where(finite, levels, np.float32(0))
            clipped = clipped_at_white(levels, white)
            if known is not None:
                levels, known, clipped = _least_light(levels, known, clipped)
            images.append(levels)
            variances.append(known)
            usable.append(finite)
            ends.append((clipped_at_black(levels), clipped))
        for own, left_out in zip(
            usable, (options.reference_left_out, options.left_out), strict=True
        ):
            if left_out is not None:
                own &= ~left_out
        towards = pose.to_reference_px
        steps = [
            rounding_variance(image) if known is None else known
            for image, known in zip(images, options.step_variance_dn2, strict=True)
        ]
        if not is_on_followup:
            images, usable, towards = images[::-1], usable[::-1], pose.to_followup_px
            ends = ends[::-1]
            variances, steps = variances[::-1], steps[::-1]
        shapes = [(image.shape[0], image.shape[1]) for image in images]
        pair = cls(
            is_on_followup=is_on_followup,
            source=images[0],
            target=images[1],
            positions=PixelPositions.of(towards, shapes[1], shapes[0]),
            source_finite=usable[0],
            target_finite=usable[1],
            source_ends=ends[0],
            target_ends=ends[1],
            source_variance_dn2=variances[0],
            target_variance_dn2=variances[1],
            source_steps_dn2=steps[0],
            target_steps_dn2=steps[1],
        )
        if not pair._is_of_two_levels or pair._has_like_outlines:
            return pair
        drawn = [_drawn_variance(image) for image in images]
        return replace(pair, is_drawn=True, source_steps_dn2=drawn[0], target_steps_dn2=drawn[1])

    def channel(self, number: int, options: ChangeOptions) -> "PhotographPair":
        """Return the pair with one channel of the photographs' colours instead of their luma."""
        colours = options.colours
        assert colours is not None, "photographs in colour"
        images, ends, steps = [], [], []
        for image, known, white in zip(
            (colours.reference_dn, colours.followup_dn),
            colours.step_variance_dn2,
            options.white_level_dn,
            strict=True,
        ):
            levels = np.asarray(image[..., number], dtype=np.float32)
            levels = np.where(np.isfinite(levels), levels, np.float32(0))
            images.append(levels)
            ends.append(
                (_mostly(clipped_at_black(levels)), _mostly(clipped_at_white(levels, white)))
            )
            step_dn2 = rounding_variance(levels) if known is None else known[..., number]
            steps.append(_drawn_variance(levels) if self.is_drawn else step_dn2)
        if not self.is_on_followup:
            images, ends, steps = images[::-1], ends[::-1], steps[::-1]
        return replace(
            self,
            source=images[0],
            target=images[1],
            source_ends=ends[0],
            target_ends=ends[1],
            source_variance_dn2=None,
            target_variance_dn2=None,
            source_steps_dn2=steps[0],
            target_steps_dn2=steps[1],
        )

    @property
    def guessed_blur_px2(self) -> float:
        """How much blurrier the target is if one camera took both."""
        return _COMMON_PSF_PX2 * (1 - 1 / self.positions.zoom**2)

    def blur(self, valid: BoolArray, expected_px2: float) -> RelativeBlur:
        """Measure how much blurrier the target is, on the pixels ``valid``, from a first guess."""
        steps = tuple(
            0.0 if one is None else float(np.mean(one))
            for one in (self.source_steps_dn2, self.target_steps_dn2)
        )
        return relative_blur(
            self.source, self.target, self.positions, valid, expected_px2, (steps[0], steps[1])
        )

    def rounding_variance_dn2(
        self, gains: WhiteNoiseGain, smoothing: Smoothing
    ) -> Float32Array | None:
        """Most that the steps of the files give the difference; None where these are not known."""
        own, other = self.target_steps_dn2, self.source_steps_dn2
        total = None if own is None else np.float32(gains.target) * own
        if other is not None:
            brought = np.float32(gains.source) * np.nan_to_num(self.positions.seen(other))
            total = brought if total is None else total + brought
        return None if total is None else smoothed(total * _BETWEEN_LEVELS, smoothing.target_px)

    def with_tone(self, curve: ToneCurve) -> "PhotographPair":
        """Return the pair with the target in the source's levels; its variance is fitted then."""
        return replace(
            self,
            source_variance_dn2=None,
            target_variance_dn2=None,
            target=curve.of(self.target),
            target_steps_dn2=None
            if self.target_steps_dn2 is None
            else self.target_steps_dn2 * np.square(curve.slope(self.target)),
            tone_slope=smoothed(curve.slope(self.target), 1.0),
            tone_variance_dn2=smoothed(curve.variance(self.target), 1.0),
        )

    def valid(self, smoothing: Smoothing) -> BoolArray:
        """Pixels of the target that models are fitted to.

        Neither a border nor a pixel at an end of the scale reaches them, unless that leaves next to
        nothing: of drawings and scans, the ends are the scene.
        """
        inside = self._inside(smoothing)
        sound = self._away(inside, smoothing, [source | target for source, target in self._ends])
        least = max(_LEAST_SHARE * np.count_nonzero(inside), _LEAST_PIXELS)
        return sound if np.count_nonzero(sound) >= least else inside

    def compared(self, smoothing: Smoothing) -> tuple[BoolArray, BoolArray, BoolArray]:
        """Pixels that are compared, and those whose difference may be larger, or smaller.

        What is at white may be brighter, what is at black darker. Where both photographs are at
        one end, nothing is known.
        """
        inside = self._inside(smoothing)
        if self.is_drawn:
            none = np.zeros_like(inside)
            return inside, none, none
        (source_black, target_black), (source_white, target_white) = self._ends
        may_be_more, may_be_less = (
            ~self._away(inside, smoothing, ends)
            for ends in ((target_white | source_black,), (target_black | source_white,))
        )
        return inside & ~(may_be_more & may_be_less), may_be_more, may_be_less

    @property
    def _is_of_two_levels(self) -> bool:
        """Whether both are drawings of black and white."""
        return all(
            min(np.mean(black), np.mean(white)) >= _LEAST_OF_A_LEVEL
            and np.mean(black | white) >= _MOST_OF_TWO_LEVELS
            for black, white in (self.source_ends, self.target_ends)
        )

    @property
    def _has_like_outlines(self) -> bool:
        """Whether the outlines of a drawing lie pixel upon pixel in both, as in a copy."""
        shift = self.positions.whole_shift
        if shift is None:
            return False
        outlines = _drawn_variance(self.target) > 0
        apart = np.abs(self.target - self.positions.seen(self.source))[outlines]
        step_dn = float(np.ptp(self.target))
        return bool(np.mean(apart > step_dn / 2) < _UNLIKE_OUTLINES)

    @property
    def _ends(self) -> tuple[tuple[BoolArray, BoolArray], tuple[BoolArray, BoolArray]]:
        """Of source and target, the target's pixels at black; and those at white."""
        brought = [
            self.positions.inside(end, 0.0) if end.any() else np.zeros_like(self.target_finite)
            for end in self.source_ends
        ]
        return (brought[0], self.target_ends[0]), (brought[1], self.target_ends[1])

    def _away(
        self, inside: BoolArray, smoothing: Smoothing, ends: Sequence[BoolArray]
    ) -> BoolArray:
        """Pixels that none at an end reaches, by the smoothing and by what lenses scatter.

        Of one view, both photographs scatter alike.
        """
        reach_px = 0.0
        if self.positions.whole_shift is None:
            reach_px = _CLIPPED_PX + _CLIPPED_SD * max(smoothing.source_px, smoothing.target_px)
        sound = inside.copy()
        for end in ends:
            sound &= away_from(end, reach_px)
        return sound

    def _inside(self, smoothing: Smoothing) -> BoolArray:
        zoom = self.positions.zoom
        source_px, target_px = smoothing.source_px, smoothing.target_px
        border_px = KERNEL_RADIUS_PX + _BORDER_SD * max(source_px, target_px)
        sound = away_from(~self.source_finite, _CLIPPED_PX + _CLIPPED_SD * source_px * zoom)
        inside = self.positions.inside(sound, border_px * zoom)
        inside &= away_from(~self.target_finite, _CLIPPED_PX + _CLIPPED_SD * target_px)
        width = int(np.ceil(border_px))
        inside[:width] = inside[-width:] = False
        inside[:, :width] = inside[:, -width:] = False
        return inside

    def known_variances(self, smoothing: Smoothing) -> tuple[Float32Array | None, ...]:
        """Variances of target and source at the target's pixels, where known.

        A smoothed image has the variance smoothed by the square of the kernel: of a Gaussian, one
        narrower by sqrt(2).
        """
        target, source = self.target_variance_dn2, self.source_variance_dn2
        if target is not None:
            target = smoothed(target, smoothing.target_px * 0.5**0.5)
        if source is not None:
            width_px = smoothing.source_px * self.positions.zoom * 0.5**0.5
            seen = self.positions.seen(self.positions.coefficients(source, width_px))
            source = np.maximum(np.nan_to_num(seen, copy=False, nan=float(np.mean(source))), 0)
        return target, source

    def seen(self, smoothing_px: float) -> Float32Array:
        """The source on the target's pixels, smoothed; its mean where it shows nothing."""
        width_px = smoothing_px * self.positions.zoom
        seen = self.positions.seen(self.positions.coefficients(self.source, width_px))
        return np.nan_to_num(seen, copy=False, nan=float(np.mean(self.source)))


def _least_light(
    levels_dn: Float32Array, variance_dn2: Float32Array, clipped: BoolArray
) -> tuple[Float32Array, Float32Array, BoolArray]:
    """Levels of a bracket that end where chance may clip them, their variance, and where they end.

    A bracket says white of a pixel, and no variance, where any of its exposures was clipped; the
    levels below end where an exposure does, less its black.
    """
    if not clipped.any() or clipped.all():
        return levels_dn, variance_dn2, clipped
    top_dn, most_dn2 = levels_dn[~clipped].max(), variance_dn2[~clipped].max()
    least_dn = top_dn - _CLIPPED_BY_CHANCE_SD * np.sqrt(most_dn2)
    clipped = levels_dn >= least_dn
    return (
        np.where(clipped, least_dn, levels_dn),
        np.where(clipped, most_dn2, variance_dn2),
        clipped,
    )


def _drawn_variance(image_dn: Float32Array) -> Float32Array:
    """Twelfth of the squared step that a drawing of two levels takes beside each pixel."""
    around = np.ones((3, 3), dtype=np.uint8)
    return np.asarray((cv2.dilate(image_dn, around) - cv2.erode(image_dn, around)) ** 2 / 12)


def _mostly(mask: BoolArray) -> BoolArray:
    """Pixels of a mask amid others of it."""
    if not mask.any():
        return mask
    return np.asarray(mask & (smoothed(mask.astype(np.float32), _AROUND_PX) > _MOSTLY))
