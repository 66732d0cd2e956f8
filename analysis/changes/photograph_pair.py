"""Two photographs in the roles that their comparison gives them."""

from dataclasses import dataclass, field, replace

import numpy as np

from analysis.changes.matching import (
    KERNEL_RADIUS_PX,
    PixelPositions,
    Smoothing,
    ToneCurve,
    away_from,
    rounding_variance,
    smoothed,
    spline_coefficients,
)
from analysis.changes.options import ChangeOptions
from analysis.changes.unusable import unusable
from calibration.registration import DistortedPose
from simulation.arrays import AnyArray, BoolArray, Float32Array

_COMMON_PSF_PX2 = 0.64
"""Variance of a common camera's PSF, for a first guess of how blurry one is against the other."""

_BORDER_SD = 3.0
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
    source_usable, target_usable
        Pixels that count.
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
    source_usable: BoolArray = field(repr=False)
    target_usable: BoolArray = field(repr=False)
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
        images, usable = [], []
        for image, white in zip((reference, followup), options.white_level_dn, strict=True):
            levels = np.asarray(image, dtype=np.float32)
            finite = np.isfinite(levels)
            levels = np.where(finite, levels, np.float32(0))
            images.append(levels)
            usable.append(finite & ~unusable(levels, white))
        if options.left_out is not None:
            usable[1] &= ~options.left_out
        towards, variances = pose.to_reference_px, options.variance_dn2
        steps = [
            rounding_variance(image) if known is None else known
            for image, known in zip(images, options.step_variance_dn2, strict=True)
        ]
        if not is_on_followup:
            images, usable, towards = images[::-1], usable[::-1], pose.to_followup_px
            variances, steps = variances[::-1], steps[::-1]
        shapes = [(image.shape[0], image.shape[1]) for image in images]
        return cls(
            is_on_followup=is_on_followup,
            source=images[0],
            target=images[1],
            positions=PixelPositions.of(towards, shapes[1], shapes[0]),
            source_usable=usable[0],
            target_usable=usable[1],
            source_variance_dn2=variances[0],
            target_variance_dn2=variances[1],
            source_steps_dn2=steps[0],
            target_steps_dn2=steps[1],
        )

    @property
    def guessed_blur_px2(self) -> float:
        """How much blurrier the target is if one camera took both."""
        return _COMMON_PSF_PX2 * (1 - 1 / self.positions.zoom**2)

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
        """Pixels of the target that neither a border nor anything unusable reaches."""
        zoom = self.positions.zoom
        source_px, target_px = smoothing.source_px, smoothing.target_px
        border_px = KERNEL_RADIUS_PX + _BORDER_SD * max(source_px, target_px)
        sound = away_from(~self.source_usable, _CLIPPED_PX + _CLIPPED_SD * source_px * zoom)
        inside = self.positions.inside(sound, border_px * zoom)
        inside &= away_from(~self.target_usable, _CLIPPED_PX + _CLIPPED_SD * target_px)
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
            seen = self.positions.seen(spline_coefficients(source, width_px))
            source = np.maximum(np.nan_to_num(seen, copy=False, nan=float(np.mean(source))), 0)
        return target, source

    def seen(self, smoothing_px: float) -> Float32Array:
        """The source on the target's pixels, smoothed; its mean where it shows nothing."""
        width_px = smoothing_px * self.positions.zoom
        seen = self.positions.seen(spline_coefficients(self.source, width_px))
        return np.nan_to_num(seen, copy=False, nan=float(np.mean(self.source)))
