"""A lens over square pixels, its copies stretched over the frame, and two curves as a PSF."""

from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given, strategies as st

from simulation.arrays import FloatArray
from simulation.psf.lens import LensOtf
from simulation.psf.shapes import (
    GaussianPsf,
    MeasuredPsf,
    PsfField,
    SampledTransfer,
    SeparablePsf,
)
from tests.simulation.closed_form import GaussianTransfer

FX, FY = np.meshgrid(np.linspace(-0.5, 0.5, 11), np.linspace(-0.5, 0.5, 9))
PIXEL_PX2 = 1 / 12


def of_gaussian_optics(xx: float, xy: float, yy: float) -> MeasuredPsf:
    total = GaussianPsf.from_covariance(np.array([[xx + PIXEL_PX2, xy], [xy, yy + PIXEL_PX2]]))
    return MeasuredPsf(lens=LensOtf(gaussian_px2=(xx, xy, yy)), gaussian=total)


def exact(xx: float, xy: float, yy: float) -> FloatArray:
    gauss = np.exp(-2 * pi**2 * (xx * FX**2 + 2 * xy * FX * FY + yy * FY**2))
    return np.asarray(gauss * np.sinc(FX) * np.sinc(FY))


def test_the_pixel_is_a_factor() -> None:
    psf = of_gaussian_optics(0.2, 0.05, 0.4)
    assert psf.otf(FX, FY) == pytest.approx(exact(0.2, 0.05, 0.4), abs=1e-12)


@given(
    widths=st.tuples(st.floats(0.05, 2), st.floats(0.05, 2)),
    turn_rad=st.floats(0, pi),
)
def test_gaussian_optics_stretched_are_the_gaussian_that_was_asked_for(
    widths: tuple[float, float], turn_rad: float
) -> None:
    # Of a Gaussian, a stretch keeps no more than the covariance: closed form.
    major, minor = widths
    c, s = cos(turn_rad), sin(turn_rad)
    xx, xy, yy = (
        major * c * c + minor * s * s,
        (major - minor) * c * s,
        major * s * s + minor * c * c,
    )
    total = GaussianPsf.from_covariance(np.array([[xx + PIXEL_PX2, xy], [xy, yy + PIXEL_PX2]]))
    stretched = of_gaussian_optics(0.2, 0.05, 0.4).stretched_to(total)
    assert stretched.otf(FX, FY) == pytest.approx(exact(xx, xy, yy), abs=1e-9)
    assert stretched.gaussian == total
    # Stretched twice is stretched once.
    back = stretched.stretched_to(of_gaussian_optics(0.2, 0.05, 0.4).gaussian)
    assert back.otf(FX, FY) == pytest.approx(exact(0.2, 0.05, 0.4), abs=1e-9)


def test_a_lens_stretched_along_x_is_softer_along_x_alone() -> None:
    # The optical variances are 0.25 and 1 px^2: twice as wide along x, unchanged along y.
    near, wide = (
        GaussianPsf.from_covariance(np.diag([xx + PIXEL_PX2, 0.25 + PIXEL_PX2]))
        for xx in (0.25, 1.0)
    )
    lens = LensOtf(cut_off_period_px=(1.0, 0.0, 1.0), defocus_waves2=(0.04, 0.0, 0.04))
    psf = MeasuredPsf(lens=lens, gaussian=near)
    stretched = psf.stretched_to(wide)
    freq, none = np.linspace(0, 0.4, 9), np.zeros(9)
    assert stretched.otf(none, freq) == pytest.approx(psf.otf(none, freq), abs=1e-12)
    expected = lens(2 * freq, none) * np.sinc(freq)
    assert stretched.otf(freq, none) == pytest.approx(expected, abs=1e-12)


def test_a_field_has_the_measured_shape_everywhere() -> None:
    middle = GaussianPsf(sigma_x_px=0.6, sigma_y_px=0.6)
    shape = MeasuredPsf(lens=LensOtf(cut_off_period_px=(1.5, 0.0, 1.5)), gaussian=middle)
    coefficients = np.array([[0.36, 0, 0, 0.2, 0, 0.0], np.zeros(6), [0.36, 0, 0, 0, 0, 0.2]])
    field = PsfField(width_px=101, height_px=81, coefficients_px2=coefficients, shape=shape)
    in_the_middle = field.at(50.0, 40.0)
    assert in_the_middle.otf(FX, FY) == pytest.approx(shape.otf(FX, FY), abs=1e-9)
    corner = field.at(100.0, 40.0)
    assert corner.covariance_px2[0, 0] > middle.covariance_px2[0, 0]
    assert corner.otf(np.array(0.3), np.array(0.0)) < shape.otf(np.array(0.3), np.array(0.0))
    assert field.form == shape.form == "round"
    plain = PsfField(width_px=101, height_px=81, coefficients_px2=coefficients)
    assert plain.at(50.0, 40.0) == field.gaussian == middle


def test_two_curves_are_a_psf_by_their_product() -> None:
    freq = np.linspace(0, 1, 51)
    along_x = SampledTransfer(freq, np.exp(-2 * (pi * 0.5 * freq) ** 2))
    along_y = GaussianTransfer(sigma_px=0.8)
    gaussian = GaussianPsf(sigma_x_px=0.5, sigma_y_px=0.8)
    psf = SeparablePsf(along_y=along_y, along_x=along_x, gaussian=gaussian)
    # PCHIP between samples 0.02 cy/px apart.
    assert psf.otf(FX, FY) == pytest.approx(gaussian.otf(FX, FY), abs=1e-3)
    assert psf.form == "separable"


@pytest.mark.parametrize(
    ("lens", "form"),
    [
        (LensOtf(gaussian_px2=(0.1, 0.0, 0.2)), "gaussian"),
        (LensOtf(cut_off_period_px=(1.0, 0.0, 1.0), gaussian_px2=(0.1, 0.0, 0.1)), "round"),
        (LensOtf(cut_off_period_px=(1.0, 0.1, 1.0)), "elliptic"),
        (LensOtf(cut_off_period_px=(1.0, 0.0, 1.0), gaussian_px2=(0.1, 0.0, 0.2)), "elliptic"),
    ],
)
def test_the_form_says_what_is_known_about_the_shape(lens: LensOtf, form: str) -> None:
    psf = MeasuredPsf(lens=lens, gaussian=GaussianPsf(sigma_x_px=1.0, sigma_y_px=1.0))
    assert psf.form == form


def test_equal_psfs_are_one_key_of_a_cache() -> None:
    one, other = of_gaussian_optics(0.2, 0.0, 0.4), of_gaussian_optics(0.2, 0.0, 0.4)
    assert hash(one) == hash(other)
    assert one == other
