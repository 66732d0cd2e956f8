"""Where an edge lies in an image: its line, its direction, and the raw pixels around it."""

from dataclasses import dataclass, replace
from math import ceil, floor
from typing import Literal, NamedTuple

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.compiled import compiled, compiled_part

SHORTEST_PX = 6.0
"""Least length of what is fitted: down to it the widths of squares' sides are within their errors,
up to an SNR of 1000; below, the corners at both ends add more than that."""

_CORNER_SIGMAS, _CORNER_EXTRA_PX = 2.5, 0.5  # at a corner, contrast is 0.6 % short there
ROUNDED_PX = 3.0  # by which a ridge ends before a corner or turns with it, at most
_SHORTEST_FOUND_PX = 16.0  # a side whose ridge is long enough to have a direction
_BAND_SIGMAS = 6.0
_BAND_EXTRA_PX = 3.0


class EdgeLine(NamedTuple):
    """The straight line of an edge: its middle, the angle of its normal, half its length."""

    x_px: float
    y_px: float
    normal_rad: float
    half_length_px: float


class BandPixels(NamedTuple):
    """The pixels of a rotated rectangle about a line, shape ``(n,)`` each.

    ``x`` and ``y`` count in px from the line's middle, ``across`` is the signed distance from the
    line; ``normal_rad`` and ``half_length_px`` are the line's.
    """

    x: FloatArray
    y: FloatArray
    values: FloatArray
    across: FloatArray
    normal_rad: float
    half_length_px: float


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeSegment:
    """A straight piece of edge, as found: good to about a tenth of a pixel.

    ``normal_rad`` is the angle of the normal from the dark to the bright side against +x, y down.
    ``length_px`` is what may be fitted, of ``found_length_px``; nothing else is within
    ``clearance_px``.
    """

    x_px: float
    y_px: float
    normal_rad: float
    length_px: float
    found_length_px: float
    sigma_px: float
    clearance_px: float = np.inf

    @property
    def line(self) -> EdgeLine:
        """The part that may be fitted, as the compiled functions take it."""
        return EdgeLine(self.x_px, self.y_px, self.normal_rad, 0.5 * self.length_px)

    def pieces(self, longest_px: float) -> list["EdgeSegment"]:
        """Cut into equal pieces of about ``longest_px``, at least one."""
        count = max(1, round(self.length_px / longest_px))
        if count == 1:
            return [self]
        length = self.length_px / count
        along_x, along_y = -np.sin(self.normal_rad), np.cos(self.normal_rad)
        offsets_px = (np.arange(count) - (count - 1) / 2) * length
        return [
            replace(
                self,
                x_px=float(self.x_px + t * along_x),
                y_px=float(self.y_px + t * along_y),
                length_px=length,
                found_length_px=length,
            )
            for t in offsets_px
        ]


@compiled()
def corner_reach(sigma_px: float) -> float:
    """How far an edge of this total width reaches beside its line and beyond its end, in px."""
    return _CORNER_SIGMAS * sigma_px + _CORNER_EXTRA_PX


def least_side_px(sigma_px: float) -> float:
    """Shortest edge between two corners that can be measured where the total width is this."""
    ends_px = 2 * (corner_reach(sigma_px) + ROUNDED_PX)
    return max(SHORTEST_PX + ends_px, _SHORTEST_FOUND_PX)


@compiled()
def band_half_width(sigma_px: float) -> float:
    """How far from an edge of this total width its pixels are used, in px."""
    return _BAND_SIGMAS * sigma_px + _BAND_EXTRA_PX


@compiled()
def band_pixels(
    image_dn: FloatArray | BoolArray, line: EdgeLine, half_width_px: float
) -> BandPixels:
    """Pick the pixels within ``half_width_px`` of a line, as far as it reaches."""
    x_px, y_px, half_width, half_length = line.x_px, line.y_px, half_width_px, line.half_length_px
    rows, cols = image_dn.shape
    c, s = np.cos(line.normal_rad), np.sin(line.normal_rad)
    reach_x = half_width * abs(c) + half_length * abs(s)
    reach_y = half_width * abs(s) + half_length * abs(c)
    top, bottom = max(ceil(y_px - reach_y), 0), min(floor(y_px + reach_y), rows - 1)
    left, right = max(ceil(x_px - reach_x), 0), min(floor(x_px + reach_x), cols - 1)
    n = max(bottom - top + 1, 0) * max(right - left + 1, 0)
    # A tilted rectangle fills a part of its box; its own area, with a margin, is enough.
    n = min(n, int(4 * (half_width + 2) * (half_length + 2)) + 16)
    x, y, values, across = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    count = 0
    for row in range(top, bottom + 1):
        dy = row - y_px
        for col in range(left, right + 1):
            dx = col - x_px
            away = c * dx + s * dy
            if abs(away) <= half_width and abs(-s * dx + c * dy) <= half_length:
                x[count], y[count] = dx, dy
                values[count], across[count] = image_dn[row, col], away
                count += 1
    return BandPixels(
        x[:count], y[:count], values[:count], across[:count], line.normal_rad, half_length
    )


@compiled_part()
def side_level(values: FloatArray, outwards: FloatArray, sigma_px: float) -> float:
    """Mean level on one side, away from the edge where there are such pixels."""
    far = near = 0.0
    n_far = n_near = 0
    for i in range(len(values)):
        if outwards[i] > 1.5 * sigma_px:
            far += values[i]
            n_far += 1
        elif outwards[i] > 0:
            near += values[i]
            n_near += 1
    if n_far:
        return far / n_far
    return near / n_near if n_near else 0.0


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
