"""Directions of edges by name."""

from typing import Literal

Orientation = Literal["vertical", "horizontal", "diagonal"]

ORIENTATION_TOLERANCE_DEG = 22.5
"""Half the angle between the directions that have a name of their own."""


def orientation_of(angle_deg: float) -> Orientation:
    """Name of an edge's direction: vertical or horizontal within 22.5 degrees, else diagonal."""
    from_horizontal = abs((angle_deg + 90.0) % 180.0 - 90.0)
    if from_horizontal <= ORIENTATION_TOLERANCE_DEG:
        return "horizontal"
    if from_horizontal >= 90.0 - ORIENTATION_TOLERANCE_DEG:
        return "vertical"
    return "diagonal"
