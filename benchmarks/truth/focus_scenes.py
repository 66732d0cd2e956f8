"""A chart of slanted squares through focus, behind a lens whose foci are known over the field.

The lens blurs by a Gaussian before square pixels, whose variance grows with the square of the
distance from the tangential focus along the radius, and from the sagittal one across it. So the
contrast across an edge, the position where it is best and the depth of field have closed forms.
Near the corners of a square the blur of its two sides is taken as that of each alone. Shares
nothing with ``calibration``.
"""

from dataclasses import dataclass
from math import cos, exp, log, pi, sin, sqrt

import numpy as np
from scipy.special import ndtr

from simulation.arrays import FloatArray

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
_MARGIN_PX = 26.0
LEVELS_DN = (400.0, 2800.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class FocusedLens:
    """Where a lens is sharp over a picture, and how fast it blurs beside.

    Positions are in mm; ``blur_px_per_mm`` is the width that a mm of defocus adds in squares to
    ``sigma_px``. ``tangential_mm`` and ``sagittal_mm`` are the changes of the focus from the centre
    to the corners, ``tilt_x_mm`` and ``tilt_y_mm`` those from left to right and top to bottom.
    """

    width_px: int
    height_px: int
    best_mm: float
    sigma_px: float
    blur_px_per_mm: float
    tangential_mm: float
    sagittal_mm: float
    tilt_x_mm: float
    tilt_y_mm: float

    def variances_px2(
        self, x_px: FloatArray, y_px: FloatArray, position_mm: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Variance along the radius and across it, and the direction of the radius."""
        right, down = x_px - (self.width_px - 1) / 2, y_px - (self.height_px - 1) / 2
        square = (right**2 + down**2) / (0.25 * (self.width_px**2 + self.height_px**2))
        focus = self.best_mm + self.tilt_x_mm * right / self.width_px
        focus = focus + self.tilt_y_mm * down / self.height_px
        blur = [
            self.sigma_px**2 + (self.blur_px_per_mm * (position_mm - focus - bend * square)) ** 2
            for bend in (self.tangential_mm, self.sagittal_mm)
        ]
        return blur[0], blur[1], np.arctan2(down, right)

    def sigma_across(
        self, x_px: FloatArray, y_px: FloatArray, normal_rad: float, position_mm: float
    ) -> FloatArray:
        """Width of the blur across an edge with this normal."""
        along, across, radius = self.variances_px2(x_px, y_px, position_mm)
        turn = normal_rad - radius
        return np.asarray(np.sqrt(along * np.cos(turn) ** 2 + across * np.sin(turn) ** 2))

    def best_across(self, x_px: float, y_px: float, normal_rad: float) -> tuple[float, float]:
        """Position of the least variance across an edge, and that variance."""
        at = np.array(x_px), np.array(y_px)
        level = [float(self.sigma_across(*at, normal_rad, one)) ** 2 for one in (-1.0, 0.0, 1.0)]
        bend = 0.5 * (level[0] + level[2]) - level[1]
        best = 0.25 * (level[0] - level[2]) / bend
        return best, level[1] - bend * best**2

    def depth_mm(
        self, at_px: tuple[float, float], normal_rad: float, contrast: float, freq: float
    ) -> float:
        """Range of positions over which an edge has a contrast at a frequency; 0 if nowhere."""
        _, least = self.best_across(*at_px, normal_rad)
        pixel = float(np.sinc(freq * cos(normal_rad)) * np.sinc(freq * sin(normal_rad)))
        allowed = log(pixel / contrast) / (2 * pi**2 * freq**2) - least
        return 2 * sqrt(max(allowed, 0.0)) / self.blur_px_per_mm

    def contrast_across(self, variance_px2: float, normal_rad: float, freq: float) -> float:
        """Contrast across an edge behind this variance and the pixel."""
        pixel = float(np.sinc(freq * cos(normal_rad)) * np.sinc(freq * sin(normal_rad)))
        return pixel * exp(-2 * pi**2 * freq**2 * variance_px2)


def squares(lens: FocusedLens, columns: int, rows: int) -> list[tuple[float, float]]:
    """Middles of the squares of a chart, evenly over the picture."""
    x = (np.arange(columns) + 0.5) * lens.width_px / columns
    y = (np.arange(rows) + 0.5) * lens.height_px / rows
    return [(float(one), float(other)) for other in y for one in x]


def chart(
    lens: FocusedLens,
    middles_px: list[tuple[float, float]],
    half_px: float,
    turn_deg: float,
    position_mm: float,
    growth: float = 1.0,
) -> FloatArray:
    """Photograph of dark squares on a bright ground without noise, shape (rows, cols), in DN.

    The picture is ``growth`` times as large about its centre, as when a lens breathes.
    """
    low, high = LEVELS_DN
    image = np.full((lens.height_px, lens.width_px), high)
    centre_x, centre_y = (lens.width_px - 1) / 2, (lens.height_px - 1) / 2
    turn = np.deg2rad(turn_deg)
    half = half_px * growth
    for middle_x, middle_y in middles_px:
        x_px = centre_x + growth * (middle_x - centre_x)
        y_px = centre_y + growth * (middle_y - centre_y)
        reach = half * (abs(cos(turn)) + abs(sin(turn))) + _MARGIN_PX
        left, right = max(int(x_px - reach), 0), min(int(x_px + reach) + 2, lens.width_px)
        top, bottom = max(int(y_px - reach), 0), min(int(y_px + reach) + 2, lens.height_px)
        y, x = np.mgrid[top:bottom, left:right].astype(np.float64)
        width = [lens.sigma_across(x, y, turn + side, position_mm) for side in (0.0, pi / 2)]
        light = np.zeros_like(x)
        for dx, wx in zip(_NODES / 2, _WEIGHTS / 2, strict=True):
            for dy, wy in zip(_NODES / 2, _WEIGHTS / 2, strict=True):
                away_x, away_y = x + dx - x_px, y + dy - y_px
                along = cos(turn) * away_x + sin(turn) * away_y
                across = cos(turn) * away_y - sin(turn) * away_x
                share = np.ones_like(x)
                for place, sigma in ((along, width[0]), (across, width[1])):
                    share *= ndtr((place + half) / sigma) - ndtr((place - half) / sigma)
                light += wx * wy * share
        image[top:bottom, left:right] += (low - high) * light
    return image
