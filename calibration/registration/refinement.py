"""A pose refined on all pixels: the follow-up against the reference simulated at its distance."""

from dataclasses import dataclass
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from calibration.errors import RegistrationError
from calibration.registration.acceptance import (
    refuse_little_overlap,
    refuse_low_correlation,
    refuse_nearer,
    refuse_negative,
)
from calibration.registration.motions import flows_px, moved_matrix
from simulation import GaussianPsf, SamplingGrid, zoom_out_on_grid
from simulation.arrays import AnyArray, BoolArray, FloatArray
from simulation.pose import project, projection_depth, projection_slopes

_ITERATIONS = 40
_CONVERGED_PX = 5e-4
_FREE_STEPS = 5
"""Steps after which pixels can only drop out: a row that comes and goes prevents convergence."""
_BORDER_PX = 4
"""Pixels of the simulated follow-up ignored at each side: the mirrored border affects them."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Refinement:
    """A refined pose and the agreement reached.

    Parameters
    ----------
    matrix
        Shape (3, 3), last element 1: follow-up pixel centres to reference pixel centres.
    correlation, residual_rms_dn
        Agreement of the follow-up with its prediction.
    """

    matrix: FloatArray
    correlation: float
    residual_rms_dn: float


def refined_pose(
    reference: AnyArray,
    followup: AnyArray,
    psf: GaussianPsf | None,
    matrix: FloatArray,
) -> Refinement:
    """Pose that best predicts the follow-up from the reference, by Gauss-Newton descent.

    Parameters
    ----------
    reference, followup, psf
        As in ``calibration.registration.pair.register``.
    matrix
        Shape (3, 3): the pose to start from, accurate to about a pixel.

    Raises
    ------
    RegistrationError
        If the overlap is too small, the descent does not converge or the images do not agree.
    """
    shape = _shape(followup)
    measured = np.asarray(followup, dtype=np.float64)
    zoomed, zoomed_matrix = _zoomed(reference, psf, matrix, shape)
    flows = flows_px(shape)
    settled = np.ones(shape, dtype=np.bool_)
    for number in range(_ITERATIONS):
        simulated, inside = _warped(zoomed, np.linalg.inv(zoomed_matrix) @ matrix, shape)
        if number >= _FREE_STEPS:
            inside &= settled
        settled = inside
        slope_y, slope_x = np.gradient(simulated, axis=0), np.gradient(simulated, axis=1)
        columns = [slope_x[inside] * fx[inside] + slope_y[inside] * fy[inside] for fx, fy in flows]
        # Gain and offset are fitted together with the motion.
        level = simulated[inside]
        columns += [level, np.ones_like(level)]
        design = np.stack(columns, axis=1)
        right = design.T @ measured[inside]
        solution = np.linalg.lstsq(design.T @ design, right, rcond=None)[0]
        gain = solution[-2]
        residual = measured[inside] - gain * level - solution[-1]
        refuse_negative(gain)
        # The columns are slopes of the simulated image; the measured one's are `gain` times these.
        step = solution[: len(flows)] / gain
        matrix = moved_matrix(matrix, step, shape)
        if np.abs(step).max() < _CONVERGED_PX:
            break
    else:
        raise RegistrationError(
            f"the alignment did not converge in {_ITERATIONS} steps", reason="not_settled"
        )
    correlation = float(np.corrcoef(level, measured[inside])[0, 1])
    refuse_low_correlation(correlation)
    return Refinement(
        matrix=matrix,
        correlation=correlation,
        residual_rms_dn=float(np.sqrt(np.mean(residual**2))),
    )


def _zoomed(
    reference: AnyArray,
    psf: GaussianPsf | None,
    matrix: FloatArray,
    shape: tuple[int, int],
) -> tuple[FloatArray, FloatArray]:
    """Reference at the follow-up's distance, and the matrix of its pixels."""
    zoom = zoom_at_centre(matrix, shape)
    refuse_nearer(zoom)
    grid = SamplingGrid.centred(_shape(reference), max(zoom, 1.0))
    simulated = zoom_out_on_grid(reference, grid, psf, "bicubic" if psf is None else "matched")
    return np.asarray(simulated, dtype=np.float64), grid.matrix


def _warped(
    zoomed: FloatArray, rest: FloatArray, shape: tuple[int, int]
) -> tuple[FloatArray, BoolArray]:
    """Follow-up by the small remainder of the pose, in ``shape``, and where it is valid."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    zoomed_x, zoomed_y = project(rest, x, y)
    rows, cols = zoomed.shape
    inside = (
        (projection_depth(rest, x, y) > 0)
        & (zoomed_x >= _BORDER_PX)
        & (zoomed_x <= cols - 1 - _BORDER_PX)
        & (zoomed_y >= _BORDER_PX)
        & (zoomed_y <= rows - 1 - _BORDER_PX)
    )
    inside[[0, -1], :] = inside[:, [0, -1]] = False
    refuse_little_overlap(inside)
    simulated = map_coordinates(zoomed, [zoomed_y, zoomed_x], order=3, mode="mirror")
    return np.asarray(simulated), inside


def zoom_at_centre(matrix: FloatArray, shape: tuple[int, int]) -> float:
    """Square root of the homography's area ratio at the image centre."""
    a, b, c, d = projection_slopes(matrix, (shape[1] - 1) / 2, (shape[0] - 1) / 2)
    return sqrt(abs(a * d - b * c))


def _shape(image: NDArray[Any]) -> tuple[int, int]:
    return image.shape[0], image.shape[1]
