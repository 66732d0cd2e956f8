"""Three ways to bring a reference and a follow-up onto common pixels.

``as-in-paper``: every follow-up is scaled up by bicubic interpolation onto the reference's pixels,
a captured one by the homography of its features, a simulated one simply by the zoom.
``reference-grid`` is the same, but the captured one lies where features, pixels and the lens's
distortion together put it. ``followup-grid`` simulates the reference on the captured follow-up's
own pixels, so that neither has to be interpolated.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from analysis.errors import OverlapError
from calibration.registration import OVERLAP_MIN_PX, DistortedPose
from simulation.arrays import AnyArray, FloatArray, IntArray
from simulation.compiled import compiled, compiled_part

Procedure = Literal["as-in-paper", "reference-grid", "followup-grid"]
PROCEDURES: tuple[Procedure, ...] = get_args(Procedure)
"""Names of the three procedures."""

_KEYS_A = -0.5
"""Slope parameter of the cubic, as in Pillow's BICUBIC."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SharedWindow:
    """A rectangle of follow-up pixels that the reference covers wholly.

    ``y_px`` and ``x_px`` are their reference coordinates, of the rectangle's shape.
    """

    rows: slice
    cols: slice
    y_px: FloatArray
    x_px: FloatArray


def shared_window(pose: DistortedPose) -> SharedWindow:
    """Largest rectangle about the middle of what both images show."""
    place_y, place_x = pose.followup_places_px()
    rows, cols = pose.reference_shape
    margin_px = max(pose.zoom - 1, 0.0) / 2
    inside = (
        (place_y >= margin_px)
        & (place_y <= rows - 1 - margin_px)
        & (place_x >= margin_px)
        & (place_x <= cols - 1 - margin_px)
    )
    if not inside.any():
        raise OverlapError("the images do not overlap", shared_px=0)
    down, across = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    top, bottom, left, right = down[0], down[-1] + 1, across[0], across[-1] + 1
    while top < bottom and left < right and not inside[top:bottom, left:right].all():
        # The side with most pixels outside gives way.
        outside = ~inside[top:bottom, left:right]
        sides = [outside[0], outside[-1], outside[:, 0], outside[:, -1]]
        worst = int(np.argmax([side.mean() for side in sides]))
        top, bottom = top + (worst == 0), bottom - (worst == 1)
        left, right = left + (worst == 2), right - (worst == 3)
    if min(bottom - top, right - left) < OVERLAP_MIN_PX:
        shared_px = int(max(bottom - top, 0) * max(right - left, 0))
        raise OverlapError("the images overlap too little", shared_px=shared_px)
    here = np.s_[top:bottom, left:right]
    return SharedWindow(
        rows=slice(int(top), int(bottom)),
        cols=slice(int(left), int(right)),
        y_px=place_y[here],
        x_px=place_x[here],
    )


def bicubic_at(image: AnyArray, y_px: FloatArray, x_px: FloatArray) -> FloatArray:
    """Interpolate an image bicubically at any positions; its border is repeated outside.

    References
    ----------
    R. G. Keys, "Cubic convolution interpolation for digital image processing", 1981.
    """
    found = np.empty(np.shape(y_px))
    _interpolate(
        np.ascontiguousarray(image, dtype=np.float64), np.ravel(y_px), np.ravel(x_px), found.ravel()
    )
    return found


def scaled_up(image: AnyArray, zoom: float, shape: tuple[int, int]) -> FloatArray:
    """An image scaled up by a zoom to a size, both centred: the paper's plain upscaling."""
    y, x = (
        (np.arange(size) - (size - 1) / 2) / zoom + (count - 1) / 2
        for size, count in zip(shape, image.shape, strict=True)
    )
    return bicubic_at(image, *np.meshgrid(y, x, indexing="ij"))


@compiled(nogil=True)
def _interpolate(levels: FloatArray, y_px: FloatArray, x_px: FloatArray, found: FloatArray) -> None:
    rows, cols = levels.shape
    row, col = np.empty(4, np.int64), np.empty(4, np.int64)
    weight_y, weight_x = np.empty(4), np.empty(4)
    for i in range(found.size):
        _four_taps(y_px[i], rows, row, weight_y)
        _four_taps(x_px[i], cols, col, weight_x)
        total = 0.0
        for v in range(4):
            for u in range(4):
                total += weight_y[v] * weight_x[u] * levels[row[v], col[u]]
        found[i] = total


@compiled_part()
def _four_taps(position_px: float, size: int, pixel: IntArray, weight: FloatArray) -> None:
    """Pixels around a position, and Keys' weights of them."""
    first = int(np.floor(position_px)) - 1
    for k in range(4):
        pixel[k] = min(max(first + k, 0), size - 1)
        weight[k] = _keys(abs(position_px - (first + k)))


@compiled_part()
def _keys(x: float) -> float:
    a = _KEYS_A
    if x <= 1:
        return float(((a + 2) * x - (a + 3)) * (x * x) + 1)
    return float((((x - 5) * x + 8) * x - 4) * a) if x < 2 else 0.0
