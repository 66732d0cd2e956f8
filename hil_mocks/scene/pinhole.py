"""Projection of plane points to the sensor: pinhole, pose and radial distortion."""

from dataclasses import dataclass
from functools import cached_property
from math import atan2, cos, hypot, radians, sin

import numpy as np
from numpy.typing import NDArray

Coordinates = NDArray[np.float64]

MIN_K1 = -0.14
"""The image folds over at a distorted radius of 2 / sqrt(27 |k1|), which must be off-frame."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPose:
    """Position of the camera above the plane, and its rotation.

    Parameters
    ----------
    height_mm
        Height on the stage's scale.
    offset_x_mm, offset_y_mm
        Lateral position of the entrance pupil, in plane coordinates.
    roll_deg
        Rotation about the optical axis, from +x towards +y.
    tilt_x_deg, tilt_y_deg
        Inclination that makes the axis meet the plane further along +x, or along +y. With
        ``(tilt_x, tilt_y) = t (cos b, sin b)`` the axis leans by the angle t in the direction b.
    """

    height_mm: float
    offset_x_mm: float = 0.0
    offset_y_mm: float = 0.0
    roll_deg: float = 0.0
    tilt_x_deg: float = 0.0
    tilt_y_deg: float = 0.0

    @property
    def tilt_deg(self) -> float:
        """Angle between the optical axis and the plane's normal."""
        return hypot(self.tilt_x_deg, self.tilt_y_deg)

    def rotation(self) -> NDArray[np.float64]:
        """Camera axes (x, y, forward) as columns in plane axes (x, y, down), shape (3, 3)."""
        lean, bearing = radians(self.tilt_deg), atan2(self.tilt_y_deg, self.tilt_x_deg)
        roll = radians(self.roll_deg)
        about = _turn(bearing)
        inclined = np.array(
            [[cos(lean), 0.0, sin(lean)], [0.0, 1.0, 0.0], [-sin(lean), 0.0, cos(lean)]]
        )
        return np.asarray(about @ inclined @ about.T @ _turn(roll))


def _turn(angle_rad: float) -> NDArray[np.float64]:
    c, s = cos(angle_rad), sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class PinholeCamera:
    """Sensor, focal length and distortion: the geometry that stays when the stage moves.

    The principal point is the middle of the image, ``((width - 1) / 2, (height - 1) / 2)``.
    An ideal point at a radius ``r`` from it, in units of the corner's radius, is seen at
    ``r (1 + k1 r^2)``: positive ``k1`` is pincushion, negative barrel, as in OpenCV.

    Raises
    ------
    ValueError
        If ``k1`` is so negative that the image folds over near its corners.
    """

    width_px: int
    height_px: int
    focal_length_mm: float
    pixel_pitch_um: float
    pupil_offset_mm: float = 0.0
    k1: float = 0.0

    def __post_init__(self) -> None:
        if not self.k1 > MIN_K1:
            raise ValueError(f"k1 must be above {MIN_K1}, got {self.k1}")

    @cached_property
    def centre_px(self) -> NDArray[np.float64]:
        """Principal point (x, y)."""
        return np.array([(self.width_px - 1) / 2, (self.height_px - 1) / 2])

    @cached_property
    def corner_radius_px(self) -> float:
        """Distance of the corner pixels' centres from the principal point."""
        return float(np.hypot(*self.centre_px))

    @property
    def focal_length_px(self) -> float:
        """Focal length in pixels."""
        return self.focal_length_mm / (self.pixel_pitch_um * 1e-3)

    def distance_mm(self, height_mm: float) -> float:
        """Distance from the entrance pupil to the plane.

        Raises
        ------
        ValueError
            If the pupil is not above the plane.
        """
        distance_mm = height_mm + self.pupil_offset_mm
        if not distance_mm > 0:
            raise ValueError(f"the entrance pupil must be above the plane, got {distance_mm} mm")
        return distance_mm

    def scale_px_per_mm(self, height_mm: float) -> float:
        """Pixels per millimetre on the plane, for an upright camera at the image centre."""
        return self.focal_length_px / self.distance_mm(height_mm)

    def homography_to_px(self, pose: CameraPose) -> NDArray[np.float64]:
        """Matrix from plane points (x_mm, y_mm, 1) to ideal pixels, without distortion."""
        intrinsic = np.array(
            [
                [self.focal_length_px, 0.0, self.centre_px[0]],
                [0.0, self.focal_length_px, self.centre_px[1]],
                [0.0, 0.0, 1.0],
            ]
        )
        pupil = [pose.offset_x_mm, pose.offset_y_mm, -self.distance_mm(pose.height_mm)]
        to_camera = pose.rotation().T
        matrix = intrinsic @ np.column_stack(
            [to_camera[:, 0], to_camera[:, 1], -to_camera @ np.array(pupil)]
        )
        return np.asarray(matrix / matrix[2, 2])

    def relative_radius(self, x_px: Coordinates, y_px: Coordinates) -> NDArray[np.float64]:
        """Distance from the principal point, 1 at the image corner."""
        radius_px = np.hypot(x_px - self.centre_px[0], y_px - self.centre_px[1])
        return np.asarray(radius_px / self.corner_radius_px)

    def to_plane_mm(
        self, x_px: Coordinates, y_px: Coordinates, pose: CameraPose
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Plane coordinates (x_mm, y_mm) that are seen at the pixel coordinates."""
        if self.k1:
            x_px, y_px = self._scaled(x_px, y_px, inverse=True)
        h = np.linalg.inv(self.homography_to_px(pose))
        weight = h[2, 0] * x_px + h[2, 1] * y_px + h[2, 2] if pose.tilt_deg else h[2, 2]
        x_mm = (h[0, 0] * x_px + h[0, 1] * y_px + h[0, 2]) / weight
        y_mm = (h[1, 0] * x_px + h[1, 1] * y_px + h[1, 2]) / weight
        return x_mm, y_mm

    def to_pixel(
        self, x_mm: Coordinates, y_mm: Coordinates, pose: CameraPose
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pixel coordinates (x_px, y_px) at which the plane points are seen."""
        h = self.homography_to_px(pose)
        weight = h[2, 0] * x_mm + h[2, 1] * y_mm + h[2, 2]
        x_px = (h[0, 0] * x_mm + h[0, 1] * y_mm + h[0, 2]) / weight
        y_px = (h[1, 0] * x_mm + h[1, 1] * y_mm + h[1, 2]) / weight
        return self._scaled(x_px, y_px, inverse=False) if self.k1 else (x_px, y_px)

    def _scaled(
        self, x_px: Coordinates, y_px: Coordinates, *, inverse: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        dx, dy = x_px - self.centre_px[0], y_px - self.centre_px[1]
        radius = np.hypot(dx, dy) / self.corner_radius_px + np.finfo(np.float64).tiny
        moved = undistort(radius, self.k1) if inverse else distort(radius, self.k1)
        factor = moved / radius
        return self.centre_px[0] + factor * dx, self.centre_px[1] + factor * dy


def distort(radius: Coordinates, k1: float) -> NDArray[np.float64]:
    """Radius seen for an ideal radius: ``r (1 + k1 r^2)``."""
    return radius * (1 + k1 * radius**2)


def undistort(radius: Coordinates, k1: float) -> NDArray[np.float64]:
    """Ideal radius for a seen one: the root of the cubic, in closed form.

    For barrel distortion a radius beyond the fold has no ideal one and takes that of the fold.

    References
    ----------
    Press et al., Numerical Recipes, 3rd ed. 2007, section 5.6 (trigonometric form); the
    hyperbolic form for one real root follows from the same triple-angle identity.
    """
    if k1 == 0:
        return np.array(radius, dtype=np.float64)
    unit = np.sqrt(3 * abs(k1))
    if k1 > 0:
        return np.asarray(2 / unit * np.sinh(np.arcsinh(1.5 * unit * radius) / 3))
    return np.asarray(2 / unit * np.sin(np.arcsin(np.minimum(1.5 * unit * radius, 1.0)) / 3))
