"""Small motions of a follow-up's pixels: what the descent of a pose is free to do."""

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "AXIAL",
    "HOMOGRAPHY",
    "Generators",
    "flows_px",
    "half_size_px",
    "moved_matrix",
    "unit_places",
]

FloatArray = NDArray[np.float64]
Generators = tuple[list[tuple[int, int]], ...]

# In coordinates (u, v) in [-1, 1] about the follow-up's centre: where each motion stands in the
# 3x3 matrix that is added to the identity.
_SHIFT_X, _SHIFT_Y = [(0, 2)], [(1, 2)]
AXIAL: Generators = (_SHIFT_X, _SHIFT_Y, [(0, 0), (1, 1)])
HOMOGRAPHY: Generators = (
    _SHIFT_X, _SHIFT_Y, [(0, 0)], [(0, 1)], [(1, 0)], [(1, 1)], [(2, 0)], [(2, 1)],
)  # fmt: skip


def half_size_px(shape: tuple[int, int]) -> float:
    """Unit of the motions' coordinates: half the longer side of the follow-up."""
    return max(shape) / 2


def unit_places(shape: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Coordinates u (along x) and v (along y) of every follow-up pixel, shape ``shape`` each."""
    half_px = half_size_px(shape)
    v, u = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    return (u - (shape[1] - 1) / 2) / half_px, (v - (shape[0] - 1) / 2) / half_px


def flows_px(generators: Generators, shape: tuple[int, int]) -> list[tuple[FloatArray, FloatArray]]:
    """How far one pixel of each motion moves every follow-up pixel, along x and y."""
    u, v = unit_places(shape)
    unit = (u, v, np.ones_like(u))
    flows = []
    for places in generators:
        flow_x, flow_y = np.zeros(shape), np.zeros(shape)
        for row, col in places:
            if row == 0:
                flow_x += unit[col]
            elif row == 1:
                flow_y += unit[col]
            else:
                flow_x -= unit[col] * u
                flow_y -= unit[col] * v
        flows.append((flow_x, flow_y))
    return flows


def moved_matrix(
    matrix: FloatArray, generators: Generators, step_px: FloatArray, shape: tuple[int, int]
) -> FloatArray:
    """Pose after a step of so many pixels along each motion.

    Parameters
    ----------
    matrix
        Shape (3, 3): follow-up pixel centres to reference pixel centres.
    generators, step_px
        The motions, and one number for each.
    shape
        ``(rows, cols)`` of the follow-up.

    Returns
    -------
    ndarray of float64, shape (3, 3)
        Its last element is 1.
    """
    half_px = half_size_px(shape)
    to_unit = np.diag([1 / half_px, 1 / half_px, 1.0])
    to_unit[:2, 2] = [-(shape[1] - 1) / 2 / half_px, -(shape[0] - 1) / 2 / half_px]
    motion = np.eye(3)
    for places, amount in zip(generators, step_px, strict=True):
        for place in places:
            motion[place] += amount / half_px
    moved = matrix @ np.linalg.inv(to_unit) @ motion @ to_unit
    return np.asarray(moved / moved[2, 2])
