"""A pose with the lens's distortion, refined on all pixels of a follow-up.

The reference is blurred once to the follow-up's sharpness and sampled at the positions given by the
pose; a Gauss-Newton descent moves the pose. Light that changes slowly over the frame (vignetting, a
shadow) is fitted at the same time, so that it does not bias the pose.
"""

from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.errors import RegistrationError
from calibration.registration.acceptance import (
    refuse_little_overlap,
    refuse_low_correlation,
    refuse_nearer,
    refuse_negative,
)
from calibration.registration.distorted_pose import DistortedPose
from calibration.registration.motions import flows_px, moved_matrix, unit_coordinates
from simulation import GaussianPsf
from simulation.arrays import AnyArray, BoolArray, FloatArray
from simulation.pose import DISTORTION_MAX
from simulation.zoom import BlurredSpline

_ASSUMED_SIGMA_PX = 0.65
"""Total PSF if none is given: a wrong width blurs every detail symmetrically and moves nothing."""

_ITERATIONS = 30
_CONVERGED_PX = 1e-3
_FREE_STEPS = 4
_BORDER_PX = 4.0
_K1_PRIOR = 0.05
"""Standard deviation of the distortion of real lenses; it decides at zooms near 1."""

_K1_STEP = 1e-4
_BLOCK_PX = 24
"""Side of the blocks between which, but not within which, residuals count as independent."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DistortedRefinement:
    """A refined pose and its errors.

    Parameters
    ----------
    pose
        The pose.
    place_err_px
        Standard error of a follow-up pixel's position in the reference, rms over the pixels used.
    k1_err
        Standard error of the distortion.
    correlation, residual_rms_dn
        Agreement of the follow-up with its prediction, after fitting the light.
    """

    pose: DistortedPose
    place_err_px: float
    k1_err: float
    correlation: float
    residual_rms_dn: float


def refined_distorted_pose(
    reference: AnyArray,
    followup: AnyArray,
    psf: GaussianPsf | None,
    matrix: FloatArray,
) -> DistortedRefinement:
    """Pose and distortion that best predict the follow-up from the reference.

    Parameters
    ----------
    reference, followup, psf
        As in ``calibration.registration.pair.register_distorted``.
    matrix
        Shape (3, 3): the homography to start from, accurate to a few pixels.

    Raises
    ------
    RegistrationError
        If the overlap is too small, the descent does not converge or the images do not agree.
    """
    shape = _shape(followup)
    is_one_camera = _shape(reference) == shape
    pose = DistortedPose(
        matrix=matrix, k1=0.0, reference_shape=_shape(reference), followup_shape=shape
    )
    refuse_nearer(pose.zoom)
    camera = psf or GaussianPsf(sigma_x_px=_ASSUMED_SIGMA_PX, sigma_y_px=_ASSUMED_SIGMA_PX)
    spline = BlurredSpline.of(reference, camera, pose.zoom)
    problem = _Problem(np.asarray(followup, dtype=np.float64), spline, is_one_camera)
    settled = np.ones(shape, dtype=np.bool_)
    for number in range(_ITERATIONS):
        fit = problem.linearised(pose, settled)
        if number >= _FREE_STEPS:
            # From here on pixels can only drop out: a row that comes and goes prevents convergence.
            settled = fit.inside
        pose = problem.moved(pose, fit.step)
        if abs(pose.k1) > DISTORTION_MAX:
            raise RegistrationError(
                "the images could only be aligned with a distortion that no lens has",
                reason="no_lens",
            )
        if np.abs(fit.step[:-1]).max() < _CONVERGED_PX:
            break
    else:
        raise RegistrationError(
            f"the alignment did not converge in {_ITERATIONS} steps", reason="not_settled"
        )
    refuse_low_correlation(fit.correlation)
    covariance = fit.covariance()
    return DistortedRefinement(
        pose=pose,
        place_err_px=pose.zoom * problem.place_err_px(fit.inside, covariance, pose),
        k1_err=sqrt(covariance[-1, -1]) if is_one_camera else 0.0,
        correlation=fit.correlation,
        residual_rms_dn=float(np.sqrt(np.mean(fit.residual_dn**2))),
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Linearised:
    """One step of the descent: its equations and its solution.

    ``design`` holds the columns of the pose first, ``step`` is the solution for them.
    """

    inside: BoolArray
    design: FloatArray
    normal: FloatArray
    residual_dn: FloatArray
    step: FloatArray
    gain: float
    correlation: float

    def covariance(self) -> FloatArray:
        """Covariance of the pose parameters, by the sandwich formula with sums over blocks.

        References
        ----------
        H. White, "A heteroskedasticity-consistent covariance matrix estimator and a direct test
        for heteroskedasticity", 1980; with blocks as clusters.
        """
        rows, cols = self.inside.shape
        block_cols = -(-cols // _BLOCK_PX)
        y, x = np.nonzero(self.inside)
        block = (y // _BLOCK_PX) * block_cols + x // _BLOCK_PX
        scores = self.design * self.residual_dn[:, None]
        sums = np.zeros((-(-rows // _BLOCK_PX) * block_cols, scores.shape[1]))
        for column in range(scores.shape[1]):
            sums[:, column] = np.bincount(block, scores[:, column], minlength=len(sums))
        used = max(int(np.count_nonzero(np.bincount(block, minlength=len(sums)))), 2)
        inverse = np.linalg.pinv(self.normal, hermitian=True)
        covariance = inverse @ (sums.T @ sums) @ inverse * (used / (used - 1))
        count = len(self.step)
        return np.asarray(covariance[:count, :count] / self.gain**2)


class _Problem:
    """The follow-up, the blurred reference, and how the pose parameters move pixels."""

    def __init__(self, followup: FloatArray, spline: BlurredSpline, is_one_camera: bool) -> None:
        self._followup = followup
        self._spline = spline
        self._is_one_camera = is_one_camera
        shape = _shape(followup)
        self._flows = flows_px(shape)
        u, v = unit_coordinates(shape)
        self._shades = (np.ones(shape), u, v, u * u, u * v, v * v)

    def linearised(self, pose: DistortedPose, allowed: BoolArray) -> _Linearised:
        """Compare the follow-up with its prediction, and solve for the next step of the pose."""
        reference_y, reference_x = pose.followup_places_px()
        rows, cols = pose.reference_shape
        inside = allowed & (
            (reference_y >= _BORDER_PX)
            & (reference_y <= rows - 1 - _BORDER_PX)
            & (reference_x >= _BORDER_PX)
            & (reference_x <= cols - 1 - _BORDER_PX)
        )
        inside[[0, -1], :] = inside[:, [0, -1]] = False
        refuse_little_overlap(inside)
        simulated = self._spline.at(reference_y, reference_x)
        slope_y, slope_x = (np.gradient(simulated, axis=axis)[inside] for axis in (0, 1))
        flows = [(fx[inside], fy[inside]) for fx, fy in self._flows]
        flows.append(self._k1_flow(pose, inside))
        level = simulated[inside]
        centred = level - level.mean()
        columns = [slope_x * fx + slope_y * fy for fx, fy in flows]
        columns += [centred * shade[inside] for shade in self._shades]
        columns += [shade[inside] for shade in self._shades]
        design = np.stack(columns, axis=1)
        measured = self._followup[inside]
        normal = design.T @ design
        # The prior keeps the distortion at rest if the pixels do not determine it.
        ridge = np.zeros(len(normal))
        k1_column = len(flows) - 1
        variance = float(np.var(measured)) + 1e-300
        ridge[k1_column] = variance / _K1_PRIOR**2 if self._is_one_camera else normal.trace() * 1e9
        right = design.T @ measured
        gain_guess = float(centred @ (measured - measured.mean()) / (centred @ centred + 1e-300))
        right[k1_column] -= ridge[k1_column] * pose.k1 * gain_guess
        normal = normal + np.diag(ridge)
        solution = np.linalg.lstsq(normal, right, rcond=None)[0]
        gain = float(solution[len(flows)])
        residual = measured - design @ solution
        refuse_negative(gain)
        light = design[:, len(flows) + 1 :] @ solution[len(flows) + 1 :]
        return _Linearised(
            inside=inside,
            design=design,
            normal=normal,
            residual_dn=residual,
            step=solution[: len(flows)] / gain,
            gain=gain,
            correlation=float(np.corrcoef(level, measured - light)[0, 1]),
        )

    def moved(self, pose: DistortedPose, step: FloatArray) -> DistortedPose:
        """The pose after a step."""
        matrix = moved_matrix(pose.matrix, step[:-1], pose.followup_shape)
        return pose.with_(matrix, pose.k1 + float(step[-1]) if self._is_one_camera else 0.0)

    def place_err_px(self, inside: BoolArray, covariance: FloatArray, pose: DistortedPose) -> float:
        """Standard error of a pixel's position in follow-up px, rms over the pixels used."""
        flows = [(fx[inside], fy[inside]) for fx, fy in self._flows]
        flows.append(self._k1_flow(pose, inside))
        variance = 0.0
        for axis in (0, 1):
            along = np.stack([flow[axis] for flow in flows], axis=1)
            variance += float(np.mean(np.einsum("ni,ij,nj->n", along, covariance, along)))
        return sqrt(variance)

    def _k1_flow(self, pose: DistortedPose, inside: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Displacement of every pixel used per unit of distortion, in follow-up px, in x and y."""
        if not self._is_one_camera:
            nothing = np.zeros(int(inside.sum()))
            return nothing, nothing
        y, x = (axis.astype(np.float64) for axis in np.nonzero(inside))
        above, below = (
            pose.with_(pose.matrix, pose.k1 + sign * _K1_STEP).to_reference_px(y, x)
            for sign in (1, -1)
        )
        moved_y, moved_x = ((a - b) / (2 * _K1_STEP) for a, b in zip(above, below, strict=True))
        (a, b), (c, d) = np.linalg.inv(pose.matrix[:2, :2]).tolist()
        return a * moved_x + b * moved_y, c * moved_x + d * moved_y


def _shape(image: NDArray[Any]) -> tuple[int, int]:
    return image.shape[0], image.shape[1]
