"""PSFs of one's own: against closed forms, and against another way of computing them."""

import copy
import pickle
from math import pi, sqrt

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.special import j1

from simulation.arrays import FloatArray
from simulation.psf import TabulatedPsf
from simulation.zoom import zoom_out_image
from tests.calibration.lens_edges import AstigmaticLens, pupil_transfer

PERIOD_PX = 0.37
FX, FY = np.meshgrid(np.linspace(-1.2, 1.2, 31), np.linspace(-1.2, 1.2, 25))


def with_pixel(transfer: FloatArray) -> FloatArray:
    return np.asarray(transfer * np.sinc(FX) * np.sinc(FY))


@pytest.mark.parametrize("samples_per_px", [3.0, 4.0])
def test_a_sampled_gaussian_has_the_transfer_of_the_gaussian(samples_per_px: float) -> None:
    y, x = np.mgrid[:71, :81]
    kernel = np.exp(-0.5 * (((x - 33.3) / 0.8) ** 2 + ((y - 29.1) / 0.6) ** 2) / samples_per_px**2)
    psf = TabulatedPsf.from_kernel(7.0 * kernel, samples_per_px=samples_per_px)
    expected = np.exp(-2 * pi**2 * ((0.8 * FX) ** 2 + (0.6 * FY) ** 2))
    np.testing.assert_allclose(psf.otf(FX, FY), expected, atol=1e-6)
    assert psf.gaussian.sigma_x_px == pytest.approx(0.8, rel=1e-4)
    assert psf.gaussian.sigma_y_px == pytest.approx(0.6, rel=1e-4)
    assert psf.asymmetry < 1e-6


@pytest.mark.parametrize("waves", [0.0, 0.1, 0.3])
def test_defocus_by_zernike_is_that_of_a_pupil_integrated_across(waves: float) -> None:
    psf = TabulatedPsf.from_zernike({4: waves}, cut_off_period_px=PERIOD_PX)
    # Noll's term is sqrt(3) (2 r^2 - 1): the path at the rim is 2 sqrt(3) of it.
    expected = pupil_transfer(PERIOD_PX * np.hypot(FX, FY), 2 * sqrt(3) * waves)
    np.testing.assert_allclose(psf.otf(FX, FY), with_pixel(expected), atol=1e-4)


def test_astigmatism_by_zernike_is_that_of_a_pupil_integrated_across() -> None:
    psf = TabulatedPsf.from_zernike({6: 0.12, 4: 0.05}, cut_off_period_px=PERIOD_PX)
    defocus, astigmatism = 2 * sqrt(3) * 0.05, sqrt(6) * 0.12
    lens = AstigmaticLens(
        PERIOD_PX, PERIOD_PX, x_waves=defocus + astigmatism, y_waves=defocus - astigmatism
    )
    np.testing.assert_allclose(psf.otf(FX, FY), lens.otf(FX, FY), atol=1e-4)


def test_an_obscured_pupil_passes_what_two_circles_and_their_difference_pass() -> None:
    psf = TabulatedPsf.from_zernike({}, cut_off_period_px=PERIOD_PX, obscured=0.4)
    # The Airy pattern of a ring is the square of a difference of two discs' amplitudes.
    count, step_px = 801, 0.1
    place = (np.arange(count) - count // 2) * step_px
    radius = np.hypot(*np.meshgrid(place, place)) * pi / PERIOD_PX + 1e-12
    kernel = (2 * j1(radius) / radius - 0.16 * 2 * j1(0.4 * radius) / (0.4 * radius)) ** 2
    other = TabulatedPsf.from_kernel(kernel, samples_per_px=1 / step_px, has_pixel=False)
    # Tails are cut at 40 px.
    np.testing.assert_allclose(psf.otf(FX, FY), other.otf(FX, FY), atol=5e-3)


def test_a_tilted_wavefront_moves_the_picture_and_changes_no_psf() -> None:
    straight = TabulatedPsf.from_zernike({}, cut_off_period_px=PERIOD_PX)
    tilted = TabulatedPsf.from_zernike({1: 3.0, 2: 0.5, 3: -0.4}, cut_off_period_px=PERIOD_PX)
    np.testing.assert_allclose(tilted.otf(FX, FY), straight.otf(FX, FY), atol=1e-9)


def test_what_is_not_symmetric_is_left_out_and_said() -> None:
    psf = TabulatedPsf.from_zernike({8: 0.08}, cut_off_period_px=PERIOD_PX)
    assert psf.asymmetry > 0.05
    assert TabulatedPsf.from_zernike({11: 0.08}, cut_off_period_px=PERIOD_PX).asymmetry < 1e-9
    # A kernel and its mirror image have the same symmetric part.
    y, x = np.mgrid[:41, :41] - 20.0
    kernel = np.exp(-0.5 * (x**2 + y**2) / 9) * (1 + np.tanh(x))
    one = TabulatedPsf.from_kernel(kernel, samples_per_px=3)
    two = TabulatedPsf.from_kernel(kernel[::-1, ::-1], samples_per_px=3)
    assert one.asymmetry > 0.05
    np.testing.assert_allclose(one.otf(FX, FY), two.otf(FX, FY), atol=1e-9)


def test_a_function_and_a_table_of_contrast_are_taken_as_they_are() -> None:
    def transfer(fx: FloatArray, fy: FloatArray) -> FloatArray:
        return np.asarray(np.exp(-2 * pi**2 * 0.5 * (fx**2 + fy**2 + fx * fy)))

    psf = TabulatedPsf.from_otf(transfer)
    np.testing.assert_allclose(psf.otf(FX, FY), transfer(FX, FY), atol=1e-6)
    freq = np.linspace(0, 2, 101)
    table = TabulatedPsf.from_mtf(freq, np.exp(-2 * pi**2 * 0.36 * freq**2), has_pixel=False)
    expected = with_pixel(np.exp(-2 * pi**2 * 0.36 * (FX**2 + FY**2)))
    np.testing.assert_allclose(table.otf(FX, FY), expected, atol=1e-3)


@settings(max_examples=25)
@given(
    waves=st.dictionaries(st.integers(4, 15), st.floats(-0.1, 0.1), max_size=4),
    obscured=st.sampled_from([0.0, 0.2, 0.35, 0.6]),
)
def test_a_pupil_passes_1_at_zero_and_never_more_than_itself_without_aberrations(
    waves: dict[int, float], obscured: float
) -> None:
    psf = TabulatedPsf.from_zernike(waves, cut_off_period_px=PERIOD_PX, obscured=obscured)
    values = psf.otf(FX, FY)
    assert float(psf.otf(np.array(0.0), np.array(0.0))) == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(values, psf.otf(-FX, -FY), atol=1e-12)
    assert np.abs(values).max() <= 1 + 1e-3
    beyond = psf.otf(np.array(1.01 / PERIOD_PX), np.array(0.0))
    assert abs(float(beyond)) < 1e-4


def test_copies_are_equal_and_serve_the_operators() -> None:
    psf = TabulatedPsf.from_zernike({4: 0.1}, cut_off_period_px=PERIOD_PX)
    same = TabulatedPsf.from_zernike({4: 0.1}, cut_off_period_px=PERIOD_PX)
    for other in (same, copy.deepcopy(psf), pickle.loads(pickle.dumps(psf))):
        assert other == psf
        assert hash(other) == hash(psf)
    assert psf != TabulatedPsf.from_zernike({4: 0.11}, cut_off_period_px=PERIOD_PX)
    y, x = np.mgrid[:120, :120]
    image = 100 + 50 * np.sin(0.7 * x) * np.cos(0.3 * y)
    for model in ("lmmse", "matched"):
        far = zoom_out_image(image, 1.5, psf=psf, model=model)
        assert np.all(np.isfinite(far))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: TabulatedPsf.from_kernel(np.zeros((9, 9))), "sum must be positive"),
        (lambda: TabulatedPsf.from_kernel(np.ones(9)), "2 dimensions"),
        (lambda: TabulatedPsf.from_kernel(np.ones((9, 1025))), "crop it to the PSF"),
        (lambda: TabulatedPsf.from_kernel(np.full((9, 9), np.nan)), "finite"),
        (lambda: TabulatedPsf.from_kernel(np.ones((9, 9)), samples_per_px=0), "samples_per_px"),
        (lambda: TabulatedPsf.from_otf(lambda fx, fy: 2 * np.ones_like(fx)), "1 at frequency 0"),
        (lambda: TabulatedPsf.from_otf(lambda fx, fy: np.ones(3)), "one for each frequency"),
        (lambda: TabulatedPsf.from_mtf([0, 0.5], [1, 0.2]), "at least 3"),
        (lambda: TabulatedPsf.from_mtf([0, 0.2, 0.3], [1, 0.5, 0.2]), "increase from 0 to at"),
        (lambda: TabulatedPsf.from_pupil(np.ones((4, 5)), cut_off_period_px=1), "square"),
        (lambda: TabulatedPsf.from_pupil(np.zeros((4, 4)), cut_off_period_px=1), "not all 0"),
        (lambda: TabulatedPsf.from_zernike({4: np.inf}, cut_off_period_px=1), "coefficient 4"),
        (lambda: TabulatedPsf.from_zernike({0: 0.1}, cut_off_period_px=1), "Noll's numbers"),
        (lambda: TabulatedPsf.from_zernike({}, cut_off_period_px=-1), "cut_off_period_px"),
        (lambda: TabulatedPsf.from_zernike({}, cut_off_period_px=1, obscured=1), "obscured"),
    ],
)
def test_what_is_no_psf_is_refused_by_name(make: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()  # type: ignore[operator]  # one of the functions above
