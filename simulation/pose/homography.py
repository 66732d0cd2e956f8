"""A homography applied to coordinates: their images, depths and derivatives.

The functions accept numbers and arrays, and compiled code calls them directly. ``matrix`` has the
shape (3, 3) and takes ``(x, y, 1)`` to the image's coordinates times their depth.
"""

from typing import TypeVar

from simulation.arrays import FloatArray
from simulation.compiled import compiled_part

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
