"""What a detector gets and says: the reference as the follow-up sees it, and scores or maps."""

import traceback
from dataclasses import dataclass, field
from numbers import Real

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from acquisition.printable import on_one_line
from analysis.errors import DetectorError
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatArray

_SLACK_PX = 1e-6
_LEAST_DEPTH = 1e-9
"""Of the largest depth in the frame: nearer to the horizon of the plane, nothing is seen."""

_LIGHT_PX = 4.0
_FLAT = 1e-12
"""Share of the mean square below which a variance is the rounding of float32 levels."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FollowupView:
    """What the reference shows at the follow-up's pixels.

    Parameters
    ----------
    levels
        Shape ``(rows, cols)`` of the follow-up; those of the nearest border, mirrored, where it
        sees nothing.
    inside
        Pixels that see the reference: their centres lie among its pixel centres.
    """

    levels: FloatArray = field(repr=False)
    inside: BoolArray = field(repr=False)


def followup_view(
    reference: AnyArray, followup_shape: tuple[int, int], homography: FloatArray
) -> FollowupView:
    """Resample the reference at the follow-up's pixels, by a cubic spline and without smoothing.

    Parameters
    ----------
    reference
        Finite, shape ``(rows, cols)``.
    followup_shape
        ``(rows, cols)``.
    homography
        Shape (3, 3): follow-up pixel centres ``(x, y, 1)`` to reference pixel centres.
    """
    rows, cols = reference.shape
    y, x, inside = _positions(followup_shape, homography, (rows, cols))
    # A pixel that looks far past the border asks for as much memory as there are mirrors.
    y, x = np.clip(y, -rows, 2.0 * rows), np.clip(x, -cols, 2.0 * cols)
    levels = map_coordinates(reference.astype(np.float64), [y, x], order=3, mode="mirror")
    return FollowupView(levels=np.asarray(levels), inside=inside)


def sees_reference(
    reference_shape: tuple[int, int], followup_shape: tuple[int, int], homography: FloatArray
) -> BoolArray:
    """Mark the follow-up's pixels whose centres lie among the reference's pixel centres."""
    return _positions(followup_shape, homography, reference_shape)[2]


def _positions(
    followup_shape: tuple[int, int], homography: FloatArray, reference_shape: tuple[int, int]
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Positions (y, x) in the reference, 0 behind the camera; and which lie inside."""
    rows, cols = (np.arange(size, dtype=np.float64) for size in followup_shape)
    y, x = rows[:, None], cols
    at_x, at_y, depth = (row[0] * x + row[1] * y + row[2] for row in homography)
    # In front of the camera is where the middle of the frame is.
    towards = 1.0 if depth[followup_shape[0] // 2, followup_shape[1] // 2] >= 0 else -1.0
    in_front = towards * depth > _LEAST_DEPTH * np.abs(depth).max()
    at_x, at_y = (
        np.divide(at, depth, out=np.zeros_like(at), where=in_front) for at in (at_x, at_y)
    )
    inside = in_front
    for at, size in zip((at_y, at_x), reference_shape, strict=True):
        inside = inside & (at >= -_SLACK_PX) & (at <= size - 1 + _SLACK_PX)
    return at_y, at_x, inside


def in_light_of(followup: AnyArray, seen: FloatArray, inside: BoolArray) -> FloatArray:
    """Return the seen reference in the follow-up's light; the follow-up where not ``inside``.

    Gain and offset are fitted by least squares to both images behind a Gaussian of 4 px over the
    pixels ``inside``, which leaves little that a difference of sharpness reaches. A gain below 0 is
    none of light: the levels are then merely shifted, as they are where the reference is flat.
    """
    target = followup.astype(np.float64)
    if not inside.any():
        return target
    share = gaussian_filter(inside.astype(np.float64), _LIGHT_PX)[inside]
    before, after = (
        gaussian_filter(np.where(inside, image, 0.0), _LIGHT_PX)[inside] / share
        for image in (seen, target)
    )
    mean_before, mean_after = float(before.mean()), float(after.mean())
    steps = before - mean_before
    variance = float(np.mean(steps**2))
    gain = 1.0
    if variance > _FLAT * (variance + mean_before**2):
        fitted = float(np.mean(steps * (after - mean_after))) / variance
        gain = fitted if fitted > 0 else 1.0
    return np.where(inside, gain * (seen - mean_before) + mean_after, target)


_LINE_LETTERS = 300


def plain_answer(answer: object) -> float | Float32Array:
    """Return a number as float and an array as float32; a 0-d array is a number.

    Raises
    ------
    DetectorError
        With reason ``output``, if it is neither; the message lacks the detector's name.
    """
    if isinstance(answer, Real) or (isinstance(answer, np.ndarray) and answer.ndim == 0):
        answer = np.asarray(answer)
    elif not isinstance(answer, np.ndarray):
        # Tensors become arrays; a list would too, and text.
        if not hasattr(answer, "__array__"):
            raise DetectorError(
                f"it returned {_kind(answer)}; a detector returns a number or an array",
                reason="output",
            )
        answer = np.asarray(answer)
    if answer.dtype.kind not in "biuf":
        raise DetectorError(
            f"it returned {answer.dtype} values; a detector's are real numbers", reason="output"
        )
    if answer.ndim == 0:
        return float(answer)
    with np.errstate(over="ignore"):  # infinite levels are refused by whoever checks
        return np.ascontiguousarray(answer, dtype=np.float32)


def exception_line(error: BaseException) -> str:
    """Return the last line of what Python prints for an exception."""
    lines = "".join(traceback.format_exception_only(error)).strip().splitlines()
    return short_line(lines[-1] if lines else type(error).__name__)


def short_line(text: str) -> str:
    """Return a text as one printable line of bounded length."""
    shown = on_one_line(text.strip())
    return shown if len(shown) <= _LINE_LETTERS else f"{shown[:_LINE_LETTERS]}..."


def _kind(value: object) -> str:
    return "None" if value is None else f"a {type(value).__name__}"
