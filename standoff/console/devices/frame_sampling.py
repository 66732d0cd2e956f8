"""Levels of a live frame at full depth: of a pixel, and along a line."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from simulation.arrays import FloatArray
from standoff.console.devices.frame_broadcaster import LiveFrame

AROUND_PX = 2
"""Pixels on each side of one that are averaged with it: 5 x 5."""

MOST_SAMPLES = 2000

Point = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelReading:
    """Level of a pixel, and the mean of it and its neighbours (5 x 5, less at the border)."""

    level_dn: int
    mean_dn: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LineProfile:
    """Levels at equal distances along a line of ``length_px``, both of its ends included."""

    levels_dn: FloatArray
    length_px: float


def pixel_reading(frame: LiveFrame, x_px: int, y_px: int) -> PixelReading | None:
    """Read a pixel; the upper left one is at 0, 0. None if it is not in the frame."""
    image_dn = frame.image_dn
    rows, cols = image_dn.shape
    if not (0 <= x_px < cols and 0 <= y_px < rows):
        return None
    around = image_dn[
        max(y_px - AROUND_PX, 0) : y_px + AROUND_PX + 1,
        max(x_px - AROUND_PX, 0) : x_px + AROUND_PX + 1,
    ]
    return PixelReading(level_dn=int(image_dn[y_px, x_px]), mean_dn=float(around.mean()))


def line_profile(frame: LiveFrame, start: Point, end: Point) -> LineProfile | None:
    """Sample a line bilinearly, at most one pixel apart unless it is longer than `MOST_SAMPLES`.

    Parameters
    ----------
    start, end
        x and y in px; pixel centres are at integers.

    Returns
    -------
    LineProfile or None
        None if an end is not in the frame.
    """
    rows, cols = frame.image_dn.shape
    for x_px, y_px in (start, end):
        if not (-0.5 <= x_px <= cols - 0.5 and -0.5 <= y_px <= rows - 0.5):
            return None
    length_px = math.dist(start, end)
    count = min(max(math.ceil(length_px) + 1, 2), MOST_SAMPLES)
    across, down = (np.linspace(*pair, count) for pair in zip(start, end, strict=True))
    levels = map_coordinates(
        frame.image_dn, [down, across], output=np.float64, order=1, mode="nearest"
    )
    return LineProfile(levels_dn=levels, length_px=length_px)
