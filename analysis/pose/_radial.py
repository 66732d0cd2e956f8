"""How another lens than the reference's bends the picture: one radial term, from tracked corners.

A homography leaves out that radii grow by ``1 + k1 r**2``, with r = 1 in the corners of the frame.
What the term moves beyond what a homography can take up tells k1, over all frames together. It is
the difference to the reference's lens: with one lens for both it is nearly 0.
"""

from dataclasses import dataclass
from math import sqrt
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.registration import TrackedPose
from simulation.arrays import FloatArray
from simulation.pose import project

ByteImage = NDArray[np.uint8]

MOST_K1: Final = 0.15
"""Beyond, too few corners agree on a pose."""

_SURE: Final = 4.0
"""Standard errors from which a term is taken out."""

_MOST_ERR: Final = 0.004


@dataclass(slots=True)
class RadialTerm:
    """The term of one lens, from the frames that were added."""

    _moved: float = 0.0
    _square: float = 0.0
    _variance_px2: float = 0.0
    _frames: int = 0

    @property
    def k1(self) -> float:
        """The term; 0 as long as it is not known, or cannot be told from 0."""
        if not self._frames or self._square <= 0:
            return 0.0
        k1 = self._moved / self._square
        err = sqrt(self._variance_px2 / self._frames / self._square)
        is_known = err < _MOST_ERR and abs(k1) > _SURE * err
        return float(np.clip(k1, -MOST_K1, MOST_K1)) if is_known else 0.0

    def add(self, pose: TrackedPose, shape: tuple[int, int]) -> None:
        """Add a frame of this shape, from about where the reference was taken.

        From elsewhere the depth of a scene would bend the picture as well.
        """
        inverse = np.asarray(np.linalg.inv(pose.matrix), dtype=np.float64)
        x, y = pose.reference_px.T
        seen_x, seen_y = project(inverse, x, y)
        depth = inverse[2] @ np.stack((x, y, np.ones_like(x)))
        one, none = np.ones_like(x), np.zeros_like(x)
        along = np.stack((x, y, one, none, none, none, -seen_x * x, -seen_x * y)) / depth
        across = np.stack((none, none, none, x, y, one, -seen_y * x, -seen_y * y)) / depth
        taken_up = np.hstack((along, across)).T
        taken_up = taken_up / np.linalg.norm(taken_up, axis=0)
        bent = (
            _squared_radius(pose.frame_px, shape) * _from_middle(pose.frame_px, shape)
        ).T.ravel()
        residual = np.concatenate((pose.frame_px[:, 0] - seen_x, pose.frame_px[:, 1] - seen_y))
        both = np.column_stack((bent, residual))
        left = both - taken_up @ np.linalg.lstsq(taken_up, both)[0]
        square = float(left[:, 0] @ left[:, 0])
        moved = float(left[:, 0] @ left[:, 1])
        rest = left[:, 1] - left[:, 0] * moved / max(square, 1e-12)
        self._moved += moved
        self._square += square
        self._variance_px2 += float(np.mean(rest**2))
        self._frames += 1

    def without(self, pose: TrackedPose, shape: tuple[int, int]) -> FloatArray:
        """Return the homography of a frame as a lens without this term would give it."""
        k1 = self.k1
        if k1 == 0:
            return pose.matrix
        straight = pose.frame_px - k1 * _squared_radius(pose.frame_px, shape) * _from_middle(
            pose.frame_px, shape
        )
        found, _ = cv2.findHomography(straight, pose.reference_px, 0)
        # If it finds nothing, OpenCV returns an empty matrix or None.
        return np.asarray(found, np.float64) if np.shape(found) == (3, 3) else pose.matrix


def straightened(levels: ByteImage, k1: float) -> ByteImage:
    """Return a frame as a lens without this term would give it."""
    if k1 == 0:
        return levels
    rows, cols = levels.shape
    grid = np.mgrid[:rows, :cols][::-1].reshape(2, -1).T.astype(np.float64)
    source = grid + k1 * _squared_radius(grid, (rows, cols)) * _from_middle(grid, (rows, cols))
    x, y = source.astype(np.float32).T.reshape(2, rows, cols)
    made = cv2.remap(levels, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(made, np.uint8)


def _from_middle(points_px: FloatArray, shape: tuple[int, int]) -> FloatArray:
    rows, cols = shape
    return points_px - ((cols - 1) / 2, (rows - 1) / 2)


def _squared_radius(points_px: FloatArray, shape: tuple[int, int]) -> FloatArray:
    rows, cols = shape
    square = np.sum(_from_middle(points_px, shape) ** 2, axis=1, keepdims=True)
    return np.asarray(square / (((cols - 1) / 2) ** 2 + ((rows - 1) / 2) ** 2))
