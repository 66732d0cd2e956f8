"""Neighbours of a calibrated PSF, one standard error away, in the directions that matter."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calibration.psf import FieldFit, PsfCalibration, Transfer2d
from simulation.arrays import FloatArray
from simulation.psf import GaussianPsf, Psf, PsfField
from simulation.uncertainty import PsfStep, principal_steps

_WIDTHS = ("sigma_x_px", "sigma_y_px", "rho")


def psf_steps(
    calibration: PsfCalibration, psf: Psf | PsfField, zoom: float
) -> tuple[PsfStep, ...] | None:
    """Return independent steps of one standard error from the PSF that was taken.

    Parameters
    ----------
    calibration
        The calibration that ``psf`` is of.
    psf
        Its Gaussian, its measured shape or its field.
    zoom
        Of the follow-up; it need only be about right.

    Returns
    -------
    tuple of PsfStep, or None
        None where the calibration does not state the error of this PSF: files of before, and
        PSFs measured along the two axes alone.

    Notes
    -----
    Of a field the errors of the coefficients are known, and not how they go together: they are
    taken as independent, which is too large away from the middle of the frame.
    """
    if isinstance(psf, PsfField):
        return None if calibration.field is None else _of_field(calibration.field, psf)
    measured = calibration.transfer_2d
    if measured is not None and measured.psf(psf.gaussian) == psf:
        return _of_transfer(measured, psf.gaussian, zoom)
    return _of_widths(calibration, psf, zoom) if isinstance(psf, GaussianPsf) else None


def focus_scatter_px2(calibration: PsfCalibration) -> float | None:
    """Scatter of the PSF's variance from capture to capture, None where it was not measured."""
    return None if calibration.focus is None else calibration.focus.scatter_px2


def _of_transfer(
    measured: Transfer2d, gaussian: GaussianPsf, zoom: float
) -> tuple[PsfStep, ...] | None:
    names = tuple(measured.parameters)

    def psf_of(values: FloatArray) -> Psf:
        parameters = dict(zip(names, values.tolist(), strict=True))
        return measured.model_copy(update={"parameters": parameters}).psf(gaussian)

    values = np.array(list(measured.parameters.values()))
    return principal_steps(psf_of, values, measured.covariance_matrix, zoom)


def _of_widths(
    calibration: PsfCalibration, psf: GaussianPsf, zoom: float
) -> tuple[PsfStep, ...] | None:
    total = calibration.total
    errs = {
        name: estimate.err
        for name in _WIDTHS
        if (estimate := getattr(total, name)) is not None and np.isfinite(estimate.err)
    }
    if not {"sigma_x_px", "sigma_y_px"} <= errs.keys():
        return None
    covariance = np.diag(np.array(list(errs.values())) ** 2)
    joint = total.estimate_covariance
    if joint is not None and joint.shape == covariance.shape:
        covariance = joint

    def psf_of(values: FloatArray) -> Psf:
        return _with_widths(psf, dict(zip(errs, values.tolist(), strict=True)))

    values = np.array([getattr(psf, name) for name in errs])
    return principal_steps(psf_of, values, covariance, zoom)


def _with_widths(psf: GaussianPsf, changed: dict[str, float]) -> GaussianPsf:
    """Return a Gaussian with some of its widths and its correlation changed."""
    known = {name: getattr(psf, name) for name in _WIDTHS}
    return GaussianPsf(**{**known, **changed})


def _of_field(fit: FieldFit, field: PsfField) -> tuple[PsfStep, ...] | None:
    if fit.coefficients_err_px2 is None:
        return None
    errs = np.array(fit.coefficients_err_px2)
    if errs.shape != field.coefficients_px2.shape:
        return None
    return tuple(_field_steps(field, errs))


def _field_steps(field: PsfField, errs: FloatArray) -> Iterator[PsfStep]:
    for index in zip(*np.nonzero(errs), strict=True):
        sides = []
        for sign in (1.0, -1.0):
            coefficients = field.coefficients_px2.copy()
            coefficients[index] += sign * errs[index]
            sides.append(replace(field, coefficients_px2=coefficients))
        yield PsfStep(plus=sides[0], minus=sides[1], length=2.0)
