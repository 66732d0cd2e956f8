"""Whether a capture is good enough to keep: light, motion, focus, and drift since the first one."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from acquisition.session import CaptureImages, CaptureRecord

Problem = Literal["saturated", "under-exposed", "motion", "focus"]
_SATURATED_FRACTION_WARN, _SATURATED_FRACTION_RETAKE = 1e-4, 1e-2
_BRIGHT_FRACTION_WARN, _BRIGHT_FRACTION_RETAKE = 0.10, 0.03
"""Fraction of the range above black that the brightest 0.5 % of the pixels should reach."""

_MOTION_WARN_PX, _MOTION_RETAKE_PX = 0.1, 0.3
"""0.1 px of vibration adds 1 % to a PSF width of 0.7 px."""

_FOCUS_WARN, _FOCUS_RETAKE = 0.7, 0.4
"""Fraction of the focus value of the capture nearest in height."""

_LEAST_FOCUS_VALUE = 1e-5
"""Below this there is nothing in the image that could be sharp."""

_LEAST_PIXELS = 500
_SIGNIFICANT = 4.0
_CLIPPED_FROM = 0.97
_LEVEL_LIMIT = 0.01
_SHIFT_LIMIT_PX = 0.1
_RANK_LIMIT = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class QualityFinding:
    """One problem with a capture; ``text`` is a sentence for the operator.

    ``asks_retake`` is whether the problem is bad enough to take the capture again.
    """

    problem: Problem
    text: str
    asks_retake: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class _MotionEstimate:
    """Variance of the image's position between frames, along its gradients, in px^2."""

    variance_px2: float
    variance_err_px2: float

    @property
    def rms_px(self) -> float:
        """Root mean square displacement; 0 if not significant."""
        if self.variance_px2 <= _SIGNIFICANT * self.variance_err_px2:
            return 0.0
        return float(np.sqrt(self.variance_px2))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Drift:
    """Relative change of light, and shift of the image in px (x to the right, y down)."""

    level: float
    shift_x_px: float
    shift_y_px: float

    @property
    def is_notable(self) -> bool:
        """Whether it exceeds 1 % of light or a tenth of a pixel."""
        return abs(self.level) > _LEVEL_LIMIT or self.shift_px > _SHIFT_LIMIT_PX

    @property
    def shift_px(self) -> float:
        """Length of the shift."""
        return float(np.hypot(self.shift_x_px, self.shift_y_px))

    @property
    def text(self) -> str:
        """The drift in a sentence."""
        advice = "; let lamp and camera warm up, then capture again" if self.is_notable else ""
        return (
            f"since the first capture the light changed by {100 * self.level:+.2f} % and the "
            f"image moved by {self.shift_px:.2f} px{advice}"
        )


def check_capture(
    images: CaptureImages, series: Sequence[CaptureRecord]
) -> tuple[QualityFinding, ...]:
    """Return what is wrong with a capture of a series; nothing if it is good.

    Flat and dark captures always pass: their exposures are meant to be extreme.
    """
    if images.record.kind in ("flat", "dark"):
        return ()
    findings = (_saturation(images), _under_exposure(images), _motion(images))
    return tuple(f for f in (*findings, _focus(images.record, series)) if f is not None)


def bracket_remarks(record: CaptureRecord) -> tuple[str, ...]:
    """Say where the exposures of a bracket disagree on the light by more than 1 %."""
    shorter_us = None
    remarks = []
    for one in record.bracket or ():
        if one.light_ratio is not None and abs(one.light_ratio - 1) > _LEVEL_LIMIT:
            remarks.append(
                f"bracket: {one.exposure_us:g} us shows {100 * (one.light_ratio - 1):+.1f} % light "
                f"relative to {shorter_us:g} us; let the lamp warm up, expose for whole periods "
                "of its flicker, or check the black level and that gamma is off"
            )
        shorter_us = one.exposure_us
    return tuple(remarks)


def _estimate_motion(
    mean_dn: NDArray[np.floating],
    variance_dn2: NDArray[np.floating],
    frames_used: int,
    *,
    black_level_dn: float,
    max_level_dn: float,
) -> _MotionEstimate:
    """Estimate how much the image ``(rows, cols)`` moved from frame to frame.

    A displacement d turns a gradient g into a level difference g d. So the temporal variance of a
    pixel is ``a + b I + f I^2 + c g^2`` with I the light: read noise, shot noise, flicker of the
    lamp, and c the variance of the displacement, which a weighted least-squares fit gives. The
    unbiased variance of one frame, from N frames, itself has the variance ``2 v^2 / (N - 1)``.
    """
    level_dn = np.asarray(mean_dn, dtype=np.float64)
    is_usable = level_dn < _CLIPPED_FROM * max_level_dn
    if np.count_nonzero(is_usable) < _LEAST_PIXELS or min(level_dn.shape) < 2:
        return _MotionEstimate(variance_px2=0.0, variance_err_px2=np.inf)
    gradients_dn = (np.gradient(level_dn, axis=axis) for axis in (0, 1))
    squared_gradient_dn2 = np.asarray(sum(g**2 for g in gradients_dn))[is_usable]
    gradient_scale_dn2 = float(squared_gradient_dn2.mean())
    if gradient_scale_dn2 == 0:
        return _MotionEstimate(variance_px2=0.0, variance_err_px2=np.inf)
    light = (level_dn[is_usable] - black_level_dn) / max_level_dn
    terms = np.stack([np.ones_like(light), light, light**2, squared_gradient_dn2])
    terms[3] /= gradient_scale_dn2
    observed_dn2 = np.asarray(variance_dn2, dtype=np.float64)[is_usable]
    floor_dn2 = max(float(np.median(observed_dn2)) / 4, np.finfo(np.float64).tiny)
    noise_dn2 = np.full_like(light, max(float(observed_dn2.mean()), floor_dn2))
    coefficients, inverse = np.zeros(4), np.zeros((4, 4))
    for _ in range(2):
        weighted = terms / np.maximum(noise_dn2, floor_dn2) ** 2
        inverse = np.linalg.pinv(weighted @ terms.T, hermitian=True)
        coefficients = np.asarray(inverse @ (weighted @ observed_dn2))
        # Weights of the noise alone: with the motion in them, the edge's flanks would dominate.
        noise_dn2 = coefficients[:3] @ terms[:3]
    error = float(np.sqrt(inverse[3, 3] * 2.0 / max(frames_used - 1, 1)))
    return _MotionEstimate(
        variance_px2=float(coefficients[3]) / gradient_scale_dn2,
        variance_err_px2=error / gradient_scale_dn2,
    )


def drift_between(
    first_dn: NDArray[np.floating], last_dn: NDArray[np.floating], *, black_level_dn: float
) -> _Drift:
    """Measure the drift from one mean image to another of the same pose, after the change of light.

    The least-squares solution of ``last = first - g . d``: right below a pixel, too small beyond,
    and across a straight edge alone.
    """
    if first_dn.shape != last_dn.shape:
        raise ValueError(f"images must have the same shape, got {first_dn.shape}, {last_dn.shape}")
    first = np.asarray(first_dn, dtype=np.float64) - black_level_dn
    last = np.asarray(last_dn, dtype=np.float64) - black_level_dn
    energy = float(np.vdot(first, first))
    ratio = float(np.vdot(first, last)) / energy if energy > 0 else 1.0
    down, across = np.gradient((first + last / ratio if ratio > 0 else 2 * first) / 2)
    change = (last / ratio if ratio > 0 else last) - first
    normal = np.array(
        [[np.vdot(across, across), np.vdot(across, down)], [0.0, np.vdot(down, down)]]
    )
    normal[1, 0] = normal[0, 1]
    right = -np.array([np.vdot(across, change), np.vdot(down, change)])
    shift = np.linalg.pinv(normal, rcond=_RANK_LIMIT, hermitian=True) @ right
    return _Drift(level=ratio - 1.0, shift_x_px=float(shift[0]), shift_y_px=float(shift[1]))


def _saturation(images: CaptureImages) -> QualityFinding | None:
    fraction = images.record.saturated_pixels / images.mean_dn.size
    if fraction < _SATURATED_FRACTION_WARN:
        return None
    return QualityFinding(
        problem="saturated",
        text=f"{images.record.saturated_pixels} pixels ({100 * fraction:.3g} %) are saturated; "
        "shorten the exposure, or remove the gloss",
        asks_retake=fraction >= _SATURATED_FRACTION_RETAKE,
    )


def _under_exposure(images: CaptureImages) -> QualityFinding | None:
    record = images.record
    span_dn = record.max_level_dn - record.black_level_dn
    bright_dn = float(np.percentile(images.mean_dn, 99.5)) - record.black_level_dn
    if not span_dn > 0 or bright_dn >= _BRIGHT_FRACTION_WARN * span_dn:
        return None
    return QualityFinding(
        problem="under-exposed",
        text=f"the brightest parts reach {100 * max(bright_dn, 0.0) / span_dn:.1f} % of the range; "
        "lengthen the exposure, or check the light",
        asks_retake=bright_dn < _BRIGHT_FRACTION_RETAKE * span_dn,
    )


def _motion(images: CaptureImages) -> QualityFinding | None:
    if images.variance_dn2 is None:
        return None
    moved_px = _estimate_motion(
        images.mean_dn,
        images.variance_dn2,
        images.record.frames_used,
        black_level_dn=images.record.black_level_dn,
        max_level_dn=images.record.max_level_dn,
    ).rms_px
    if moved_px < _MOTION_WARN_PX:
        return None
    return QualityFinding(
        problem="motion",
        text=f"the image moved by {moved_px:.2f} px (rms) between the frames; "
        "let the stage settle, and do not touch the bench",
        asks_retake=moved_px >= _MOTION_RETAKE_PX,
    )


def _focus(record: CaptureRecord, series: Sequence[CaptureRecord]) -> QualityFinding | None:
    alike = [
        other
        for other in series
        if other.uid != record.uid
        and (other.kind, other.target, other.orientation_deg)
        == (record.kind, record.target, record.orientation_deg)
        and (other.focus_value or 0.0) > _LEAST_FOCUS_VALUE
    ]
    if record.focus_value is None or not alike:
        return None
    nearest = min(alike, key=lambda other: abs(other.height_mm - record.height_mm))
    expected = (nearest.focus_value or 0.0) * _texture_change(nearest.height_mm, record.height_mm)
    if record.focus_value >= _FOCUS_WARN * expected:
        return None
    return QualityFinding(
        problem="focus",
        text=f"the focus value is {record.focus_value:.2g}, but that of capture {nearest.index} at "
        f"{nearest.height_mm:g} mm was {nearest.focus_value:.2g}; refocus",
        asks_retake=record.focus_value < _FOCUS_RETAKE * expected,
    )


def _texture_change(one_mm: float, other_mm: float) -> float:
    """Smallest factor by which scale alone may change the value: that of a fine texture."""
    low_mm, high_mm = sorted((one_mm, other_mm))
    return (low_mm / high_mm) ** 2 if low_mm > 0 else 0.0
