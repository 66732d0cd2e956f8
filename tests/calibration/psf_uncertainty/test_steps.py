import json
from pathlib import Path

import numpy as np
import pytest

from calibration.files import read_psf
from calibration.psf import FieldFit, PsfCalibration, Transfer2d, focus_scatter_px2, psf_steps
from simulation import GaussianPsf, MeasuredPsf, PsfField, SampledTransfer, SeparablePsf

PSF = PsfCalibration(
    sigma_x_px=0.8,
    sigma_x_err_px=0.01,
    sigma_y_px=0.7,
    sigma_y_err_px=0.02,
    rho=0.1,
    rho_err=0.03,
)


def test_the_errors_of_widths_become_steps_of_a_standard_error() -> None:
    steps = psf_steps(PSF, PSF.total_psf("psf"), 2.0)
    assert steps is not None
    total = np.zeros((3, 3))
    for step in steps:
        assert isinstance(step.plus, GaussianPsf)
        assert isinstance(step.minus, GaussianPsf)
        sides = [
            np.array([psf.sigma_x_px, psf.sigma_y_px, psf.rho]) for psf in (step.plus, step.minus)
        ]
        total += np.outer(sides[0] - sides[1], sides[0] - sides[1]) / step.length**2
    # Worked by hand: without a covariance matrix the three are independent.
    np.testing.assert_allclose(total, np.diag([1e-4, 4e-4, 9e-4]), atol=5e-5)


def test_widths_that_go_together_make_one_step() -> None:
    together = [[1e-4, 1e-4], [1e-4, 1e-4]]
    known = PSF.model_copy(update={"rho": None, "rho_err": None, "estimate_covariance": together})
    steps = psf_steps(known, known.total_psf("psf"), 2.0)
    assert steps is not None
    (step,) = steps
    assert isinstance(step.plus, GaussianPsf)
    assert isinstance(step.minus, GaussianPsf)
    changes = [
        getattr(step.plus, name) - getattr(step.minus, name)
        for name in ("sigma_x_px", "sigma_y_px", "rho")
    ]
    assert np.abs(changes) / step.length == pytest.approx([0.01, 0.01, 0.0], abs=1e-9)


def test_a_psf_without_errors_has_no_steps() -> None:
    bare = PsfCalibration(sigma_x_px=0.8, sigma_y_px=0.7)
    assert psf_steps(bare, bare.total_psf("psf"), 2.0) is None
    curve = SampledTransfer(freq_cy_per_px=(0.0, 1.0), values=(1.0, 0.0))
    along_axes = SeparablePsf(along_y=curve, along_x=curve, gaussian=PSF.total_psf("psf"))
    assert psf_steps(PSF, along_axes, 2.0) is None


def test_the_steps_of_a_measured_shape_are_its_band() -> None:
    # The band is by the formula's slopes, the steps are by differences.
    measured = Transfer2d(
        form="round",
        reason="",
        parameters={"cut_off_period_px": 0.5, "defocus_waves2": 0.3, "gaussian_px2": 0.1},
        covariance=((1e-6,), (2e-6, 4e-4), (-2e-6, 1e-5, 9e-6)),
        angles_deg=(0.0, 45.0, 90.0),
        edges=9,
        chi2_reduced=1.0,
        scatter=1.0,
    )
    calibration = PSF.model_copy(update={"transfer_2d": measured})
    steps = psf_steps(calibration, calibration.best_psf("psf"), 1.5)
    assert steps is not None
    freq = np.linspace(0.05, 0.5, 10)
    variance = np.zeros(10)
    for step in steps:
        assert isinstance(step.plus, MeasuredPsf)
        assert isinstance(step.minus, MeasuredPsf)
        change = step.plus.otf(freq, np.zeros(10)) - step.minus.otf(freq, np.zeros(10))
        variance += (change / step.length) ** 2
    band = measured.otf_err(freq, np.zeros(10))
    assert np.sqrt(variance) == pytest.approx(band, rel=0.1)


def test_each_coefficient_of_a_field_is_a_step() -> None:
    errs = ((0.01, 0.0, 0.02), (0.0, 0.0, 0.0), (0.01, 0.0, 0.0))
    fit = FieldFit(
        width_px=40,
        height_px=30,
        coefficients_px2=((0.6, 0.0, 0.1), (0.0, 0.0, 0.0), (0.5, 0.0, 0.0)),
        coefficients_err_px2=errs,
    )
    calibration = PSF.model_copy(update={"field": fit})
    steps = psf_steps(calibration, fit.total, 2.0)
    assert steps is not None
    assert len(steps) == 3
    sides = (steps[0].plus, steps[0].minus)
    assert isinstance(sides[0], PsfField)
    assert isinstance(sides[1], PsfField)
    change = sides[0].coefficients_px2 - sides[1].coefficients_px2
    assert change[0, 0] / steps[0].length == pytest.approx(0.01)
    old = calibration.model_copy(
        update={"field": fit.model_copy(update={"coefficients_err_px2": None})}
    )
    assert psf_steps(old, fit.total, 2.0) is None


def test_a_file_of_before_knows_no_focus(tmp_path: Path) -> None:
    document = {"schema": "standoff.psf/1", "sigma_x_px": 0.8, "sigma_y_px": 0.7}
    (tmp_path / "psf.json").write_text(json.dumps(document))
    assert focus_scatter_px2(read_psf(tmp_path / "psf.json")) is None
