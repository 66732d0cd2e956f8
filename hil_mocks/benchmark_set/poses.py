"""Where the follow-up's camera stands, and what of the scene each pixel then sees."""

from dataclasses import dataclass
from math import cos, hypot, radians, sin

import numpy as np
from numpy.typing import NDArray

from hil_mocks.scene import distort, undistort

FloatArray = NDArray[np.float64]
Positions = tuple[FloatArray, FloatArray]

FOCAL_LENGTH_PER_WIDTH = 1.24
"""Focal length in pixels, over the columns of the reference's frame."""

REFERENCE_DISTANCE_MM = 300.0
"""From the reference's pupil to the plane; heights of reliefs are in mm above the plane."""

_RELIEF_STEPS = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class Bump:
    """A Gaussian elevation, its middle and width in reference px."""

    x_px: float
    y_px: float
    sigma_px: float
    height_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """The follow-up's camera beside the reference's, which looks straight at the plane.

    Parameters
    ----------
    reference_shape, followup_shape
        ``(rows, cols)`` of the frames; the optical axis is at their middles.
    zoom
        Ratio of the distances along the optical axes, follow-up over reference.
    tilt_deg, bearing_deg
        Angle between the axes, and the direction that the follow-up's leans to.
    roll_deg
        Turn about its own axis.
    shift_px
        Where its axis meets the plane, from the reference's middle, (x, y) in reference px.
    k1
        Radial distortion of both: a point at the ideal radius r is seen at r (1 + k1 r^2), in
        units of half the reference's diagonal.
    relief
        Elevations of the scene above the plane.
    """

    reference_shape: tuple[int, int]
    followup_shape: tuple[int, int]
    zoom: float = 1.0
    tilt_deg: float = 0.0
    bearing_deg: float = 0.0
    roll_deg: float = 0.0
    shift_px: tuple[float, float] = (0.0, 0.0)
    k1: float = 0.0
    relief: tuple[Bump, ...] = ()

    @property
    def focal_length_px(self) -> float:
        """Of both cameras, which are one."""
        return FOCAL_LENGTH_PER_WIDTH * self.reference_shape[1]

    @property
    def _rotation(self) -> FloatArray:
        towards, tilt = _about_axis(radians(self.bearing_deg)), radians(self.tilt_deg)
        lean = np.array([[cos(tilt), 0, sin(tilt)], [0, 1, 0], [-sin(tilt), 0, cos(tilt)]])
        return np.asarray(towards @ lean @ towards.T @ _about_axis(radians(self.roll_deg)))

    @property
    def _pupil(self) -> FloatArray:
        """Position with the plane at depth 1 before the reference's pupil, the origin."""
        middle = [shift / self.focal_length_px for shift in self.shift_px]
        return np.asarray(np.array([*middle, 1.0]) - self.zoom * self._rotation[:, 2])

    @property
    def matrix(self) -> FloatArray:
        """Ideal follow-up pixels to ideal reference pixels, through the plane, shape (3, 3)."""
        rotation, pupil = self._rotation, self._pupil
        rays = (1 - pupil[2]) * rotation + np.outer(pupil, rotation[2])
        rays[2] = rotation[2]
        made = self._lens(self.reference_shape) @ rays
        made = made @ np.linalg.inv(self._lens(self.followup_shape))
        return np.asarray(made / made[2, 2])

    def _lens(self, shape: tuple[int, int]) -> FloatArray:
        middle_x, middle_y = (shape[1] - 1) / 2, (shape[0] - 1) / 2
        focal = self.focal_length_px
        return np.array([[focal, 0, middle_x], [0, focal, middle_y], [0, 0, 1.0]])

    def on_plane(self, x_px: FloatArray, y_px: FloatArray) -> Positions:
        """Ideal reference positions of the plane's points that follow-up pixels look at."""
        x, y = self._ideal(x_px, y_px, self.followup_shape)
        h = self.matrix
        w = h[2, 0] * x + h[2, 1] * y + h[2, 2]
        u = (h[0, 0] * x + h[0, 1] * y + h[0, 2]) / w
        v = (h[1, 0] * x + h[1, 1] * y + h[1, 2]) / w
        return u, v

    def reference_points(self, x_px: FloatArray, y_px: FloatArray) -> Positions:
        """Positions in the reference, as photographed, of the plane's points."""
        u, v = self.on_plane(x_px, y_px)
        return self._scaled(u, v, self.reference_shape, is_inverse=False)

    def seen_by_reference(self, x_px: FloatArray, y_px: FloatArray) -> Positions:
        """Scene positions of reference pixels: the scene is painted as the reference sees it."""
        return self._ideal(x_px, y_px, self.reference_shape)

    def seen_by_followup(self, x_px: FloatArray, y_px: FloatArray) -> Positions:
        """Scene positions of follow-up pixels."""
        u, v = self.on_plane(x_px, y_px)
        if not self.relief:
            return u, v
        middle = self._lens(self.reference_shape)[:2, 2]
        x, y = ((at - m) / self.focal_length_px for at, m in zip((u, v), middle, strict=True))
        found_x, found_y = x, y
        for _ in range(_RELIEF_STEPS):  # a contraction by the parallax's slope
            there_x, there_y = self._through_relief(found_x, found_y, middle)
            found_x, found_y = found_x + x - there_x, found_y + y - there_y
        return (
            found_x * self.focal_length_px + middle[0],
            found_y * self.focal_length_px + middle[1],
        )

    def _through_relief(self, x: FloatArray, y: FloatArray, middle: FloatArray) -> Positions:
        """Where the follow-up's rays through the relief's points meet the plane, at depth 1."""
        height = np.zeros_like(x)
        for bump in self.relief:
            across = x * self.focal_length_px + middle[0] - bump.x_px
            down = y * self.focal_length_px + middle[1] - bump.y_px
            square = (across * across + down * down) / (2 * bump.sigma_px**2)
            height += bump.height_mm / REFERENCE_DISTANCE_MM * np.exp(-square)
        pupil = self._pupil
        depth = 1 - height
        beyond = (1 - pupil[2]) / (depth - pupil[2])
        return (
            pupil[0] + (x * depth - pupil[0]) * beyond,
            pupil[1] + (y * depth - pupil[1]) * beyond,
        )

    def _ideal(self, x_px: FloatArray, y_px: FloatArray, shape: tuple[int, int]) -> Positions:
        return self._scaled(x_px, y_px, shape, is_inverse=True) if self.k1 else (x_px, y_px)

    def _scaled(
        self, x_px: FloatArray, y_px: FloatArray, shape: tuple[int, int], *, is_inverse: bool
    ) -> Positions:
        if not self.k1:
            return x_px, y_px
        middle_x, middle_y = (shape[1] - 1) / 2, (shape[0] - 1) / 2
        unit_px = hypot(self.reference_shape[0] - 1, self.reference_shape[1] - 1) / 2
        x, y = x_px - middle_x, y_px - middle_y
        radius = np.sqrt(x * x + y * y) / unit_px + np.finfo(np.float64).tiny
        moved = undistort(radius, self.k1) if is_inverse else distort(radius, self.k1)
        factor = moved / radius
        return x * factor + middle_x, y * factor + middle_y


def _about_axis(angle_rad: float) -> FloatArray:
    c, s = cos(angle_rad), sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
