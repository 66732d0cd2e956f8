"""A pose refined on all pixels: the follow-up against the reference simulated at its distance."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from calibration.errors import RegistrationError
from calibration.registration.motions import AXIAL, Generators, flows_px, moved_matrix
from calibration.registration.overlap import (
    axial_overlap,
    refuse_little_overlap,
    refuse_low_correlation,
    refuse_nearer,
    refuse_negative,
)
from simulation import GaussianPsf, Model, SamplingGrid, zoom_out_on_grid
from simulation.pose import project, projection_depth, projection_slopes

__all__ = ["Refinement", "refined_pose", "zoom_at_centre"]

FloatArray = NDArray[np.float64]

_ITERATIONS = 40
_CONVERGED_PX = 5e-4
_FREE_STEPS = 5
"""Steps after which pixels only drop out: a row that comes and goes would never let it settle."""
_BORDER_PX = 4
"""Pixels of the simulated follow-up left out at each side: the mirrored border reaches them."""

_Predictor = Callable[[FloatArray], tuple[FloatArray, NDArray[np.bool_]]]


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """A pose and the agreement reached.

    Parameters
    ----------
    matrix
        Shape (3, 3), last element 1: follow-up pixel centres to reference pixel centres.
    errors_px
        Standard error of each motion, in follow-up px (at the image's edge where it grows there).
    correlation, residual_rms_dn
        Of the follow-up with its prediction.
    """

    matrix: FloatArray
    errors_px: FloatArray
    correlation: float
    residual_rms_dn: float


def refined_pose(
    reference: NDArray[np.generic],
    followup: NDArray[np.generic],
    psf: GaussianPsf | None,
    matrix: FloatArray,
    generators: Generators,
) -> Refinement:
    """Pose that best predicts the follow-up from the reference, by Gauss-Newton descent.

    Parameters
    ----------
    reference, followup, psf
        As in ``calibration.registration.pair.register``.
    matrix
        Shape (3, 3): the pose to start from, right to about a pixel.
    generators
        ``AXIAL`` or ``HOMOGRAPHY``: the motions that are free.

    Raises
    ------
    RegistrationError
        If the overlap is too small, the descent does not settle or the images do not agree.
    """
    shape = _shape(followup)
    measured = np.asarray(followup, dtype=np.float64)
    predict: _Predictor
    if generators is AXIAL:
        predict = partial(_predict_axial, reference, psf, shape)
    else:
        predict = partial(_predict_homography, *_zoomed(reference, psf, matrix, shape), shape)
    flows = flows_px(generators, shape)
    settled = np.ones(shape, dtype=np.bool_)
    for number in range(_ITERATIONS):
        simulated, inside = predict(matrix)
        if number >= _FREE_STEPS:
            inside &= settled
        settled = inside
        slope_y, slope_x = np.gradient(simulated, axis=0), np.gradient(simulated, axis=1)
        columns = [slope_x[inside] * fx[inside] + slope_y[inside] * fy[inside] for fx, fy in flows]
        # Gain and offset are fitted together with the motion.
        level = simulated[inside]
        columns += [level, np.ones_like(level)]
        design = np.stack(columns, axis=1)
        normal = design.T @ design
        solution = np.linalg.lstsq(normal, design.T @ measured[inside], rcond=None)[0]
        gain = solution[-2]
        residual = measured[inside] - gain * level - solution[-1]
        refuse_negative(gain)
        # The columns are slopes of the simulated image; the measured one's are `gain` times these.
        step = solution[: len(generators)] / gain
        matrix = moved_matrix(matrix, generators, step, shape)
        if np.abs(step).max() < _CONVERGED_PX:
            break
    else:
        raise RegistrationError(
            f"the alignment did not settle in {_ITERATIONS} steps", reason="not_settled"
        )
    correlation = float(np.corrcoef(level, measured[inside])[0, 1])
    refuse_low_correlation(correlation)
    variance = float(np.mean(residual**2))
    errors_px = np.sqrt(np.diag(np.linalg.pinv(normal))[: len(generators)] * variance) / gain
    return Refinement(matrix, errors_px, correlation, sqrt(variance))


def _predict_axial(
    reference: NDArray[np.generic],
    psf: GaussianPsf | None,
    shape: tuple[int, int],
    matrix: FloatArray,
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Simulated follow-up, shape ``shape``, and where it is valid."""
    overlap = axial_overlap(matrix, _shape(reference), shape)
    simulated, inside = np.zeros(shape), np.zeros(shape, dtype=bool)
    simulated[overlap.rows, overlap.cols] = _simulated(reference, overlap.grid, psf)
    inside[overlap.rows, overlap.cols][_BORDER_PX:-_BORDER_PX, _BORDER_PX:-_BORDER_PX] = True
    return simulated, inside


def _zoomed(
    reference: NDArray[np.generic],
    psf: GaussianPsf | None,
    matrix: FloatArray,
    shape: tuple[int, int],
) -> tuple[FloatArray, FloatArray]:
    """Reference at the follow-up's distance, and the matrix of its pixels."""
    zoom = zoom_at_centre(matrix, shape)
    refuse_nearer(zoom)
    grid = SamplingGrid.centred(_shape(reference), max(zoom, 1.0))
    return _simulated(reference, grid, psf), grid.matrix


def _predict_homography(
    zoomed: FloatArray, zoomed_matrix: FloatArray, shape: tuple[int, int], matrix: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Same for a homography: the zoomed reference, warped by the small rest of the pose."""
    rest = np.linalg.inv(zoomed_matrix) @ matrix
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    place_x, place_y = project(rest, x, y)
    rows, cols = zoomed.shape
    inside = (
        (projection_depth(rest, x, y) > 0)
        & (place_x >= _BORDER_PX)
        & (place_x <= cols - 1 - _BORDER_PX)
        & (place_y >= _BORDER_PX)
        & (place_y <= rows - 1 - _BORDER_PX)
    )
    inside[[0, -1], :] = inside[:, [0, -1]] = False
    refuse_little_overlap(inside)
    simulated = map_coordinates(zoomed, [place_y, place_x], order=3, mode="mirror")
    return np.asarray(simulated), inside


def _simulated(
    reference: NDArray[np.generic], grid: SamplingGrid, psf: GaussianPsf | None
) -> FloatArray:
    model: Model = "bicubic" if psf is None else "matched"
    return np.asarray(zoom_out_on_grid(reference, grid, psf, model), dtype=np.float64)


def zoom_at_centre(matrix: FloatArray, shape: tuple[int, int]) -> float:
    """Square root of the homography's area ratio at the image centre."""
    a, b, c, d = projection_slopes(matrix, (shape[1] - 1) / 2, (shape[0] - 1) / 2)
    return sqrt(abs(a * d - b * c))


def _shape(image: NDArray[Any]) -> tuple[int, int]:
    return image.shape[0], image.shape[1]
