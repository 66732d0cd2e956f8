"""The lens's transfer against closed forms and a pupil's autocorrelation, and its correction."""

from math import acos, inf, nan, pi, sqrt

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from simulation.psf.lens import (
    CORRECTION_KNOTS_CY_PER_PX,
    CORRECTION_SPLINES,
    LensOtf,
    OtfCorrection,
    _pupil_otf,
    correction_harmonics,
    correction_roughness,
    correction_splines,
    pupil_slopes,
)
from tests.calibration.lens_edges import AstigmaticLens, pupil_transfer

waves = st.floats(-2, 2)
periods = st.floats(0.2, 4)


def test_a_pupil_in_focus_has_the_transfer_of_two_overlapping_circles() -> None:
    # Closed form: Goodman, "Introduction to Fourier Optics", section 6.3.2.
    for nu in (0.0, 0.1, 0.5, 0.9, 0.999, 1.0):
        expected = 2 / pi * (acos(nu) - nu * sqrt(1 - nu**2))
        # Interpolated in a table of 1025 values.
        assert float(_pupil_otf(np.array(nu), 0.0)) == pytest.approx(expected, abs=1e-9)


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
        assert _pupil_otf(nu, defocus) == pytest.approx(expected, abs=3e-4)


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


@pytest.mark.slow
@settings(max_examples=25)
@given(nu=st.floats(0.01, 0.99), low=st.floats(0, 2), more=st.floats(0, 4))
def test_between_tables_a_pupil_is_what_each_table_says(nu: float, low: float, more: float) -> None:
    at = low + more * np.linspace(0, 1, 7)
    each = [float(_pupil_otf(np.array(nu), one)) for one in at.tolist()]
    assert _pupil_otf(np.full(7, nu), at) == pytest.approx(each, abs=1e-7)


def test_defocus_turns_the_sign_of_the_contrast() -> None:
    assert float(_pupil_otf(np.array(0.4), 0.7)) < -0.01


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


NU = np.linspace(0.0, 1.2, 61)


@pytest.mark.parametrize("waves", [0.0, 0.3, 1.0, 2.5])
def test_the_pupils_transfer_is_hopkins_integral(waves: float) -> None:
    np.testing.assert_allclose(_pupil_otf(NU, waves), pupil_transfer(NU, waves), atol=1e-8)


@pytest.mark.parametrize("waves", [0.0, 0.3, 1.0, 2.0, 5.0])
def test_the_slopes_are_differences_of_the_transfer(waves: float) -> None:
    slopes = pupil_slopes(NU, np.array([waves**2]))
    np.testing.assert_allclose(slopes.otf, _pupil_otf(NU, waves), atol=3e-5)
    # At 0 and at the cut-off the curve has a corner or a half power: differences straddle it.
    inner = (NU > 0.01) & (abs(NU - 1) > 0.01)
    step = 1e-4
    by_freq = (_pupil_otf(NU + step, waves) - _pupil_otf(abs(NU - step), waves)) / (2 * step)
    np.testing.assert_allclose(slopes.by_freq[inner], by_freq[inner], atol=1e-3)
    above, below = waves**2 + step, max(waves**2 - step, 0.0)
    change = _pupil_otf(NU, float(np.sqrt(above))) - _pupil_otf(NU, float(np.sqrt(below)))
    by_defocus = change / (above - below)
    # One-sided at 0, where the second derivative is of the order of 10: hence 1e-3.
    np.testing.assert_allclose(slopes.by_defocus_waves2, by_defocus, atol=1e-3)


coefficients = st.lists(
    st.lists(st.floats(-1, 1), min_size=CORRECTION_SPLINES, max_size=CORRECTION_SPLINES),
    min_size=1,
    max_size=5,
).filter(lambda rows: len(rows) in (1, 3, 5))


@settings(max_examples=50)
@given(rows=coefficients, fx=st.floats(-2, 2), fy=st.floats(-2, 2))
def test_a_correction_is_even_and_nothing_at_0_and_beyond_the_last_knot(
    rows: list[list[float]], fx: float, fy: float
) -> None:
    lens = LensOtf(correction=OtfCorrection(coefficients=tuple(tuple(row) for row in rows)))
    x, y = np.array([fx, -fx, 0.0, 1.3]), np.array([fy, -fy, 0.0, 0.2])
    there, mirrored, at_zero, beyond = lens(x, y).tolist()
    assert there == pytest.approx(mirrored, abs=1e-12)
    assert at_zero == 1.0
    assert beyond == 1.0


def test_the_roughness_is_the_integral_of_the_squared_second_derivative() -> None:
    freq = np.linspace(0.0, 1.3, 13_001)
    weights = np.sin(np.arange(CORRECTION_SPLINES))
    curve = correction_splines(freq) @ weights
    bend = np.diff(curve, 2) / np.diff(freq)[0] ** 2
    expected = np.sum(bend**2) * np.diff(freq)[0]
    assert weights @ correction_roughness() @ weights == pytest.approx(
        expected, rel=3e-3
    )  # a sum of 13 000 steps


def test_the_splines_reach_the_last_knot_smoothly() -> None:
    end = float(CORRECTION_KNOTS_CY_PER_PX[-1])
    near = correction_splines(np.array([end - 1e-3]))
    assert np.abs(near).max() < 1e-6  # the cube of 1e-3 / 0.1


def test_harmonics_are_of_even_order() -> None:
    angle = np.array([0.3, 0.3 + np.pi])
    first, turned = correction_harmonics(angle, 5)
    np.testing.assert_allclose(first, turned, atol=1e-14)
    assert first[[1, 4]].tolist() == pytest.approx([np.cos(0.6), np.sin(1.2)])


@pytest.mark.parametrize(
    "rows", [((0.0,) * CORRECTION_SPLINES,) * 2, ((0.0,) * 3,), ((np.nan,) * CORRECTION_SPLINES,)]
)
def test_a_correction_that_cannot_be_is_refused(rows: tuple[tuple[float, ...], ...]) -> None:
    with pytest.raises(ValueError, match="correction"):
        OtfCorrection(coefficients=rows)
