"""A camera that looks at a plane, and the homography between two of its poses."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from simulation.arrays import FloatArray

LARGEST_SIDE_PX = 1_000_000
"""No sensor has more; squares of larger numbers leave too few digits for an angle."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FollowupPose:
    """Where a follow-up is taken from; its reference looks at the plane's origin.

    Parameters
    ----------
    zoom
        Ratio of its distance to the reference's, each along its optical axis.
    tilt_deg, reference_tilt_deg
        Angles between the optical axis and the plane's normal; the reference leans along x.
    direction_deg
        Where the follow-up leans, from the reference's lean; None for the worst direction.
    aim_px
        Pixel ``(x, y)`` of the reference that the middle of the follow-up shows; by default the
        reference's own middle.
    """

    zoom: float = 1.0
    tilt_deg: float = 0.0
    reference_tilt_deg: float = 0.0
    direction_deg: float | None = None
    aim_px: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewingCamera:
    """A camera without distortion that looks at a plane.

    Raises
    ------
    ValueError
        If the focal length is not positive, or a side is not 16 to 1,000,000 px.
    """

    focal_length_px: float
    width_px: int
    height_px: int

    def __post_init__(self) -> None:
        if not (self.focal_length_px > 0 and np.isfinite(self.focal_length_px)):
            raise ValueError(f"focal_length_px must be positive, got {self.focal_length_px}")
        if not all(16 <= side_px <= LARGEST_SIDE_PX for side_px in self.size):
            raise ValueError(
                f"a frame of 16 to {LARGEST_SIDE_PX:,} px a side is needed, got {self.width_px} x "
                f"{self.height_px}"
            )

    @property
    def size(self) -> tuple[int, int]:
        """``(width, height)`` in px."""
        return self.width_px, self.height_px

    def plane_to_px(
        self, distance: float, tilt_deg: float, direction_deg: ArrayLike = 0.0
    ) -> FloatArray:
        """Homography from the plane to pixels; the camera looks at the plane's origin.

        Parameters
        ----------
        distance
            From the origin, in any unit; the plane's coordinates have the same.
        tilt_deg
            Angle between the axis and the plane's normal.
        direction_deg
            Where the axis leans, from the rows' x towards the columns' y; one angle, or many.

        Returns
        -------
        ndarray
            Shape (..., 3, 3), the leading axes those of ``direction_deg``.
        """
        t, b = np.radians(tilt_deg), np.radians(np.asarray(direction_deg, dtype=np.float64))
        about = np.zeros((*b.shape, 3, 3))
        about[..., 0, 0] = about[..., 1, 1] = np.cos(b)
        about[..., 1, 0] = np.sin(b)
        about[..., 0, 1] = -about[..., 1, 0]
        about[..., 2, 2] = 1.0
        leaning = np.array(
            [[np.cos(t), 0.0, np.sin(t)], [0.0, 1.0, 0.0], [-np.sin(t), 0.0, np.cos(t)]]
        )
        # Columns: the plane's axes and its origin, seen from the camera.
        seen = about @ leaning.T @ np.swapaxes(about, -1, -2)
        seen[..., :, 2] = (0.0, 0.0, distance)
        camera = np.array(
            [
                [self.focal_length_px, 0.0, (self.width_px - 1) / 2],
                [0.0, self.focal_length_px, (self.height_px - 1) / 2],
                [0.0, 0.0, 1.0],
            ]
        )
        return np.asarray(camera @ seen)

    @property
    def middle_px(self) -> tuple[float, float]:
        """Middle of the frame, ``(x, y)``: pixel centres are at integers."""
        return (self.width_px - 1) / 2, (self.height_px - 1) / 2

    def aimed_at(
        self, aim_px: tuple[float, float], reference_tilt_deg: float = 0.0
    ) -> tuple[float, float]:
        """Point of the plane that a pixel of the reference shows, in the reference's distances.

        Raises
        ------
        ValueError
            If the pixel lies outside the frame, or looks past the plane's horizon.
        """
        x, y = aim_px
        if not (-0.5 <= x <= self.width_px - 0.5 and -0.5 <= y <= self.height_px - 0.5):
            raise ValueError(
                f"the point to aim at must lie in the reference of {self.width_px} x "
                f"{self.height_px} px, got {x:g},{y:g}"
            )
        near = self.plane_to_px(1.0, reference_tilt_deg)
        place = np.linalg.solve(near, np.array([x, y, 1.0]))
        # The plane's origin has a positive third component; so has all on this side of the horizon.
        if not place[2] > 0:
            raise ValueError(f"the reference looks past the plane's horizon at {x:g},{y:g} px")
        return float(place[0] / place[2]), float(place[1] / place[2])

    def followup_to_reference(
        self,
        zoom: float,
        tilt_deg: float,
        reference_tilt_deg: float = 0.0,
        direction_deg: ArrayLike = 0.0,
        aim_px: tuple[float, float] | None = None,
    ) -> FloatArray:
        """Homography of a follow-up from ``zoom`` times the reference's distance.

        The reference leans along x, the follow-up in ``direction_deg`` from there; its middle
        shows ``aim_px`` of the reference, or the reference's own middle. Shape (..., 3, 3), the
        leading axes those of ``direction_deg``.

        Raises
        ------
        ValueError
            As ``aimed_at``.
        """
        near = self.plane_to_px(1.0, reference_tilt_deg)
        far = self.plane_to_px(zoom, tilt_deg, direction_deg)
        if aim_px is not None:
            x, y = self.aimed_at(aim_px, reference_tilt_deg)
            far = far @ np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, 1.0]])
        matrix = near @ np.linalg.inv(far)
        return np.asarray(matrix / matrix[..., 2:, 2:])
