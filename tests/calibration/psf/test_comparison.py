import json
from math import erfc, sqrt
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from acquisition.files import InputFile, Provenance
from calibration.errors import CalibrationError
from calibration.files import read_psf
from calibration.psf import (
    FieldFit,
    PsfCalibration,
    Transfer2d,
    focus_repeatability,
    focus_scatter_px2,
    psf_change,
    psf_steps,
)
from simulation import GaussianPsf, MeasuredPsf, PsfField, SampledTransfer, SeparablePsf
from tests.calibration.known import known


def psf(**values: object) -> PsfCalibration:
    return PsfCalibration.model_validate(
        {
            "sigma_x_px": 0.8,
            "sigma_x_err_px": 0.003,
            "sigma_y_px": 0.7,
            "sigma_y_err_px": 0.004,
            "rho": 0.1,
            "rho_err": 0.01,
            **values,
        }
    )


def test_z_and_p_by_hand() -> None:
    change = psf_change(psf(), psf(sigma_x_px=0.815, sigma_x_err_px=0.004))
    x, y, rho = change.parameters
    assert x.z == pytest.approx(0.015 / 0.005)  # errors 3 and 4 make 5
    assert x.p_value == pytest.approx(0.0027, rel=0.01)  # 3 sigma, two-sided, from tables
    assert x.p_value_holm == pytest.approx(3 * x.p_value)  # the least of three
    assert (y.z, y.p_value_holm, rho.z) == (0, 1, 0)
    assert x.is_changed
    assert change.verdict == "the PSF has changed: sigma_x_px by +1.87 % (p = 0.008)"


def test_holm_by_the_steps_of_the_definition() -> None:
    shift = {name: psf().model_dump()[name] for name in ("sigma_x_px", "sigma_y_px", "rho")}
    change = psf_change(
        psf(),
        psf(
            sigma_x_px=shift["sigma_x_px"] + 2.5 * 0.003 * sqrt(2),
            sigma_y_px=shift["sigma_y_px"] + 2.2 * 0.004 * sqrt(2),
            rho=shift["rho"] + 0.1 * 0.01 * sqrt(2),
        ),
    )
    plain = [erfc(z / sqrt(2)) for z in (2.5, 2.2, 0.1)]
    expected = [3 * plain[0], max(3 * plain[0], 2 * plain[1]), plain[2]]
    assert [one.p_value_holm for one in change.parameters] == pytest.approx(expected)
    assert change.verdict.startswith("no significant change in 3 parameters (smallest p = 0.037")


def test_only_what_both_know_with_errors_is_compared() -> None:
    first = psf(optical_sigma_x_px=0.7, optical_sigma_x_err_px=0.01)
    change = psf_change(first, psf(rho=None, rho_err=None))
    assert [one.name for one in change.parameters] == ["sigma_x_px", "sigma_y_px"]
    with pytest.raises(CalibrationError):
        psf_change(first, PsfCalibration(sigma_x_px=0.8, sigma_y_px=0.7))


def test_what_makes_two_calibrations_hard_to_compare_is_said() -> None:
    change = psf_change(
        psf(method="paper", camera={"serial": "A"}),
        psf(method="all-angles", region="centre", camera={"serial": "B"}),
    )
    assert change.remarks == (
        "they use different methods: paper and all-angles",
        "they use different regions: none and centre",
        "they are from different cameras: A and B",
    )
    assert psf_change(psf(), psf()).remarks == ()


@given(x=st.floats(0.75, 0.85), y=st.floats(0.65, 0.75), rho=st.floats(0.0, 0.2))
def test_the_order_of_the_two_only_turns_the_sign(x: float, y: float, rho: float) -> None:
    other = psf(sigma_x_px=x, sigma_y_px=y, rho=rho)
    there, back = psf_change(psf(), other), psf_change(other, psf())
    for one, two in zip(there.parameters, back.parameters, strict=True):
        assert one.z == -two.z
        assert one.p_value_holm == two.p_value_holm
        assert one.p_value <= one.p_value_holm <= 1


def test_a_change_of_the_correlation_is_told_as_a_difference() -> None:
    # A share of a correlation near 0 would say nothing.
    change = psf_change(psf(), psf(rho=-0.02))
    assert change.verdict.startswith("the PSF has changed: rho by -0.1200 (p = ")


def measured_on(*contents: str) -> Provenance:
    files = tuple(InputFile(path=f"{name}.tif", sha256=name) for name in contents)
    table = InputFile(path="noise.json", sha256="n")
    return Provenance(version="1", created="now", command="c", inputs=(*files, table))


def test_calibrations_of_the_same_captures_get_no_verdict_however_they_differ() -> None:
    one, other = psf(provenance=measured_on("a", "b")), psf(provenance=measured_on("b", "c"))
    assert psf_change(one, other).shared_inputs == ("b.tif",)
    moved = psf(sigma_x_px=0.9, provenance=measured_on("a", "b"))
    change = psf_change(one, moved)
    assert change.changed == ()
    assert change.verdict.startswith("no verdict: both are calibrations of the same captures")


def test_calibrations_that_share_the_cameras_noise_alone_are_independent() -> None:
    one = psf(provenance=measured_on("a"))
    moved = psf(sigma_x_px=0.9, provenance=measured_on("c"))
    change = psf_change(one, moved)
    assert change.shared_inputs == ()
    assert [parameter.name for parameter in change.changed] == ["sigma_x_px"]


def test_the_focus_repeats_by_what_variances_scatter_beyond_their_errors() -> None:
    # By hand: mean variances 0.5650 and 0.5978, each with an error of hypot(0.8 * 0.003,
    # 0.7 * 0.004) px^2; two values that are d apart have the variance d^2 / 2.
    found = known(focus_repeatability([psf(), psf(sigma_x_px=0.84)]))
    first_px4 = (0.8 * 0.003) ** 2 + (0.7 * 0.004) ** 2
    second_px4 = (0.84 * 0.003) ** 2 + (0.7 * 0.004) ** 2
    expected_px4 = 0.0328**2 / 2 - (first_px4 + second_px4) / 2
    assert found.scatter_px2 == pytest.approx(sqrt(expected_px4), rel=1e-3)
    assert found.calibrations == 2
    assert found.p_value == pytest.approx(
        erfc(0.0328 / sqrt(2 * (first_px4 + second_px4))), rel=1e-6
    )
    assert str(found).startswith("focus scatter between 2 calibrations: 0.0229 ±")


def test_equal_calibrations_show_no_scatter_of_the_focus() -> None:
    found = known(focus_repeatability([psf(), psf(), psf(method="paper", sigma_x_px=0.9)]))
    assert found.scatter_px2 == 0
    assert found.calibrations == 2
    assert found.p_value == 1


def test_one_calibration_tells_no_repeatability() -> None:
    assert focus_repeatability([psf()]) is None
    assert focus_repeatability([psf(), psf(sigma_y_px=None)]) is None
    assert focus_repeatability([]) is None


def test_a_width_that_one_does_not_determine_is_left_out_and_named() -> None:
    whole = PsfCalibration(sigma_x_px=0.8, sigma_x_err_px=0.01, sigma_y_px=0.7, sigma_y_err_px=0.01)
    horizontal = PsfCalibration(sigma_y_px=0.7, sigma_y_err_px=0.01)
    change = psf_change(whole, horizontal)
    assert [one.name for one in change.parameters] == ["sigma_y_px"]
    assert change.remarks == ("not compared: the second does not determine sigma_x_px",)
    both = "the first does not determine sigma_x_px; the second does not determine sigma_x_px"
    assert psf_change(horizontal, horizontal).remarks == (f"not compared: {both}",)


@pytest.mark.parametrize("others", [{}, {"rho": 0.1, "rho_err": 0.01}, {"optical_rho": 0.0}])
def test_without_a_width_of_both_there_is_nothing_to_compare(others: dict[str, float]) -> None:
    widths = {"sigma_x_px": 0.8, "sigma_x_err_px": 0.01}, {"sigma_y_px": 0.7, "sigma_y_err_px": 0.0}
    vertical, horizontal = (PsfCalibration.model_validate(one | others) for one in widths)
    with pytest.raises(CalibrationError) as refused:
        psf_change(vertical, horizontal)
    said = str(refused.value)
    assert "the first does not determine sigma_y_px" in said
    assert "the second does not determine sigma_x_px" in said
    assert "the second has no standard error of sigma_y_px" in said


PSF = PsfCalibration(
    sigma_x_px=0.8,
    sigma_x_err_px=0.01,
    sigma_y_px=0.7,
    sigma_y_err_px=0.02,
    rho=0.1,
    rho_err=0.03,
)


def test_the_errors_of_widths_become_steps_of_a_standard_error() -> None:
    steps = known(psf_steps(PSF, PSF.total_psf("psf"), 2.0))
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
    joint = PSF.model_copy(update={"rho": None, "rho_err": None, "estimate_covariance": together})
    steps = known(psf_steps(joint, joint.total_psf("psf"), 2.0))
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
    steps = known(psf_steps(calibration, calibration.best_psf("psf"), 1.5))
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
    steps = known(psf_steps(calibration, fit.total, 2.0))
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
