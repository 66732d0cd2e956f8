"""Where follow-up pixels lie in the reference when one lens distorts both images."""

from dataclasses import dataclass, replace
from math import hypot
from typing import Self

import numpy as np
from numpy.typing import NDArray

from simulation.pose import DISTORTION_MAX

__all__ = ["K1_MAX", "DistortedPose"]

FloatArray = NDArray[np.float64]

K1_MAX = DISTORTION_MAX
"""Largest distortion, relative at the image corner; beyond, a barrel would fold over."""

_FAR = 1e6

_NEWTON_STEPS = 6


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DistortedPose:
    """A homography between the images of an ideal lens, seen through a distorting one.

    Both images are whole frames of one camera. An ideal point at the radius r from the middle of
    the frame, 1 at its corner, is seen at ``r (1 + k1 r^2)``; negative is barrel.

    Parameters
    ----------
    matrix
        Shape (3, 3), last element 1: ideal follow-up pixels ``(x, y, 1)`` to ideal reference
        pixels.
    k1
        Radial distortion; 0 makes ``matrix`` the whole pose.
    reference_shape, followup_shape
        ``(rows, cols)``.
    """

    matrix: FloatArray
    k1: float
    reference_shape: tuple[int, int]
    followup_shape: tuple[int, int]

    @property
    def zoom(self) -> float:
        """Reference pixels per follow-up pixel at the follow-up's centre."""
        rows, cols = self.followup_shape
        step = np.array([-0.5, 0.5])
        middle_y, middle_x = (rows - 1) / 2, (cols - 1) / 2
        across = self.to_reference_px(np.full(2, middle_y), middle_x + step)
        down = self.to_reference_px(middle_y + step, np.full(2, middle_x))
        (ay, ax), (dy, dx) = (np.diff(across)[:, 0], np.diff(down)[:, 0])
        return float(np.sqrt(abs(ax * dy - ay * dx)))

    def with_(self, matrix: FloatArray, k1: float) -> Self:
        """Return the pose with other figures; the matrix is normalised."""
        return replace(self, matrix=matrix / matrix[2, 2], k1=k1)

    def to_reference_px(self, y_px: FloatArray, x_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Reference coordinates ``(y, x)`` of follow-up coordinates, of their shape."""
        return self._through(self.matrix, self.followup_shape, self.reference_shape, y_px, x_px)

    def to_followup_px(self, y_px: FloatArray, x_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Follow-up coordinates ``(y, x)`` of reference coordinates, of their shape."""
        back = np.asarray(np.linalg.inv(self.matrix), dtype=np.float64)
        return self._through(back, self.reference_shape, self.followup_shape, y_px, x_px)

    def followup_places_px(self) -> tuple[FloatArray, FloatArray]:
        """Reference coordinates ``(y, x)`` of every follow-up pixel, shape (rows, cols) each."""
        rows, cols = self.followup_shape
        y, x = np.meshgrid(np.arange(float(rows)), np.arange(float(cols)), indexing="ij")
        return self.to_reference_px(y, x)

    def _through(
        self,
        matrix: FloatArray,
        from_shape: tuple[int, int],
        to_shape: tuple[int, int],
        y_px: FloatArray,
        x_px: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        y, x = self._scaled(y_px, x_px, from_shape, is_inverse=True)
        depth = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
        ideal_x = np.asarray((matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]) / depth)
        ideal_y = np.asarray((matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]) / depth)
        return self._scaled(ideal_y, ideal_x, to_shape, is_inverse=False)

    def _scaled(
        self, y_px: FloatArray, x_px: FloatArray, shape: tuple[int, int], *, is_inverse: bool
    ) -> tuple[FloatArray, FloatArray]:
        """Seen places of ideal ones, or (inverse) ideal places of seen ones."""
        if self.k1 == 0:
            return y_px, x_px
        middle_y, middle_x = (shape[0] - 1) / 2, (shape[1] - 1) / 2
        # One camera, one unit of length, whatever part of its frame an image is.
        corner_px = hypot(self.reference_shape[0] - 1, self.reference_shape[1] - 1) / 2
        dy, dx = (y_px - middle_y) / corner_px, (x_px - middle_x) / corner_px
        square = dy * dy + dx * dx
        if not is_inverse:
            # Beyond the fold of a barrel nothing is seen: the place is far outside.
            is_seen = 1 + 3 * self.k1 * square > 0
            factor = np.where(is_seen, 1 + self.k1 * square, _FAR)
        else:
            # factor = 1 / (1 + k1 r^2) at the ideal radius r = factor * (seen radius).
            factor = np.ones_like(square)
            for _ in range(_NEWTON_STEPS):
                bent = self.k1 * square * factor * factor
                factor = factor - (factor * (1 + bent) - 1) / np.maximum(1 + 3 * bent, 0.1)
        return (
            np.asarray(middle_y + corner_px * factor * dy),
            np.asarray(middle_x + corner_px * factor * dx),
        )
