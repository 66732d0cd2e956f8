"""Model of a camera above a plane, and the height series that it takes of it.

Model of a camera above a plane: lens distortion, tilt, distance, rotation and position. Pixels
``(x, y)`` become *slopes*: the offset of the plane point from the foot of the perpendicular through
the entrance pupil, in units of the pupil's distance from the plane. In slopes, captures of a plane
differ only by a scale, a rotation and a shift.
"""

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from math import hypot, sqrt
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from simulation.arrays import FloatArray
from simulation.pose import ideal_factors, seen_factors

LENS_SIZE = 4
"""Parameters of the lens: k1, k2 and the two offsets of the principal point."""

SHARED_SIZE = LENS_SIZE + 2
"""Parameters that all captures of one series share: the lens and two tilts."""

_LEAST_STEEPNESS = 0.1
"""Keeps derivatives finite at the fold of a strong barrel distortion; no real lens reaches it."""

_TILT_STEP = 1e-5


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaneLens:
    """Lens and inclination: what stays the same when the stage moves.

    Parameters
    ----------
    width_px, height_px
        Size of the image.
    focal_length_px
        Focal length. If it is wrong, tilts come out wrong by the same factor.
    k1, k2
        Radial distortion: an ideal point at radius r from the principal point, 1 at the image
        corner, appears at ``r (1 + k1 r^2 + k2 r^4)``. Negative is barrel distortion.
    principal_x_px, principal_y_px
        Offset of the principal point from the centre of the image.
    tilt_x_rad, tilt_y_rad
        Inclination that makes the optical axis meet the plane further along the image's +x, +y.
    """

    width_px: int
    height_px: int
    focal_length_px: float
    k1: float = 0.0
    k2: float = 0.0
    principal_x_px: float = 0.0
    principal_y_px: float = 0.0
    tilt_x_rad: float = 0.0
    tilt_y_rad: float = 0.0

    @property
    def principal_px(self) -> FloatArray:
        """Principal point (x, y) in the image."""
        return np.array(
            [
                (self.width_px - 1) / 2 + self.principal_x_px,
                (self.height_px - 1) / 2 + self.principal_y_px,
            ]
        )

    @property
    def corner_radius_px(self) -> float:
        """Distance of the corner pixels' centres from the centre of the image."""
        return hypot(self.width_px - 1, self.height_px - 1) / 2

    @property
    def parameters(self) -> FloatArray:
        """Shape (6,): k1, k2, principal x and y in px, tilts x and y in rad."""
        return np.array(
            [
                self.k1,
                self.k2,
                self.principal_x_px,
                self.principal_y_px,
                self.tilt_x_rad,
                self.tilt_y_rad,
            ]
        )

    def with_parameters(self, values: FloatArray) -> Self:
        """Return the same camera with other ``parameters``."""
        k1, k2, x_px, y_px, tilt_x, tilt_y = (float(value) for value in values)
        return replace(
            self,
            k1=k1,
            k2=k2,
            principal_x_px=x_px,
            principal_y_px=y_px,
            tilt_x_rad=tilt_x,
            tilt_y_rad=tilt_y,
        )

    def slopes(self, points_px: FloatArray) -> FloatArray:
        """Slopes of observed pixels, shape (n, 2)."""
        seen = (points_px - self.principal_px) / self.corner_radius_px
        plane = self._rays(seen) @ self._inclination().T
        return np.asarray(plane[:, :2] / plane[:, 2:])

    def pixels(self, slopes: FloatArray) -> FloatArray:
        """Pixels at which slopes are seen, shape (n, 2)."""
        ray = np.column_stack([slopes, np.ones(len(slopes))]) @ self._inclination()
        ideal = ray[:, :2] / ray[:, 2:] * (self.focal_length_px / self.corner_radius_px)
        # The whole frame is within this radius of the principal point.
        frame = 1 + hypot(self.principal_x_px, self.principal_y_px) / self.corner_radius_px
        factors = seen_factors(self.k1, self.k2, np.sum(ideal**2, axis=1), frame)
        return np.asarray(self.principal_px + self.corner_radius_px * ideal * factors[:, None])

    def slope_changes(self, points_px: FloatArray) -> FloatArray:
        """Derivatives of ``slopes`` by ``parameters``, shape (n, 2, 6)."""
        seen = (points_px - self.principal_px) / self.corner_radius_px
        ray = self._rays(seen)
        radius = np.hypot(seen[:, 0], seen[:, 1])
        square = np.sum(ray[:, :2] ** 2, axis=1)
        factor = ideal_factors(self.k1, self.k2, radius**2)
        steepness = np.maximum(1 + square * (3 * self.k1 + 5 * square * self.k2), _LEAST_STEEPNESS)
        turn = self._inclination()
        plane = ray @ turn.T
        slopes = plane[:, :2] / plane[:, 2:]
        # Derivatives by the ideal point, shape (n, 2, 2).
        by_point = (turn[:2, :2] - slopes[:, :, None] * turn[2, :2]) / plane[:, 2, None, None]
        outwards = np.divide(seen, radius[:, None], out=np.zeros_like(seen), where=seen != 0)
        stretch = np.eye(2) * factor[:, None, None] + (1 / steepness - factor)[:, None, None] * (
            outwards[:, :, None] * outwards[:, None, :]
        )
        by_lens = np.empty((len(points_px), 2, LENS_SIZE))
        by_lens[:, :, 0] = -ray[:, :2] * (square / steepness)[:, None]
        by_lens[:, :, 1] = -ray[:, :2] * (square**2 / steepness)[:, None]
        by_lens[:, :, 2:] = -stretch / self.corner_radius_px
        changes = np.empty((len(points_px), 2, SHARED_SIZE))
        changes[:, :, :LENS_SIZE] = by_point @ by_lens
        for number, (x, y) in enumerate(((_TILT_STEP, 0.0), (0.0, _TILT_STEP))):
            above, below = (
                replace(
                    self,
                    tilt_x_rad=self.tilt_x_rad + sign * x,
                    tilt_y_rad=self.tilt_y_rad + sign * y,
                )._inclination()
                for sign in (1, -1)
            )
            moved = ray @ (above - below).T / (2 * _TILT_STEP)
            changes[:, :, LENS_SIZE + number] = (moved[:, :2] - slopes * moved[:, 2:]) / plane[
                :, 2:
            ]
        return changes

    def _rays(self, seen: FloatArray) -> FloatArray:
        """Directions of observed points, shape (n, 3), with the corner's radius as unit length."""
        factors = ideal_factors(self.k1, self.k2, np.sum(seen**2, axis=1))
        depth = np.full(len(seen), self.focal_length_px / self.corner_radius_px)
        return np.column_stack([seen * factors[:, None], depth])

    def _inclination(self) -> FloatArray:
        """Rotation from camera axes to plane axes (Rodrigues' formula), shape (3, 3)."""
        x, y = self.tilt_x_rad, self.tilt_y_rad
        angle = sqrt(x * x + y * y)
        cross = np.array([[0.0, 0.0, x], [0.0, 0.0, y], [-x, -y, 0.0]])
        half = np.sinc(angle / 2 / np.pi)
        return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * cross + half**2 / 2 * cross @ cross)


@dataclass(frozen=True, slots=True, kw_only=True)
class CapturePose:
    """Pose of one capture: a plane point is ``place + exp(log_distance) turn(slope)``.

    Lengths are in mm, or in units of the first capture's distance if no size is known. The
    rotation is from +x towards +y.
    """

    log_distance: float = 0.0
    turn_rad: float = 0.0
    x: float = 0.0
    y: float = 0.0

    @classmethod
    def of(cls, parameters: FloatArray) -> Self:
        """Pose with these ``parameters``."""
        log_distance, turn_rad, x, y = parameters.tolist()
        return cls(log_distance=log_distance, turn_rad=turn_rad, x=x, y=y)

    @property
    def parameters(self) -> FloatArray:
        """Shape (4,): log distance, rotation, x and y."""
        return np.array([self.log_distance, self.turn_rad, self.x, self.y])

    @property
    def distance(self) -> float:
        """Distance of the entrance pupil from the plane."""
        return float(np.exp(self.log_distance))

    @property
    def place(self) -> FloatArray:
        """Foot of the perpendicular through the entrance pupil, (x, y)."""
        return np.array([self.x, self.y])

    @property
    def turn(self) -> FloatArray:
        """Rotation by ``turn_rad``, shape (2, 2)."""
        c, s = np.cos(self.turn_rad), np.sin(self.turn_rad)
        return np.array([[c, -s], [s, c]])

    def plane(self, slopes: FloatArray) -> FloatArray:
        """Plane points of slopes, shape (n, 2)."""
        return np.asarray(self.place + self.distance * slopes @ self.turn.T)

    def slopes(self, plane: FloatArray) -> FloatArray:
        """Slopes of plane points, shape (n, 2)."""
        return np.asarray((plane - self.place) @ self.turn / self.distance)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GeometryCapture:
    """One capture of a board or of a textured target.

    ``image`` is grey and linear, shape ``(rows, cols)``; ``height_mm`` was read back. Captures of
    one kind, target and orientation show the same target, which was not touched in between.
    """

    name: str
    kind: str
    target: str
    orientation_deg: float
    height_mm: float
    image: NDArray[np.floating[Any]] = field(repr=False)
    index: int | None = None

    @property
    def placement(self) -> tuple[str, str, float]:
        """What the captures of one series have in common."""
        return self.kind, self.target, self.orientation_deg


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Exclusion:
    """A capture that is not used, and why."""

    capture: GeometryCapture
    reason: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PosedCapture:
    """A capture, its pose, and how well its accepted matches fit."""

    capture: GeometryCapture
    pose: CapturePose
    match_count: int = 0
    rms_px: float = 0.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Series:
    """The captures of one placement of a target, and the lens, inclined as it is to this target.

    Lengths are in mm where the target has a known size; if not, in units of the first capture's
    distance, and that capture's pose is fixed.
    """

    lens: PlaneLens
    captures: tuple[PosedCapture, ...]
    is_in_mm: bool

    @property
    def target(self) -> str:
        """Name of the target."""
        return self.captures[0].capture.target

    @property
    def heights_mm(self) -> tuple[float, ...]:
        """Height of each capture."""
        return tuple(one.capture.height_mm for one in self.captures)

    @property
    def nearest_distance(self) -> float:
        """Distance of the nearest capture."""
        return min(one.pose.distance for one in self.captures)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlaneMatches:
    """Pixels of one capture that show the same plane points as those of another, or of a board.

    Pixels and points are x and y, shape (n, 2); ``other`` is None where the points are known ones
    of a plane, in mm. The covariance is that of the disagreement in pixels of ``capture``, shape
    (n, 2, 2), up to a factor.
    """

    capture: GeometryCapture
    seen_px: FloatArray = field(repr=False)
    other: GeometryCapture | None
    other_points: FloatArray = field(repr=False)
    covariance_px2: FloatArray = field(repr=False)

    def is_between(self, captures: Collection[GeometryCapture]) -> bool:
        """Whether the matches need no captures other than these."""
        return self.capture in captures and (self.other is None or self.other in captures)
