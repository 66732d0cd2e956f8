"""The reference on the follow-up's pixels, as most detectors want it."""

from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from simulation.arrays import AnyArray, BoolArray, FloatArray

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
