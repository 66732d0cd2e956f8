"""A scene with depth as its reference shows it, and where another camera sees its points.

With ``m . q`` the inverse depth of a plane at the reference's ray ``q = K^-1 (u, v, 1)``, the
homography G of that plane takes the pixel to the follow-up, and a point whose inverse depth is w
lies beside that by its parallax: ``x ~ G q + t (w - m . q)``, t being the reference's pupil as the
follow-up's camera sees it. So the plane is where its homography says, whatever the focal length;
that, and the plane's slope, decide t alone.

References
----------
R. Kumar, P. Anandan and K. Hanna, "Direct recovery of shape from multiple views: a parallax based
approach", ICPR 1994.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from simulation.arguments import ArgumentError, check_fields
from simulation.arrays import FloatArray
from simulation.by_value import ByValue
from simulation.pose._warp import lens_of, refuse_folding
from simulation.sampling_grid import SamplingGrid

_FITTED = 64
"""Positions along an axis to which a plane is fitted."""

_TRIES = 300
"""A plane of a third of the points is missed once in 80,000."""

_NEAR = 0.003
"""Relative distance from a plane up to which a point is on it."""

_MISFIT = 0.03
"""Largest misfit of a homography's directions to those of a camera: at a tilt of 30 degrees, of a
focal length that is 6 % wrong."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SceneDepth(ByValue):
    """Depth of a scene, as its reference shows it.

    Parameters
    ----------
    depth
        Distance along the optical axis of what each pixel shows, shape ``(rows, cols)``, in any
        unit, above 0; NaN where it is not known.
    focal_length_px
        Of the camera, whose axis meets the middle of the frame; another pose than further away
        needs it.
    plane_depth
        Depth of the plane that a homography is of, or to which a zoom is the ratio of the
        distances; that plane is parallel to the sensor. By default the plane, level or not, on
        which most of the scene lies.

    Examples
    --------
    >>> import numpy as np
    >>> steps = np.where(np.arange(320) < 160, 290.0, 260.0) * np.ones((240, 1))
    >>> scene = standoff.SceneDepth(depth=steps)
    >>> far = standoff.simulate("before.tif", zoom=1.5, depth=scene, psf="psf.json")
    >>> far.image.shape
    (160, 213)
    """

    depth: FloatArray
    focal_length_px: float | None = None
    plane_depth: float | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        depth = np.array(self.depth, dtype=np.float64)
        if depth.ndim != 2 or min(depth.shape) < 2:
            raise ArgumentError(
                f"expected the shape (rows, cols), got {depth.shape}", argument="depth"
            )
        known = np.isfinite(depth)
        if np.isinf(depth).any() or not known.any() or not np.all(depth[known] > 0):
            raise ArgumentError(
                "expected depths above 0, and NaN for unknown ones", argument="depth"
            )
        depth.setflags(write=False)
        object.__setattr__(self, "depth", depth)

    def __repr__(self) -> str:
        rows, cols = self.shape
        low, high = np.nanmin(self.depth), np.nanmax(self.depth)
        return f"SceneDepth({cols} x {rows} px, depth {low:.4g} to {high:.4g})"

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, cols = self.depth.shape
        return rows, cols

    @property
    def plane(self) -> FloatArray:
        """The plane of homographies, shape (3,): its inverse depth is ``m . q``."""
        if self.plane_depth is not None:
            return np.array([0.0, 0.0, 1 / self.plane_depth])
        rows, cols = self.shape
        y, x = np.meshgrid(
            *(np.unique(np.linspace(0, n - 1, _FITTED).astype(int)) for n in (rows, cols)),
            indexing="ij",
        )
        inverse = 1 / self.depth[y, x]
        known = np.isfinite(inverse)
        pixels = np.stack([x[known], y[known], np.ones(np.count_nonzero(known))])
        return _plane_of_most(np.linalg.inv(self.lens) @ pixels, inverse[known])

    @property
    def lens(self) -> FloatArray:
        """Rays to pixels, shape (3, 3); with a focal length of 1 px if it is not known."""
        return _lens(self.shape, self.focal_length_px or 1.0)


def _plane_of_most(rays: FloatArray, inverse: FloatArray) -> FloatArray:
    """Plane near the most of some points, by trying those through three of them."""
    rng = np.random.default_rng(0)
    kept, most = inverse > 0, -1
    for _ in range(_TRIES):
        three = rng.integers(0, len(inverse), 3)
        solved = np.linalg.lstsq(rays[:, three].T, inverse[three], rcond=1e-9)[0]
        near = np.abs(solved @ rays - inverse) < _NEAR * inverse
        if np.count_nonzero(near) > most:
            kept, most = near, int(np.count_nonzero(near))
    found = np.linalg.lstsq(rays[:, kept].T, inverse[kept], rcond=1e-9)[0]
    return np.asarray(found, dtype=np.float64)


def _lens(shape: tuple[int, int], focal_length_px: float) -> FloatArray:
    rows, cols = shape
    return np.array(
        [
            [focal_length_px, 0.0, (cols - 1) / 2],
            [0.0, focal_length_px, (rows - 1) / 2],
            [0.0, 0.0, 1.0],
        ]
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DepthView:
    """Where a follow-up sees the points of a scene.

    The reference's pixel ``(x, y)`` with the inverse depth w is at ``plane @ (x, y, 1) + pupil (w -
    base . (x, y, 1))``, homogeneous in the follow-up's pixels, whose third component is its depth
    there over that in the reference; ``base . (x, y, 1)`` is the inverse depth of the plane.
    ``lens`` is as in `simulation.pose._warp`, the follow-up's centre first; ``follow_up`` is
    ``(rows, cols)``.
    """

    plane: FloatArray
    pupil: FloatArray
    base: FloatArray
    lens: FloatArray
    reference: tuple[int, int]
    follow_up: tuple[int, int]

    @classmethod
    def further_away(cls, scene: SceneDepth, zoom: float) -> Self:
        """The camera moved straight back until the middle of the plane is ``zoom`` times as far."""
        grid = SamplingGrid.centred(scene.shape, zoom)
        plane = scene.plane
        pupil = np.array([0.0, 0.0, (zoom - 1) / plane[2]])
        seen = np.eye(3) + np.outer(pupil, plane)
        return cls._of(scene, (seen, plane, pupil), (grid.cols, grid.rows))

    @classmethod
    def of_homography(
        cls,
        scene: SceneDepth,
        homography: FloatArray,
        size: tuple[int, int],
        distortion_k1: float = 0.0,
    ) -> Self:
        """The camera of a homography, follow-up to reference, of the scene's plane.

        ``size`` is ``(width, height)``. A ValueError if no camera of this focal length has it.
        """
        focal, (width, height) = scene.focal_length_px, size
        if focal is None:
            raise ArgumentError("a homography needs it", argument="focal_length_px")
        far = _lens((height, width), focal)
        seen = np.linalg.inv(far) @ np.linalg.inv(homography) @ scene.lens
        seen *= np.sign(seen[2, 2]) / np.linalg.svd(seen)[1][1]
        plane = scene.plane
        rotation, pupil = _camera_of(seen, plane)
        if np.linalg.norm(rotation + np.outer(pupil, plane) - seen, 2) > _MISFIT:
            raise ValueError(
                f"no camera with a focal length of {focal:g} px sees the plane of the depth map "
                "so; check --focal-length-px, and that the homography is that of this plane"
            )
        return cls._of(scene, (seen, plane, pupil), size, distortion_k1)

    @classmethod
    def _of(
        cls,
        scene: SceneDepth,
        by_rays: tuple[FloatArray, FloatArray, FloatArray],
        size: tuple[int, int],
        distortion_k1: float = 0.0,
    ) -> Self:
        """View by rays: the homography of the plane, the plane, and the reference's pupil."""
        (seen, plane, pupil), (width, height) = by_rays, size
        shape = height, width
        far, to_rays = _lens(shape, scene.focal_length_px or 1.0), np.linalg.inv(scene.lens)
        lens = lens_of(distortion_k1, scene.shape, shape)
        refuse_folding(distortion_k1, lens, shape)
        return cls(
            plane=far @ seen @ to_rays,
            pupil=far @ pupil,
            base=plane @ to_rays,
            lens=lens,
            reference=scene.shape,
            follow_up=shape,
        )


def _camera_of(seen: FloatArray, plane: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation R, and t, of ``R + t m^T``: on directions within the plane that is R alone."""
    distance = float(np.linalg.norm(plane))
    normal = plane / distance
    within = np.linalg.svd(normal[None])[2][1:]
    left, _, right = np.linalg.svd(
        np.concatenate([(seen @ within.T), np.cross(*(seen @ within.T).T)[:, None]], axis=1)
        @ np.concatenate([within, np.cross(*within)[None]])
    )
    rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return rotation, (seen - rotation) @ normal / distance
