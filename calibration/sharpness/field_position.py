"""Where an edge lies in the field of the lens, and which of its two blurs it tells."""

from dataclasses import dataclass
from math import atan2, cos, hypot, pi
from typing import Literal

from calibration.edges import EdgeMeasurement

Direction = Literal["meridional", "sagittal"]
Corner = Literal["top left", "top right", "bottom left", "bottom right"]

_NO_DIRECTION = 0.02
"""Share of the half diagonal within which an edge has no side of the axis: 10 px of 580 x 780."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldPosition:
    """Position of an edge about the frame's centre, which is taken for the optical axis.

    ``radius`` is in half diagonals: 0 at the centre, 1 in the corners. ``direction`` is None at the
    centre. An edge is meridional where its normal is within 45 degrees of the radius: it tells the
    blur along the radius, as lines along the circumference do. The others are sagittal.
    """

    radius: float
    corner: Corner
    direction: Direction | None


def position_in_field(edge: EdgeMeasurement, width_px: int, height_px: int) -> FieldPosition:
    """Return where an edge lies in a frame of this size."""
    right = edge.x_px - (width_px - 1) / 2
    down = edge.y_px - (height_px - 1) / 2
    radius = hypot(right, down) / (0.5 * hypot(width_px - 1, height_px - 1))
    corner: Corner
    if down < 0:
        corner = "top left" if right < 0 else "top right"
    else:
        corner = "bottom left" if right < 0 else "bottom right"
    direction: Direction | None = None
    if radius > _NO_DIRECTION:
        turn = edge.normal_rad - atan2(down, right)
        direction = "meridional" if abs(cos(turn)) >= cos(pi / 4) else "sagittal"
    return FieldPosition(radius=radius, corner=corner, direction=direction)
