"""Matches of two captures by all their pixels: one shift for each block of the further one."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate1d, gaussian_filter, map_coordinates

from calibration.geometry.camera import PlaneLens
from calibration.geometry.series import PlaneMatches, PosedCapture
from simulation.arrays import BoolArray, FloatArray

_Value = TypeVar("_Value", bound=np.generic)

BLOCK_PX = 32
"""Side of a block: some tens of texture grains, and still hundreds of blocks per capture."""

_BLUR_PX = 0.65
"""Total PSF assumed for blurring the nearer capture to the further one's sharpness.

A wrong width blurs every detail symmetrically, and so moves nothing.
"""
_BORDER_PX = 3.0
_CORRELATION_MIN = 0.8
_SHIFT_MAX_PX = 1.0
_ERROR_MAX_PX = 0.3
_CONDITION_MAX = 1e12
_UNKNOWNS = 6
_RAMPS = tuple(
    ramp.ravel() for ramp in np.meshgrid(*[np.linspace(-1.0, 1.0, BLOCK_PX)] * 2, indexing="xy")
)
_SLOPE_WEIGHTS = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12
_ERROR_FLOOR_PX = 0.01
"""Approximate error of a block's shift by aliasing; it keeps single blocks from dominating."""


def match_blocks(
    lens: PlaneLens, nears: Sequence[PosedCapture], far: PosedCapture
) -> list[PlaneMatches]:
    """Find each block of the furthest capture in nearer ones.

    The nearer capture is blurred to the further one's sharpness and sampled at the positions given
    by the two poses; the remaining shift of every block is found by least squares, with its gain,
    the slopes of the gain (vignetting) and its offset free.

    Parameters
    ----------
    lens
        The lens, inclined as it is to the target.
    nears, far
        Captures of one target with poses accurate to a fraction of a pixel.

    Returns
    -------
    list of PlaneMatches
        Matches of the further capture with each nearer one; empty if they do not overlap.

    References
    ----------
    A. Gruen, "Adaptive least squares correlation: a powerful image matching technique", South
    African Journal of Photogrammetry, Remote Sensing and Cartography 14 (3), 1985.
    """
    image = np.asarray(far.capture.image, dtype=np.float64)
    rows, cols = (size // BLOCK_PX * BLOCK_PX for size in image.shape)
    top, left = (image.shape[0] - rows) // 2, (image.shape[1] - cols) // 2
    y, x = np.mgrid[top : top + rows, left : left + cols].astype(np.float64)
    plane = far.pose.plane(lens.slopes(np.column_stack([x.ravel(), y.ravel()])))
    blocks = _Blocks(
        measured=image[top : top + rows, left : left + cols],
        plane=plane.reshape(rows, cols, 2),
        x_px=x[0],
        y_px=y[:, 0],
    )
    return [_match(lens, near, far, blocks) for near in nears]


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """The whole blocks of a capture: levels, plane points and pixel coordinates."""

    measured: FloatArray
    plane: FloatArray
    x_px: FloatArray
    y_px: FloatArray


def _match(lens: PlaneLens, near: PosedCapture, far: PosedCapture, blocks: _Blocks) -> PlaneMatches:
    simulated, whole = _simulated(lens, near, far, blocks.plane)
    slope_y, slope_x = (_slope(simulated, axis) for axis in (0, 1))
    levels = _flat(simulated, whole)
    design = np.stack(
        [
            _flat(slope_x, whole),
            _flat(slope_y, whole),
            levels,
            np.ones_like(levels),
            *(levels * ramp for ramp in _RAMPS),
        ],
        axis=2,
    )
    target = _flat(blocks.measured, whole)
    # Centred levels keep the equations well conditioned.
    for column in (2, 4, 5):
        design[:, :, column] -= design[:, :, column].mean(axis=1, keepdims=True)
    target = target - target.mean(axis=1, keepdims=True)
    transposed = design.swapaxes(1, 2)
    normal = transposed @ design
    good = np.linalg.cond(normal) < _CONDITION_MAX
    inverse = np.linalg.inv(np.where(good[:, None, None], normal, np.eye(_UNKNOWNS)))
    solution = (inverse @ (transposed @ target[:, :, None]))[:, :, 0]
    residual = target - (design @ solution[:, :, None])[:, :, 0]
    left_over = np.sum(residual**2, axis=1)
    gain = np.where(solution[:, 2] > 0, solution[:, 2], np.inf)
    shift = solution[:, :2] / gain[:, None]
    variance = left_over / (design.shape[1] - _UNKNOWNS) / gain**2
    covariance = inverse[:, :2, :2] * variance[:, None, None]
    good &= np.isfinite(gain)
    good &= left_over < (1 - _CORRELATION_MIN**2) * np.sum(target**2, axis=1)
    good &= np.hypot(shift[:, 0], shift[:, 1]) < _SHIFT_MAX_PX
    good &= np.trace(covariance, axis1=1, axis2=2) < _ERROR_MAX_PX**2
    centre_y, centre_x = np.meshgrid(
        blocks.y_px.reshape(-1, BLOCK_PX).mean(axis=1),
        blocks.x_px.reshape(-1, BLOCK_PX).mean(axis=1),
        indexing="ij",
    )
    centres = np.column_stack([centre_x.ravel(), centre_y.ravel()])[whole][good]
    moved = far.pose.plane(lens.slopes(centres + shift[good]))
    return PlaneMatches(
        capture=far.capture,
        seen_px=centres,
        other=near.capture,
        other_points=lens.pixels(near.pose.slopes(moved)),
        covariance_px2=covariance[good] + np.eye(2) * _ERROR_FLOOR_PX**2,
    )


def _simulated(
    lens: PlaneLens, near: PosedCapture, far: PosedCapture, plane: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """The nearer capture on the further one's pixels, and which blocks are completely inside it."""
    rows, cols = plane.shape[:2]
    image = np.asarray(near.capture.image, dtype=np.float64)
    source = lens.pixels(near.pose.slopes(plane.reshape(-1, 2))).reshape(rows, cols, 2)
    height, width = image.shape
    inside = (
        (source[:, :, 0] > _BORDER_PX)
        & (source[:, :, 0] < width - 1 - _BORDER_PX)
        & (source[:, :, 1] > _BORDER_PX)
        & (source[:, :, 1] < height - 1 - _BORDER_PX)
    )
    zoom = far.pose.distance / near.pose.distance
    blurred = gaussian_filter(image, _BLUR_PX * sqrt(max(zoom**2 - 1, 0.0)), mode="nearest")
    simulated = np.zeros((rows, cols))
    simulated[inside] = map_coordinates(
        blurred, [source[inside, 1], source[inside, 0]], order=3, mode="nearest"
    )
    return simulated, _blocks(inside).all(axis=(2, 3)).ravel()


def _slope(image: FloatArray, axis: int) -> FloatArray:
    """Fourth-order derivative: a second-order one comes out too small for fine detail."""
    return np.asarray(correlate1d(image, _SLOPE_WEIGHTS, axis=axis, mode="nearest"))


def _blocks(image: NDArray[_Value]) -> NDArray[_Value]:
    """Blocks of an image, shape (block rows, block columns, side, side)."""
    rows, cols = image.shape
    cut = image.reshape(rows // BLOCK_PX, BLOCK_PX, cols // BLOCK_PX, BLOCK_PX)
    return cut.swapaxes(1, 2)


def _flat(image: FloatArray, chosen: BoolArray) -> FloatArray:
    """Pixels of the chosen blocks, shape (blocks, pixels)."""
    return _blocks(image).reshape(-1, BLOCK_PX * BLOCK_PX)[chosen]
