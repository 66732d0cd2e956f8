"""Where the two cameras stood: from the plane between two photographs, and the epipole.

Let the reference's camera stand at C in the follow-up's, whose distance from the plane is 1 and
whose normal to it is n; the reference's distance is then 1 - n C. Of a camera matrix K the plane's
homography is K R (1 - C n^T) K^-1, and a point at the height h above the plane and the depth Z is
displaced by ``-h / (Z (1 - n C)) K C``, towards the epipole K C or away from it (R. Hartley, A.
Zisserman, "Multiple View Geometry in Computer Vision", 2nd edition, section 13.3).
"""

from dataclasses import dataclass, field
from math import hypot
from typing import Self

import numpy as np

from simulation.arrays import FloatArray
from simulation.by_value import ByValue

_TRIED_FOCAL = np.geomspace(0.6, 9.0, 16).tolist()
"""Focal lengths, relative to a frame's longer side: from a fisheye to a strong telephoto."""

_SURE_NORMAL_ERR, _MOST_NORMAL_ERR = 0.1, 0.25
"""Contradictions of plane and epipole: of the best lens at most, and of one that counts."""

_PLANE_ERR_PX = 0.05
"""By which a plane is off, of rendered scenes: plates tell of their ground, too."""

_LEAST_OFFSET = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameCamera:
    """An ideal camera: focal length and principal point ``(x, y)`` in px of its frame."""

    focal_length_px: float
    principal_px: tuple[float, float]

    @property
    def matrix(self) -> FloatArray:
        """From directions to homogeneous pixels, shape (3, 3)."""
        (x, y), focal = self.principal_px, self.focal_length_px
        return np.array([[focal, 0.0, x], [0.0, focal, y], [0.0, 0.0, 1.0]])

    def rays(self, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        """Directions of pixels, 1 along the axis, shape (3, ...)."""
        (x, y), focal = self.principal_px, self.focal_length_px
        return np.stack([(x_px - x) / focal, (y_px - y) / focal, np.ones(np.shape(x_px))])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SeenParallax(ByValue):
    """Parallax of pixels towards an epipole, homogeneous ``(x, y, w)``.

    ``x_px, y_px``: ideal places of the pixels; ``parallax_px, error_px``: towards the epipole, and
    its standard error, all of one shape.
    """

    epipole: FloatArray
    x_px: FloatArray = field(repr=False)
    y_px: FloatArray = field(repr=False)
    parallax_px: FloatArray = field(repr=False)
    error_px: FloatArray = field(repr=False)

    @property
    def relative_depths(self) -> FloatArray:
        """How much of the epipole displaces each pixel so far."""
        return np.asarray(self.parallax_px / (self._reach - self.parallax_px * self.epipole[2]))

    @property
    def relative_depth_errs(self) -> FloatArray:
        """Their standard errors."""
        rest = self._reach - self.parallax_px * self.epipole[2]
        return np.asarray(self._reach / rest**2 * self.error_px)

    @property
    def _reach(self) -> FloatArray:
        """Length of the vector from a pixel to the epipole, whose scale is the epipole's."""
        x, y, w = self.epipole.tolist()
        return np.asarray(np.maximum(np.hypot(x - w * self.x_px, y - w * self.y_px), 1e-12))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Heights(ByValue):
    """Heights above a plane, towards the cameras, and their standard errors."""

    height: FloatArray
    error: FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Viewpoint(ByValue):
    """Where the reference's camera stood in the follow-up's: x right, y down, z forward.

    ``centre``: shape (3,), in distances of the follow-up's camera from the plane. ``normal``: of
    the plane, away from the cameras, shape (3,), of length 1. ``normal_err``: by how much plane
    and epipole contradict one another, as an angle of the normal. ``camera``: of both photographs.
    """

    centre: FloatArray = field(repr=False)
    normal: FloatArray = field(repr=False)
    normal_err: float
    camera: FrameCamera

    @classmethod
    def of(cls, matrix: FloatArray, epipole: FloatArray, camera: FrameCamera) -> Self | None:
        """Find it; None for a camera that only turned.

        ``matrix``: of the plane, from follow-up to reference pixels. ``epipole``: homogeneous, in
        the follow-up.
        """
        own = np.linalg.inv(camera.matrix)
        turned = own @ matrix @ camera.matrix
        # What is at right angles to both normal and baseline is only turned.
        turned = turned / np.linalg.svd(turned)[1][1]
        along = own @ epipole
        along = along / np.linalg.norm(along)
        square = turned.T @ turned
        ratio = float(np.sqrt(along @ square @ along))
        offset = along - square @ along / ratio
        length = float(np.linalg.norm(offset))
        if length < _LEAST_OFFSET:
            return None
        if offset[2] < 0:
            # A plane that is seen lies in front.
            along, offset = -along, -offset
        made = np.eye(3) - np.outer(along, offset)
        misfit = float(np.linalg.norm(square - made.T @ made))
        return cls(
            centre=along * length,
            normal=offset / length,
            # Two terms of the square are the offset's.
            normal_err=misfit / (np.sqrt(2.0) * length),
            camera=camera,
        )

    @property
    def tilt_err(self) -> float:
        """Standard error of the normal, and of the baseline relative to itself.

        A plane is known to a share of a pixel, of what its tilt displaces the middle of a side by.
        """
        half_px = max(self.camera.principal_px)
        shown_px = float(np.linalg.norm(self.centre)) * half_px**2 / self.camera.focal_length_px
        return hypot(self.normal_err, _PLANE_ERR_PX / shown_px)

    @property
    def distance_ratio(self) -> float:
        """Distance of the reference's camera from the plane, over the follow-up's."""
        return float(1 - self.normal @ self.centre)

    def sees_plane_at(self, x_px: FloatArray, y_px: FloatArray) -> bool:
        """Whether the plane lies in front of the follow-up's camera at all of these pixels."""
        return bool((self._facing(x_px, y_px) > 0).all())

    def depth_of_plane(self, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        """Depth of the plane along the optical axis at pixels, over its distance."""
        return np.asarray(1 / self._facing(x_px, y_px))

    def nearer_sign(self, epipole: FloatArray) -> int:
        """Sign of the parallax of what is nearer than the plane: 1, or -1."""
        return -1 if float(epipole @ self.camera.matrix @ self.centre) > 0 else 1

    def heights(self, seen: SeenParallax) -> Heights:
        """Heights above the plane, in distances of the follow-up's camera from it.

        The error is that of the parallax, the plane's tilt and the baseline; that of the distance
        scales all heights.
        """
        baseline = self.camera.matrix @ self.centre
        scale = float(seen.epipole @ baseline) / float(baseline @ baseline)
        rise = -scale * self.distance_ratio / self._facing(seen.x_px, seen.y_px)
        # h / (1 - h), for its depth is less than the plane's.
        lifted = rise * seen.relative_depths
        height = lifted / (1 + lifted)
        by_parallax = rise / (1 + lifted) ** 2 * seen.relative_depth_errs
        rays = self.camera.rays(seen.x_px, seen.y_px)
        by_plane = self.tilt_err * np.sqrt(height**2 + rays[0] ** 2 + rays[1] ** 2)
        return Heights(height=height, error=np.asarray(np.hypot(by_parallax, by_plane)))

    def _facing(self, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        """The plane's distance over its depth at pixels; above 0 in front of the camera."""
        return np.asarray(np.tensordot(self.normal, self.camera.rays(x_px, y_px), 1))


def likely_viewpoint(
    matrix: FloatArray, epipole: FloatArray, shape: tuple[int, int]
) -> Viewpoint | None:
    """Where the reference's camera stood, in a direction that is right but for the lens; or None.

    Which of two opposite sides it is follows from how the plane is foreshortened, which a focal
    length scales: the side counts if it is the same for every lens by which plane and epipole agree
    in some measure. None also where one of the photographs is a mirror image.
    ``shape``: ``(rows, cols)`` of both photographs, whose middle is taken as the principal point.
    """
    if np.linalg.det(matrix) <= 0:
        return None
    rows, cols = shape
    found: list[Viewpoint] = []
    for relative in _TRIED_FOCAL:
        camera = FrameCamera(
            focal_length_px=relative * max(shape),
            principal_px=((cols - 1) / 2, (rows - 1) / 2),
        )
        one = Viewpoint.of(matrix, epipole, camera)
        if one is not None and one.normal_err < _MOST_NORMAL_ERR:
            found.append(one)
    sides = {one.nearer_sign(epipole) for one in found}
    best = min(found, key=lambda one: one.normal_err, default=None)
    if best is None or best.normal_err > _SURE_NORMAL_ERR or len(sides) > 1:
        return None
    return best
