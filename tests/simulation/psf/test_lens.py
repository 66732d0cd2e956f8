"""The lens's transfer function against closed forms and against a pupil's autocorrelation."""

from math import acos, inf, nan, pi, sqrt

import numpy as np
import pytest
from hypothesis import given, strategies as st

from simulation.psf.lens import LensOtf, pupil_otf
from tests.calibration.lens_edges import AstigmaticLens

waves = st.floats(-2, 2)
periods = st.floats(0.2, 4)


def test_a_pupil_in_focus_has_the_transfer_of_two_overlapping_circles() -> None:
    # Closed form: Goodman, "Introduction to Fourier Optics", section 6.3.2.
    for nu in (0.0, 0.1, 0.5, 0.9, 0.999, 1.0):
        expected = 2 / pi * (acos(nu) - nu * sqrt(1 - nu**2))
        # Interpolated in a table of 1025 values.
        assert float(pupil_otf(np.array(nu), 0.0)) == pytest.approx(expected, abs=1e-9)


@pytest.mark.slow
def test_a_pupil_out_of_focus_has_the_autocorrelation_of_its_phases() -> None:
    # A pupil of 800 samples across; its rim is wrong by half a sample.
    radius, size = 400, 2048
    y, x = np.mgrid[-size // 2 : size // 2, -size // 2 : size // 2] / radius
    square = x**2 + y**2
    for defocus in (0.3, 0.7, 1.5):
        pupil = (square <= 1) * np.exp(2j * pi * defocus * square)
        correlated = np.fft.ifft2(np.abs(np.fft.fft2(pupil)) ** 2)[0].real
        nu = np.array([0.05, 0.2, 0.4, 0.6, 0.8])
        expected = correlated[np.round(2 * radius * nu).astype(int)] / correlated[0]
        assert pupil_otf(nu, defocus) == pytest.approx(expected, abs=3e-4)


def test_along_its_axes_an_astigmatic_pupil_has_the_autocorrelation_of_its_phases() -> None:
    # 400 samples across: the rim is wrong by half a sample.
    radius, size = 200, 1024
    y, x = np.mgrid[-size // 2 : size // 2, -size // 2 : size // 2] / radius
    pupil = (x * x + y * y <= 1) * np.exp(2j * pi * (0.8 * x * x - 0.3 * y * y))
    correlated = np.fft.ifft2(np.abs(np.fft.fft2(pupil)) ** 2).real
    lens = LensOtf(cut_off_period_px=(1.0, 0.0, 1.0), defocus_waves2=(0.64, 0.0, 0.09))
    renderer = AstigmaticLens(1.0, 1.0, x_waves=0.8, y_waves=-0.3)
    for row, col in ((0, 40), (40, 0), (0, 150), (260, 0), (60, 60), (-50, 90), (-200, -130)):
        expected = correlated[row, col] / correlated[0, 0]
        fx, fy = np.array(col / (2 * radius)), np.array(row / (2 * radius))
        rendered = float(renderer.otf(fx, fy) / (np.sinc(fx) * np.sinc(fy)))
        assert rendered == pytest.approx(expected, abs=5e-4)
        if row * col == 0:
            assert float(lens(fx, fy)) == pytest.approx(expected, abs=5e-4)


@given(nu=st.floats(0.01, 0.99), low=st.floats(0, 2), more=st.floats(0, 4))
def test_between_tables_a_pupil_is_what_each_table_says(nu: float, low: float, more: float) -> None:
    at = low + more * np.linspace(0, 1, 7)
    each = [float(pupil_otf(np.array(nu), one)) for one in at.tolist()]
    assert pupil_otf(np.full(7, nu), at) == pytest.approx(each, abs=1e-7)


def test_defocus_turns_the_sign_of_the_contrast() -> None:
    assert float(pupil_otf(np.array(0.4), 0.7)) < -0.01


@given(xx=periods, yy=periods, share=st.floats(-0.9, 0.9), defocus=waves)
def test_a_transfer_is_1_at_zero_even_and_never_more(
    xx: float, yy: float, share: float, defocus: float
) -> None:
    lens = LensOtf(
        cut_off_period_px=(xx, share * sqrt(xx * yy), yy),
        defocus_waves2=(defocus**2, 0.0, defocus**2),
        gaussian_px2=(0.1, 0.02, 0.2),
    )
    fx, fy = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 7))
    values = lens(fx, fy)
    assert values.shape == fx.shape
    assert float(lens(np.array(0.0), np.array(0.0))) == pytest.approx(1.0, abs=1e-12)
    assert values == pytest.approx(values[::-1, ::-1])
    assert np.abs(values).max() <= 1 + 1e-9  # the autocorrelation of a pupil is largest at 0


def test_beyond_its_cut_off_a_lens_passes_nothing() -> None:
    lens = LensOtf(cut_off_period_px=(2.0, 0.0, 1.0))
    assert float(lens(np.array(0.51), np.array(0.0))) == 0.0
    assert float(lens(np.array(0.0), np.array(0.51))) > 0.1


def test_without_a_pupil_the_lens_is_its_gaussian() -> None:
    lens = LensOtf(gaussian_px2=(0.25, 0.0, 0.5))
    fx, fy = np.array(0.3), np.array(0.2)
    expected = np.exp(-2 * pi**2 * (0.25 * 0.3**2 + 0.5 * 0.2**2))
    assert float(lens(fx, fy)) == pytest.approx(float(expected), rel=1e-12)


@pytest.mark.parametrize(
    "wrong",
    [
        {"cut_off_period_px": (nan, 0.0, 1.0)},
        {"cut_off_period_px": (1.0, 2.0, 1.0)},
        {"gaussian_px2": (-0.1, 0.0, 0.1)},
        {"gaussian_px2": (0.1, inf, 0.1)},
        {"defocus_waves2": (81.0, 0.0, 81.0)},
        {"defocus_waves2": (nan, 0.0, 1.0)},
        {"defocus_waves2": (1.0, 2.0, 1.0)},
    ],
)
def test_what_no_lens_can_be_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        LensOtf(**wrong)  # type: ignore[arg-type]  # the wrong values are the point
