"""A Gaussian, a lens over square pixels, two curves, and what varies over the frame, as a PSF."""

import copy
import pickle
from dataclasses import FrozenInstanceError, replace
from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given, strategies as st

from simulation import GaussianPsf, PsfField
from simulation.arrays import FloatArray
from simulation.psf.lens import LensOtf
from simulation.psf.shapes import (
    MeasuredPsf,
    SampledTransfer,
    SeparablePsf,
)
from tests.simulation.closed_form import GaussianTransfer


@given(x=st.floats(0.1, 5.0), y=st.floats(0.1, 5.0), rho=st.floats(-0.95, 0.95))
def test_a_psf_is_that_of_its_covariance(x: float, y: float, rho: float) -> None:
    found = GaussianPsf.from_covariance(
        GaussianPsf(sigma_x_px=x, sigma_y_px=y, rho=rho).covariance_px2
    )
    assert found.sigma_x_px == pytest.approx(x)
    assert found.sigma_y_px == pytest.approx(y)
    assert found.rho == pytest.approx(rho, abs=1e-12)


@pytest.mark.parametrize(
    "covariance",
    [
        [[0.5, 0.6], [0.6, 0.5]],
        [[-0.5, 0.0], [0.0, 0.5]],
        [[0.5, 0.0], [0.0, 0.0]],
        [[np.nan, 0.0], [0.0, 0.5]],
    ],
)
def test_what_is_no_covariance_is_refused(covariance: list[list[float]]) -> None:
    with pytest.raises(ValueError):
        GaussianPsf.from_covariance(np.array(covariance))


def test_widths_may_be_given_in_their_order_or_one_for_a_round_psf() -> None:
    named = GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.7, rho=0.1)
    assert GaussianPsf(0.8, 0.7, 0.1) == named
    assert hash(GaussianPsf(0.8, 0.7, 0.1)) == hash(named)
    assert GaussianPsf(sigma_px=0.8) == GaussianPsf(0.8, 0.8)
    assert eval(repr(named)) == named
    assert pickle.loads(pickle.dumps(named)) == named == copy.deepcopy(named)
    assert replace(named, rho=0.2) == GaussianPsf(0.8, 0.7, 0.2)
    with pytest.raises(FrozenInstanceError):
        named.rho = 0.0  # type: ignore[misc]  # on purpose


@pytest.mark.parametrize(
    ("widths", "said"),
    [
        ({}, "sigma_x_px: it is missing"),
        ({"sigma_x_px": 0.8}, "sigma_px="),
        ({"sigma_px": 0.8, "sigma_x_px": 0.8}, "leave the others out"),
        ({"sigma_px": 0.8, "rho": 0.1}, "leave the others out"),
    ],
)
def test_widths_that_are_missing_or_given_twice_are_named(
    widths: dict[str, float], said: str
) -> None:
    with pytest.raises(TypeError, match=said):
        GaussianPsf(**widths)


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


PSF = GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.7, rho=0.3)


def radial_field() -> PsfField:
    """0.5 (1 + u^2 + v^2) along x, 0.3 along y and 0.1 u in the correlation, on 301 x 201."""
    return PsfField(
        width_px=301,
        height_px=201,
        coefficients_px2=np.array(
            [[0.5, 0, 0, 0.5, 0, 0.5], [0, 0.1, 0, 0, 0, 0], [0.3, 0, 0, 0, 0, 0]]
        ),
    )


def test_a_field_of_degree_0_is_one_psf_everywhere() -> None:
    (xx, xy), (_, yy) = PSF.covariance_px2
    field = PsfField(width_px=30, height_px=20, coefficients_px2=np.array([[xx], [xy], [yy]]))
    covariance = field.covariance_px2(np.arange(30.0)[None, :], np.arange(20.0)[:, None])
    assert covariance.shape == (20, 30, 2, 2)
    assert covariance == pytest.approx(np.broadcast_to(PSF.covariance_px2, covariance.shape))


def test_the_corner_is_at_radius_one_and_y_counts_down_the_rows() -> None:
    field = radial_field()
    centre = field.covariance_px2(150.0, 100.0)
    assert centre == pytest.approx(np.diag([0.5, 0.3]))
    # By hand: u = 150 / hypot(150, 100) in the right column.
    u = 150 / np.hypot(150, 100)
    assert field.covariance_px2(300.0, 0.0) == pytest.approx(
        np.array([[1.0, 0.1 * u], [0.1 * u, 0.3]])
    )
    assert field.covariance_px2(0.0, 200.0)[0, 1] == pytest.approx(-0.1 * u)


def test_monomials_go_by_degree_then_by_the_power_of_v() -> None:
    for index, (power_u, power_v) in enumerate(
        [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3)]
    ):
        coefficients = np.zeros((3, 10))
        coefficients[[0, 2], 0] = 2.0
        coefficients[1, index] += 0.5
        field = PsfField(width_px=81, height_px=61, coefficients_px2=coefficients)
        # r = 50: u = 0.6, v = -0.4.
        expected = 0.5 * 0.6**power_u * (-0.4) ** power_v
        assert field.covariance_px2(70.0, 10.0)[0, 1] == pytest.approx(expected)
        assert field.degree == 3


def test_the_coefficients_are_a_copy_that_nobody_changes() -> None:
    coefficients = np.array([[0.5], [0.0], [0.5]])
    field = PsfField(width_px=30, height_px=20, coefficients_px2=coefficients)
    coefficients[0] = 9
    assert field.coefficients_px2[0, 0] == 0.5
    with pytest.raises(ValueError):
        field.coefficients_px2[0, 0] = 1


@pytest.mark.parametrize(
    "coefficients",
    [
        pytest.param(np.eye(2, 3), id="two rows"),
        pytest.param(np.array([[1, 0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0]]), id="four terms"),
        pytest.param(np.ones((3, 0)), id="no terms"),
        pytest.param(np.full((3, 1), np.nan), id="not finite"),
        pytest.param(np.array([[0.5], [0.6], [0.5]]), id="not positive definite"),
        pytest.param(
            np.array([[0.5, -1, 0], [0, 0, 0], [0.5, 0, 0]]),
            id="positive in the middle, negative in the right column",
        ),
    ],
)
def test_what_is_no_field_is_refused(coefficients: FloatArray) -> None:
    with pytest.raises(ValueError):
        PsfField(width_px=30, height_px=20, coefficients_px2=coefficients)


def test_a_frame_of_one_row_is_refused() -> None:
    with pytest.raises(ValueError):
        PsfField(width_px=30, height_px=1, coefficients_px2=np.array([[0.5], [0.0], [0.5]]))
