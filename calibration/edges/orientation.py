"""Names of the directions of edges."""

from typing import Literal

Orientation = Literal["vertical", "horizontal", "diagonal"]

ORIENTATION_TOLERANCE_DEG = 22.5
"""Half the angle between the named directions."""


def orientation_of(angle_deg: float) -> Orientation:
    """Name of an edge's direction: vertical or horizontal within 22.5 degrees, else diagonal."""
    from_horizontal = abs((angle_deg + 90.0) % 180.0 - 90.0)
    if from_horizontal <= ORIENTATION_TOLERANCE_DEG:
        return "horizontal"
    if from_horizontal >= 90.0 - ORIENTATION_TOLERANCE_DEG:
        return "vertical"
    return "diagonal"
