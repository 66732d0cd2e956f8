"""Whether two photographs are of one view, so that each pixel lies upon its own in the other."""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from analysis.changes.matching import RelativeBlur, smoothed, smoothing_for
from analysis.changes.options import ChangeOptions
from analysis.changes.photograph_pair import PhotographPair
from calibration.registration import DistortedPose
from simulation.arrays import AnyArray, Float32Array


@dataclass(frozen=True, slots=True, kw_only=True)
class OneView:
    """The pose of two photographs of one view, and how much blurrier one is."""

    pose: DistortedPose
    blur: RelativeBlur


_LEAST_PIXELS: Final = 1000
_MOST_UNLIKE: Final = 0.25
"""Mean square of what differs over that of the scene: 2 for two unrelated ones, 0.2 at a noise as
large as the scene."""

_NEAR_PX: Final = 0.5
"""A pose so near to a shift by whole pixels may be one."""

_NEARBY_PX: Final = 4.0
"""A pose so near to one may be an error of the registration, where what differs is irregular."""

_MOST_PX, _SURELY, _MOST_ERR_PX = 0.03, 3.0, 0.1
"""Displacement at a corner that does not matter, the standard errors up to which it is none, and
the error beyond which nothing is known of it. Registration is no better than 0.01 to 0.03 px."""


def one_view(
    reference: AnyArray,
    followup: AnyArray,
    options: ChangeOptions,
    shift_px: tuple[int, int] = (0, 0),
) -> OneView | None:
    """Return the pose of one view, if the photographs are such; None if they are to be aligned.

    A camera that stood still is not to be aligned: the errors of that would be the only ones.

    Parameters
    ----------
    reference, followup
        Grey, shape ``(rows, cols)`` each.
    options
        Masks and white levels.
    shift_px
        ``(y, x)`` of the follow-up's first pixel in the reference.
    """
    pose = _shifted(reference, followup, shift_px)
    found = _blur_at(reference, followup, options, pose)
    if found is None:
        return None
    apart_px, err_px = found.most_displaced
    # Written so that NaN is no view.
    if not (found.unlike < _MOST_UNLIKE and err_px < _MOST_ERR_PX):
        return None
    if not apart_px <= max(_MOST_PX, _SURELY * err_px):
        return None
    return OneView(pose=pose, blur=found)


def view_rather(
    reference: AnyArray, followup: AnyArray, options: ChangeOptions, pose: DistortedPose
) -> OneView | None:
    """Return the pose of one view, if the photographs agree better at it than as registered.

    Where next to nothing is seen, registration may be far off. A drawing of which each line was
    moved a little, by itself, has no pose: registration then follows some of the lines.

    Parameters
    ----------
    reference, followup
        Grey, shape ``(rows, cols)`` each.
    options
        Masks and white levels.
    pose
        As registered.
    """
    nearest = nearest_shift(pose, _NEARBY_PX) or (0, 0)
    registered = _seen_from(reference, pose)
    for shift_px in sorted({(0, 0), nearest}):
        shifted = _shifted(reference, followup, shift_px)
        # Interpolation makes noise less, smoothing what a line displaced by itself adds.
        both = registered, _seen_from(reference, shifted)
        if not any(_is_nearer(both, followup, options, smoothing_px) for smoothing_px in (0, 1)):
            continue
        blur = _blur_at(reference, followup, options, shifted)
        if blur is not None:
            return OneView(pose=shifted, blur=blur)
    return None


def _blur_at(
    reference: AnyArray, followup: AnyArray, options: ChangeOptions, pose: DistortedPose
) -> RelativeBlur | None:
    """How much blurrier one is at a pose; None where they share too little."""
    pair = PhotographPair.of(reference, followup, pose, options)
    valid = pair.valid(smoothing_for(0.0))
    return None if np.count_nonzero(valid) < _LEAST_PIXELS else pair.blur(valid, 0.0)


def _seen_from(reference: AnyArray, pose: DistortedPose) -> Float32Array:
    """The reference on the follow-up's pixels, NaN outside: for a mean, not for a comparison."""
    levels = np.asarray(reference, dtype=np.float32)
    rows, cols = pose.followup_shape
    if pose.k1 == 0:
        return np.asarray(
            cv2.warpPerspective(
                levels,
                pose.matrix,
                (cols, rows),
                flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
                borderValue=(np.nan,) * 4,
            ),
            dtype=np.float32,
        )
    y, x = np.indices((rows, cols), dtype=np.float64)
    to_y, to_x = (one.astype(np.float32) for one in pose.to_reference_px(y, x))
    seen = cv2.remap(levels, to_x, to_y, cv2.INTER_CUBIC, borderValue=(np.nan,) * 4)
    return np.asarray(seen, dtype=np.float32)


def _is_nearer(
    both: tuple[Float32Array, Float32Array],
    followup: AnyArray,
    options: ChangeOptions,
    smoothing_px: float,
) -> bool:
    """Whether the second of two images differs less from the follow-up, in one light each."""
    own = np.asarray(followup, dtype=np.float32)
    if smoothing_px > 0:
        both = smoothed(both[0], smoothing_px), smoothed(both[1], smoothing_px)
        own = smoothed(own, smoothing_px)
    valid = np.isfinite(both[0]) & np.isfinite(both[1]) & np.isfinite(own)
    if options.left_out is not None:
        valid &= ~options.left_out
    if np.count_nonzero(valid) < _LEAST_PIXELS:
        return False
    levels = own[valid]
    levels -= np.median(levels)
    apart = []
    for image in both:
        others = image[valid]
        others -= np.median(others)
        # Not the slope of a regression, which is less where they differ more.
        gain = np.mean(np.abs(levels)) / max(float(np.mean(np.abs(others))), 1e-30)
        apart.append(float(np.mean(np.abs(levels - np.float32(gain) * others))))
    return apart[1] < apart[0]


def _shifted(reference: AnyArray, followup: AnyArray, shift_px: tuple[int, int]) -> DistortedPose:
    matrix = np.array([[1.0, 0.0, shift_px[1]], [0.0, 1.0, shift_px[0]], [0.0, 0.0, 1.0]])
    shapes = [
        (int(one.shape[0]), int(one.shape[1])) for one in map(np.asarray, (reference, followup))
    ]
    return DistortedPose(matrix=matrix, k1=0.0, reference_shape=shapes[0], followup_shape=shapes[1])


def nearest_shift(pose: DistortedPose, near_px: float = _NEAR_PX) -> tuple[int, int] | None:
    """Whole pixels ``(y, x)`` by which a pose moves the frame; None if it is no such shift.

    Parameters
    ----------
    pose
        Any.
    near_px
        How far the corners may be from where the shift puts them.
    """
    rows, cols = pose.followup_shape
    y, x = (
        np.array([0.0, 0.0, rows - 1.0, rows - 1.0]),
        np.array([0.0, cols - 1.0, 0.0, cols - 1.0]),
    )
    to_y, to_x = pose.to_reference_px(y, x)
    shift_y, shift_x = round(float(np.mean(to_y - y))), round(float(np.mean(to_x - x)))
    apart = np.hypot(to_y - y - shift_y, to_x - x - shift_x)
    return (shift_y, shift_x) if float(apart.max()) < near_px else None
