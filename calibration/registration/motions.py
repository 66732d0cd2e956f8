"""Small motions of a follow-up's pixels: the degrees of freedom of a pose in the descent."""

from math import sqrt

import numpy as np

from simulation.arrays import FloatArray
from simulation.pose import projection_slopes

_MOTIONS = ((0, 2), (1, 2), (0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1))
"""Elements of each motion in the 3 x 3 matrix that is added to the identity, in coordinates (u, v)
in [-1, 1] about the follow-up's centre; shifts along x and y come first."""


def flows_at(
    y_px: FloatArray, x_px: FloatArray, shape: tuple[int, int]
) -> list[tuple[FloatArray, FloatArray]]:
    """Displacement of follow-up pixels by one pixel of each motion, along x and y.

    Parameters
    ----------
    y_px, x_px
        Positions in a follow-up of ``shape``, shape (n,).
    """
    half_px = _half_size_px(shape)
    u, v = (x_px - (shape[1] - 1) / 2) / half_px, (y_px - (shape[0] - 1) / 2) / half_px
    unit, nothing = (u, v, np.ones_like(u)), np.zeros_like(u)
    flows = []
    for row, col in _MOTIONS:
        along_x = unit[col] if row == 0 else -unit[col] * u if row == 2 else nothing
        along_y = unit[col] if row == 1 else -unit[col] * v if row == 2 else nothing
        flows.append((along_x, along_y))
    return flows


def moved_matrix(matrix: FloatArray, step_px: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Pose after a step of a number of pixels along each motion.

    Parameters
    ----------
    matrix
        Shape (3, 3): follow-up pixel centres to reference pixel centres.
    step_px
        One number for each motion.
    shape
        ``(rows, cols)`` of the follow-up.

    Returns
    -------
    ndarray of float64, shape (3, 3)
        Its last element is 1.
    """
    half_px = _half_size_px(shape)
    to_unit = np.diag([1 / half_px, 1 / half_px, 1.0])
    to_unit[:2, 2] = [-(shape[1] - 1) / 2 / half_px, -(shape[0] - 1) / 2 / half_px]
    motion = np.eye(3)
    for element, amount in zip(_MOTIONS, step_px, strict=True):
        motion[element] += amount / half_px
    moved = matrix @ np.linalg.inv(to_unit) @ motion @ to_unit
    return np.asarray(moved / moved[2, 2])


def _half_size_px(shape: tuple[int, int]) -> float:
    """Unit of the motions' coordinates: half the longer side of the follow-up."""
    return max(shape) / 2


def zoom_at_centre(matrix: FloatArray, shape: tuple[int, int]) -> float:
    """Square root of the homography's area ratio at the image centre."""
    a, b, c, d = projection_slopes(matrix, (shape[1] - 1) / 2, (shape[0] - 1) / 2)
    return sqrt(abs(a * d - b * c))
