import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calibration.psf._otf_forms import (
    ASTIGMATIC,
    AXIAL,
    AXIAL_GAUSSIAN,
    AXIAL_TOTAL_GAUSSIAN,
    ELLIPTIC,
    GAUSSIAN,
    ROUND,
    TOTAL_GAUSSIAN,
    TWO_ELLIPSES,
    OtfForm,
    form_of,
)
from simulation.arrays import FloatArray
from simulation.psf.lens import _pupil_otf

FORMS = {
    "gaussian": (GAUSSIAN, [0.3, 0.1, 0.2]),
    "axial gaussian": (AXIAL_GAUSSIAN, [0.3, 0.2]),
    "total gaussian": (TOTAL_GAUSSIAN, [0.3, 0.1, 0.2]),
    "axial total gaussian": (AXIAL_TOTAL_GAUSSIAN, [0.3, 0.2]),
    "round": (ROUND, [0.4, 0.2, 0.1]),
    "elliptic": (ELLIPTIC, [0.5, 0.1, 0.3, 0.3, 0.05]),
    "two ellipses": (TWO_ELLIPSES, [0.5, 0.1, 0.3, 0.3, 0.05, 0.02, 0.1]),
    "astigmatic": (ASTIGMATIC, [0.4, 0.5, 0.1, 0.3, 0.05]),
    "upright cut-off": (AXIAL[0], [0.5, 0.3, 0.3, 0.05]),
    "upright defocus": (AXIAL[1], [0.4, 0.6, 0.1, 0.05]),
    "upright Gaussian": (AXIAL[2], [0.4, 0.2, 0.3, 0.05]),
}
ANGLES = np.deg2rad(np.array([3.0, 40.0, 95.0, 160.0]))


def corrected(form: OtfForm, values: list[float]) -> tuple[OtfForm, FloatArray]:
    free = form.with_correction(5)
    return free, np.concatenate([values, 0.02 * np.sin(np.arange(free.corrections))])


@pytest.mark.parametrize("name", FORMS)
def test_a_slice_is_the_lens_along_the_normal(name: str) -> None:
    form, values = FORMS[name]
    parameters = np.array(values)
    slices = form.slices(parameters, ANGLES)
    freq = np.linspace(0.0, 1.5, 16)[:, None]
    along = form.lens(parameters)(freq * np.cos(ANGLES), freq * np.sin(ANGLES))
    gauss = np.exp(-2 * np.pi**2 * freq**2 * slices.variance_px2)
    pupil = _pupil_otf(freq * slices.period_px, np.sqrt(slices.defocus_waves2))
    np.testing.assert_allclose(along, gauss * pupil, atol=1e-9)


@pytest.mark.parametrize("is_corrected", [False, True])
@pytest.mark.parametrize("name", FORMS)
def test_the_slopes_are_differences_of_the_transfer(name: str, *, is_corrected: bool) -> None:
    form, values = FORMS[name]
    parameters = np.array(values)
    if is_corrected:
        form, parameters = corrected(form, values)
    freq = np.linspace(0.05, 1.2, 7)[:, None]
    fx, fy = (freq * np.cos(ANGLES)).ravel(), (freq * np.sin(ANGLES)).ravel()
    slopes = form.otf_slopes(parameters, fx, fy)
    for k in range(parameters.size):
        step = np.zeros(parameters.size)
        step[k] = 1e-4
        above = form.lens(parameters + step)(fx, fy)
        below = form.lens(parameters - step)(fx, fy)
        # Second differences of 1e-4 and, of the defocus, the fit's coarser table.
        np.testing.assert_allclose(slopes[:, k], (above - below) / 2e-4, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("form", [TWO_ELLIPSES, ASTIGMATIC])
@settings(max_examples=60)
@given(values=st.lists(st.floats(-70, 70) | st.floats(-2, 2), min_size=7, max_size=7))
def test_bounded_parameters_are_those_of_a_lens(form: OtfForm, values: list[float]) -> None:
    bounded = form.bounded(np.array(values[: len(form.names)]))
    lens = form.lens(bounded)
    assert lens(np.zeros(1), np.zeros(1)).item() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(form.bounded(bounded), bounded, atol=1e-7)
    fx = np.linspace(-1, 1, 9)
    assert np.abs(lens(fx, 0.3 * fx)).max() <= 1 + 1e-9


@pytest.mark.parametrize("name", FORMS)
def test_a_form_is_found_again_by_its_parameters(name: str) -> None:
    form, _ = FORMS[name]
    assert form_of(form.name, form.names) is form


@pytest.mark.parametrize("form", AXIAL)
@settings(max_examples=30)
@given(values=st.lists(st.floats(-2, 2), min_size=6, max_size=6))
def test_an_upright_lens_is_bounded_as_its_parameters_are(
    form: OtfForm, values: list[float]
) -> None:
    bounded = form.bounded(np.array(values[: len(form.names)]))
    assert np.all(bounded >= form.least - 1e-12)
    lens = form.lens(bounded)
    fx = np.linspace(-1, 1, 9)
    assert np.abs(lens(fx, 0.3 * fx)).max() <= 1 + 1e-9


def test_an_unknown_form_is_refused() -> None:
    with pytest.raises(ValueError, match="no form 'round'"):
        form_of("round", ("gaussian_px2",))
