"""Small motions of a photograph's pixels: the degrees of freedom of a pose in its refinement."""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from calibration.registration.distorted_pose import DistortedPose
from simulation.arrays import FloatArray
from simulation.pose import projection_slopes

_MOTIONS = ((0, 2), (1, 2), (0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1))
"""Elements of each motion in the 3 x 3 matrix that is added to the identity, in coordinates (u, v)
in [-1, 1] about the centre; shifts along x and y come first."""

_K1_PRIOR = 0.05
"""Standard deviation of the distortion of real lenses; it decides at zooms near 1."""

_K1_STEP = 1e-4


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Prior:
    """Normal equations of what is known of the parameters beforehand."""

    normal: FloatArray
    right: FloatArray


class PoseMotions:
    """The parameters of a pose but its displacement, and how each of them moves samples.

    Parameters
    ----------
    y_px, x_px
        Samples of the target, shape (n,).
    shape
        ``(rows, cols)`` of the target.
    fits_distortion
        Whether the lens's distortion is a parameter, the last one.

    ``projective`` are the displacements of ``projective_flows``.
    """

    def __init__(
        self,
        y_px: FloatArray,
        x_px: FloatArray,
        shape: tuple[int, int],
        *,
        fits_distortion: bool,
    ) -> None:
        self._y_px, self._x_px, self._shape = y_px, x_px, shape
        self.fits_distortion = fits_distortion
        self.projective = projective_flows(y_px, x_px, shape)

    def flows(self, pose: DistortedPose) -> tuple[FloatArray, FloatArray]:
        """Displacement along x and y per unit of each parameter, in target px, (n, parameters)."""
        if not self.fits_distortion:
            return self.projective
        along_x, along_y = (
            np.concatenate([straight, bent], axis=1)
            for straight, bent in zip(self.projective, self.distortion_flow(pose), strict=True)
        )
        return along_x, along_y

    def moved(self, pose: DistortedPose, step: FloatArray) -> DistortedPose:
        """Return the pose after a step of all parameters."""
        count = len(_MOTIONS)
        matrix = moved_matrix(pose.matrix, step[:count], self._shape)
        k1 = pose.k1 + float(step[count]) if self.fits_distortion else pose.k1
        return pose.with_(matrix, k1, pose.displacement)

    def prior(self, pose: DistortedPose) -> Prior:
        """What is known of distortions."""
        size = len(_MOTIONS) + self.fits_distortion
        normal, right = np.zeros((size, size)), np.zeros(size)
        if self.fits_distortion:
            normal[-1, -1] = 1 / _K1_PRIOR**2
            right[-1] = -pose.k1 / _K1_PRIOR**2
        return Prior(normal=normal, right=right)

    def distortion_flow(self, pose: DistortedPose) -> tuple[FloatArray, FloatArray]:
        """Displacement along x and y per unit of distortion, in target px, shape (n, 1) each."""
        above, below = (
            pose.with_(pose.matrix, pose.k1 + sign * _K1_STEP, pose.displacement).to_reference_px(
                self._y_px, self._x_px
            )
            for sign in (1, -1)
        )
        moved_y, moved_x = ((a - b) / (2 * _K1_STEP) for a, b in zip(above, below, strict=True))
        (a, b), (c, d) = np.linalg.inv(pose.matrix[:2, :2]).tolist()
        return (a * moved_x + b * moved_y)[:, None], (c * moved_x + d * moved_y)[:, None]


def projective_flows(
    y_px: FloatArray, x_px: FloatArray, shape: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """Displacement by one pixel of each of 8 projective motions, along x and y, shape (n, 8).

    Parameters
    ----------
    y_px, x_px
        Positions in a photograph of ``shape``, shape (n,).
    """
    half_px = _half_size_px(shape)
    u, v = (x_px - (shape[1] - 1) / 2) / half_px, (y_px - (shape[0] - 1) / 2) / half_px
    unit, nothing = (u, v, np.ones_like(u)), np.zeros_like(u)
    along_x, along_y = [], []
    for row, col in _MOTIONS:
        along_x.append(unit[col] if row == 0 else -unit[col] * u if row == 2 else nothing)
        along_y.append(unit[col] if row == 1 else -unit[col] * v if row == 2 else nothing)
    return np.stack(along_x, axis=1), np.stack(along_y, axis=1)


def moved_matrix(matrix: FloatArray, step_px: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Pose after a step of a number of pixels along each projective motion.

    Parameters
    ----------
    matrix
        Shape (3, 3): follow-up pixel centres to reference pixel centres.
    step_px
        One number for each motion.
    shape
        ``(rows, cols)`` of the follow-up.

    Returns
    -------
    ndarray of float64, shape (3, 3)
        Its last element is 1.
    """
    half_px = _half_size_px(shape)
    to_unit = np.diag([1 / half_px, 1 / half_px, 1.0])
    to_unit[:2, 2] = [-(shape[1] - 1) / 2 / half_px, -(shape[0] - 1) / 2 / half_px]
    motion = np.eye(3)
    for element, amount in zip(_MOTIONS, step_px, strict=True):
        motion[element] += amount / half_px
    moved = matrix @ np.linalg.inv(to_unit) @ motion @ to_unit
    return np.asarray(moved / moved[2, 2])


def zoom_at_centre(matrix: FloatArray, shape: tuple[int, int]) -> float:
    """Square root of the homography's area ratio at the image centre."""
    a, b, c, d = projection_slopes(matrix, (shape[1] - 1) / 2, (shape[0] - 1) / 2)
    return sqrt(abs(a * d - b * c))


def _half_size_px(shape: tuple[int, int]) -> float:
    """Unit of the motions' coordinates: half the longer side of the follow-up."""
    return max(shape) / 2
