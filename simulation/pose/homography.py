"""A homography applied to coordinates: their images, depths and derivatives.

The functions accept numbers and arrays, and compiled code calls them directly. ``matrix`` has the
shape (3, 3) and takes ``(x, y, 1)`` to the image's coordinates times their depth.
"""

from typing import TypeVar

import numpy as np

from simulation.arrays import FloatArray
from simulation.compiled import compiled_part

_FLAT = 1e-12
"""Least singular value over the largest: what inverting leaves of double precision."""

_SMALLEST, _LARGEST = 1e-8, 1e8
"""Of the area that a follow-up pixel covers of the reference, in px2."""

Coordinate = TypeVar("Coordinate", float, FloatArray)


@compiled_part()
def projection_depth(matrix: FloatArray, x: Coordinate, y: Coordinate) -> Coordinate:
    """Denominator of the homography: positive in front of the camera, 0 on the horizon."""
    depth: Coordinate = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
    return depth


@compiled_part()
def project(matrix: FloatArray, x: Coordinate, y: Coordinate) -> tuple[Coordinate, Coordinate]:
    """Coordinates (x, y) to which the homography maps a point."""
    depth = projection_depth(matrix, x, y)
    return (
        (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]) / depth,
        (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]) / depth,
    )


@compiled_part()
def projection_slopes(
    matrix: FloatArray, x: Coordinate, y: Coordinate
) -> tuple[Coordinate, Coordinate, Coordinate, Coordinate]:
    """Derivative of the homography at a point: dx'/dx, dx'/dy, dy'/dx, dy'/dy."""
    depth = projection_depth(matrix, x, y)
    to_x, to_y = project(matrix, x, y)
    return (
        (matrix[0, 0] - to_x * matrix[2, 0]) / depth,
        (matrix[0, 1] - to_x * matrix[2, 1]) / depth,
        (matrix[1, 0] - to_y * matrix[2, 0]) / depth,
        (matrix[1, 1] - to_y * matrix[2, 1]) / depth,
    )


def homography_fault(
    matrix: FloatArray, centre_px: tuple[float, float] | None = None
) -> str | None:
    """Say why no camera before a plane has a homography; None if nothing speaks against it.

    Parameters
    ----------
    matrix
        From follow-up pixels ``(x, y, 1)`` to the reference's.
    centre_px
        Middle ``(x, y)`` of the follow-up, where it is not mirrored and no scale is absurd; None if
        it is not known, or may be mirrored.
    """
    if matrix.shape != (3, 3) or not np.all(np.isfinite(matrix)):
        return f"expected 3 x 3 finite numbers, got shape {matrix.shape}"
    size = np.linalg.svd(matrix, compute_uv=False)
    if not size[2] > _FLAT * size[0]:
        return (
            "expected a matrix that can be inverted; this one maps the plane to a line or a point"
        )
    if centre_px is None:
        return None
    if projection_depth(matrix, *centre_px) == 0:
        return "the plane's horizon goes through the middle of the follow-up"
    a, b, c, d = projection_slopes(matrix, *centre_px)
    area = a * d - b * c
    if area < 0:
        return "it mirrors the scene, which no camera does; reverse the columns of one of the two"
    if not _SMALLEST < area < _LARGEST:
        return f"a follow-up pixel covers {area:.3g} px2 of the reference; is it scaled wrongly?"
    return None
