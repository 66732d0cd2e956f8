"""Poses of a camera whose lens distorts: where a follow-up looks, and a blend over its frame.

Shares nothing with ``simulation``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import cos, hypot, pi, radians, sin

import numpy as np

from benchmarks.ideal_lmmse import Ideal
from benchmarks.lens_optics import Camera, Transfer, elsewhere
from benchmarks.lens_scenes import Scene
from simulation.arrays import FloatArray

FOCAL_PX_PER_WIDTH = 1.24
"""Of the bench's camera at a focal length of 8 mm."""

_NODES = 5
"""Chebyshev nodes per axis, at which the local transfer function is exact: a test has the error."""

_DIFFERENCE_PX = 1e-3
_DISTORTION_STEPS = 30


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """A camera that looks at the middle of a plane from another distance and direction.

    ``zoom`` is the ratio of the distances; the camera is tilted towards the bearing and turned
    about its axis, both in degrees. ``distortion_k1`` is the relative radial distortion at the
    corner of the reference, whose frame is square; negative is barrel.
    """

    zoom: float
    tilt_deg: float = 0.0
    bearing_deg: float = 0.0
    turn_deg: float = 0.0
    distortion_k1: float = 0.0
    reference_side: int
    followup_side: int

    @property
    def name(self) -> str:
        """As tables write it."""
        extra = f", turn {self.turn_deg:g}" if self.turn_deg else ""
        extra += f", k1 {self.distortion_k1:g}" if self.distortion_k1 else ""
        return f"zoom {self.zoom:g}, tilt {self.tilt_deg:g} at {self.bearing_deg:g}{extra}"

    @property
    def homography(self) -> FloatArray:
        """Follow-up pixel (x, y, 1) to reference pixel, both without distortion, shape (3, 3)."""
        tilt, bearing = radians(self.tilt_deg), radians(self.bearing_deg)
        towards = _about_axis(bearing)
        lean = np.array([[cos(tilt), 0, sin(tilt)], [0, 1, 0], [-sin(tilt), 0, cos(tilt)]])
        rotation = towards @ lean @ towards.T @ _about_axis(radians(self.turn_deg))
        # A ray of the follow-up, from a camera at zoom times the unit distance of the plane.
        pupil = np.array([0.0, 0.0, 1.0]) - self.zoom * rotation[:, 2]
        rays = (1 - pupil[2]) * rotation + np.outer(pupil, rotation[2])
        rays[2] = rotation[2]
        focal = FOCAL_PX_PER_WIDTH * self.reference_side
        seen, shown = (self.reference_side - 1) / 2, (self.followup_side - 1) / 2
        to_reference = np.array([[focal, 0, seen], [0, focal, seen], [0, 0, 1]])
        to_followup = np.array([[focal, 0, shown], [0, focal, shown], [0, 0, 1]])
        return np.asarray(to_reference @ rays @ np.linalg.inv(to_followup))

    def positions(self, x_px: FloatArray, y_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Reference positions (x, y) of follow-up positions."""
        seen, shown = (self.reference_side - 1) / 2, (self.followup_side - 1) / 2
        k1 = self.distortion_k1 / hypot(seen, seen) ** 2
        x, y = x_px - shown, y_px - shown
        ideal_x, ideal_y = x, y
        for _ in range(_DISTORTION_STEPS):  # a contraction by some 3 k1
            factor = 1 + k1 * (ideal_x * ideal_x + ideal_y * ideal_y)
            ideal_x, ideal_y = x / factor, y / factor
        far = np.stack([ideal_x + shown, ideal_y + shown, np.ones_like(ideal_x)], axis=-1)
        u, v, w = np.moveaxis(far @ self.homography.T, -1, 0)
        u, v = u / w - seen, v / w - seen
        factor = 1 + k1 * (u * u + v * v)
        return u * factor + seen, v * factor + seen

    def jacobian(self, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        """Derivative of the reference position, shape (..., 2, 2), order (x, y)."""
        h = _DIFFERENCE_PX
        along_x = np.subtract(self.positions(x_px + h, y_px), self.positions(x_px - h, y_px))
        along_y = np.subtract(self.positions(x_px, y_px + h), self.positions(x_px, y_px - h))
        columns = np.stack([along_x, along_y], axis=-1) / (2 * h)
        return np.moveaxis(columns, 0, -2)

    @property
    def pixels(self) -> tuple[FloatArray, FloatArray]:
        """Follow-up pixels x and y, shape ``(side, side)`` each."""
        y, x = np.mgrid[: self.followup_side, : self.followup_side].astype(np.float64)
        return x, y

    def judged(self, margin_px: float) -> np.ndarray:
        """Pixels that look at the reference's middle and are the coarser ones in all directions."""
        x, y = self.positions(*self.pixels)
        last = self.reference_side - 1 - margin_px
        inside = (x >= margin_px) & (x <= last) & (y >= margin_px) & (y <= last)
        return inside & (np.linalg.svd(self.jacobian(*self.pixels))[1][..., 1] >= 1)


def pose_photograph(scene: Scene, camera: Camera, pose: Pose) -> FloatArray:
    """Photograph of a scene from a pose, shape ``(side, side)``.

    The follow-up's PSF is that of the camera in its own pixels, everywhere in its frame.
    """
    return _blended(pose, camera, scene.seen)


def ideal_pose(ideal: Ideal, camera: Camera, reference: FloatArray, pose: Pose) -> FloatArray:
    """Best linear estimate of that photograph from the reference."""
    return _blended(pose, camera, partial(ideal.seen, reference))


def _blended(
    pose: Pose, camera: Camera, seen: Callable[[Transfer, FloatArray, FloatArray], FloatArray]
) -> FloatArray:
    """Interpolate, over the frame, images that are each right for one node's derivative."""
    half = pose.followup_side / 2
    nodes = (pose.followup_side - 1) / 2 + half * np.cos(pi * (np.arange(_NODES) + 0.5) / _NODES)
    pixels = np.arange(pose.followup_side, dtype=np.float64)
    weights = _lagrange(nodes, pixels)
    x, y = pose.positions(*pose.pixels)
    total = np.zeros_like(x)
    for row, node_y in enumerate(nodes):
        for col, node_x in enumerate(nodes):
            far = elsewhere(camera, pose.jacobian(np.array(node_x), np.array(node_y)))
            total += np.outer(weights[row], weights[col]) * seen(far, x, y)
    return total


def _lagrange(nodes: FloatArray, at: FloatArray) -> FloatArray:
    """Lagrange's polynomials of the nodes, shape ``(len(nodes), len(at))``."""
    made = np.ones((len(nodes), len(at)))
    for index, node in enumerate(nodes):
        for other in np.delete(nodes, index):
            made[index] *= (at - other) / (node - other)
    return made


def _about_axis(angle_rad: float) -> FloatArray:
    c, s = cos(angle_rad), sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
