import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calibration.edges import (
    EdgeImage,
    edge_profile,
    edges_of_image,
    gaussian_mtf50,
    pixel_mtf50,
    plane_places,
)
from calibration.sharpness import lp_per_mm, lw_per_ph, reported_mtf50, with_sharpness
from calibration.sharpness._resolution import (
    _edge_place,
    _gaussian_mtf50_err,
    _with_colour_shifts,
    picture_height_px,
)
from simulation.arrays import FloatArray
from tests.calibration.closed_form import edge_image
from tests.calibration.known import known
from tests.calibration.sharpness.edges import edge_of


def test_units_are_those_of_the_standard() -> None:
    # By hand: two line widths a cycle, 480 rows; 0.25 cycles on 5 um are 50 on a millimetre.
    assert lw_per_ph(0.25, 480) == 240.0
    assert lp_per_mm(0.25, 5.0) == 50.0


@given(sigma=st.floats(0.4, 3.0), share=st.floats(1e-4, 0.1))
def test_a_frequency_inverse_to_the_width_has_its_relative_error(
    sigma: float, share: float
) -> None:
    edge = edge_of(
        sigma_px=sigma,
        sigma_err_px=share * sigma,
        optical_sigma_px=None,
        optical_sigma_err_px=None,
        mtf50_cy_per_px=gaussian_mtf50(sigma),
    )
    assert _gaussian_mtf50_err(edge) == pytest.approx(share * gaussian_mtf50(sigma), rel=1e-12)


@given(sigma=st.floats(0.2, 3.0), angle_deg=st.floats(0, 180, exclude_max=True))
def test_the_error_behind_a_pixel_is_the_slope_of_the_frequency_over_the_width(
    sigma: float, angle_deg: float
) -> None:
    normal = float(np.deg2rad(angle_deg + 90.0))
    edge = edge_of(
        angle_deg,
        optical_sigma_px=sigma,
        optical_sigma_err_px=1.0,
        mtf50_cy_per_px=pixel_mtf50(sigma, normal),
    )
    step = 1e-5
    slope = (pixel_mtf50(sigma - step, normal) - pixel_mtf50(sigma + step, normal)) / (2 * step)
    # Central differences of a root known to 1e-12 are good to 1e-7.
    assert _gaussian_mtf50_err(edge) == pytest.approx(slope, rel=1e-5)


def test_the_e_sfr_is_reported_where_it_has_an_error_and_else_the_gaussian() -> None:
    measured = edge_of(esfr_mtf50_cy_per_px=0.25, esfr_mtf50_err_cy_per_px=0.01)
    assert reported_mtf50(measured).cy_per_px == 0.25
    assert reported_mtf50(measured).is_model_free
    assert reported_mtf50(measured).reach_95_cy_per_px == pytest.approx(0.0196, abs=1e-6)
    for missing in ("esfr_mtf50_cy_per_px", "esfr_mtf50_err_cy_per_px"):
        other = reported_mtf50(measured.model_copy(update={missing: None}))
        assert other.cy_per_px == measured.mtf50_cy_per_px
        assert not other.is_model_free


def test_an_edge_gets_the_units_of_its_own_photograph() -> None:
    source = EdgeImage(name="edge", image_dn=edge_image(0.8, 5.0), pixel_pitch_um=4.0)
    [plain] = edges_of_image(source)
    [edge] = with_sharpness([plain], source)
    rows = source.image_dn.shape[0]
    assert edge.mtf50_lw_per_ph == pytest.approx(2 * rows * edge.mtf50_cy_per_px)
    assert edge.mtf50_lp_per_mm == pytest.approx(250 * edge.mtf50_cy_per_px)
    assert edge.esfr_mtf50_cy_per_px is not None
    assert edge.esfr_mtf50_lp_per_mm == pytest.approx(250 * edge.esfr_mtf50_cy_per_px)
    assert picture_height_px(edge) == pytest.approx(rows)
    assert picture_height_px(plain) is None


def test_without_a_pixel_pitch_there_are_no_line_pairs() -> None:
    source = EdgeImage(name="edge", image_dn=edge_image(0.8, 5.0))
    [edge] = with_sharpness(edges_of_image(source), source)
    assert edge.mtf50_lp_per_mm is None
    assert edge.esfr_mtf50_lp_per_mm is None
    assert edge.red_shift_px is None


SHIFTS_PX = {"red": 0.30, "green": 0.0, "blue": -0.17}
SIGMAS_PX = {"red": 0.9, "green": 0.7, "blue": 0.8}
ROWS, COLS = 90, 141


def colour_edge(normal_deg: float, x_px: float, colour: str) -> FloatArray:
    """A dark-to-bright edge behind the pixel, moved along its normal by the colour's shift."""
    y, x = np.mgrid[:ROWS, :COLS]
    normal = np.deg2rad(normal_deg)
    away = (x - x_px) * np.cos(normal) + (y - 44.5) * np.sin(normal) - SHIFTS_PX[colour]
    shape = edge_profile(away.ravel(), SIGMAS_PX[colour], normal).reshape(away.shape)
    return np.asarray(1000.0 + 3000.0 * shape)


@pytest.mark.parametrize(
    ("normal_deg", "x_px", "sign"),
    [
        (5.0, 100.3, 1.0),  # right of the centre the normal points outwards
        (5.0, 40.3, -1.0),
        (185.0, 40.3, 1.0),
        (185.0, 100.3, -1.0),
    ],
)
def test_the_shifts_of_a_colour_photograph_come_back_outwards(
    normal_deg: float, x_px: float, sign: float
) -> None:
    planes = np.dstack([colour_edge(normal_deg, x_px, c) for c in ("red", "green", "blue")])
    source = EdgeImage(name="rgb", image_dn=planes[:, :, 1].copy(), colours_dn=planes)
    [edge] = _with_colour_shifts(edges_of_image(source), source)
    assert edge.red_shift_px is not None
    assert edge.blue_shift_px is not None
    # The profile behind the pixel is symmetric: the fit's Gaussian moves no place.
    assert edge.red_shift_px == pytest.approx(sign * SHIFTS_PX["red"], abs=2e-4)
    assert edge.blue_shift_px == pytest.approx(sign * SHIFTS_PX["blue"], abs=2e-4)


def test_the_shifts_of_a_mosaic_come_back_from_its_own_pixels() -> None:
    mosaic = np.empty((ROWS, COLS))
    for place in plane_places("GRBG"):
        part = np.s_[place.first_y_px :: 2, place.first_x_px :: 2]
        mosaic[part] = colour_edge(5.0, 100.3, place.colour)[part]
    grey = EdgeImage(name="raw", image_dn=colour_edge(5.0, 100.3, "green"))
    edges = edges_of_image(grey)
    [edge] = _with_colour_shifts(edges, EdgeImage(name="raw", image_dn=mosaic, pattern="GRBG"))
    # A quarter of the pixels, at two phases of the rows: 1e-3 px of aliasing.
    assert edge.red_shift_px == pytest.approx(SHIFTS_PX["red"], abs=2e-3)
    assert edge.blue_shift_px == pytest.approx(SHIFTS_PX["blue"], abs=2e-3)


def test_a_grey_photograph_stored_in_colour_has_no_lateral_colour() -> None:
    plane = colour_edge(5.0, 100.3, "green")
    source = EdgeImage(name="grey", image_dn=plane, colours_dn=np.dstack([plane] * 3))
    [edge] = _with_colour_shifts(edges_of_image(source), source)
    assert edge.red_shift_px is None


def test_the_stated_error_of_a_place_is_the_scatter_over_noise() -> None:
    rng = np.random.default_rng(4)
    distance = np.sort(rng.uniform(-5, 5, 700))
    clean = 100.0 + 50.0 * edge_profile(distance - 0.2, 0.8)
    trials = [_edge_place(distance, clean + rng.normal(0, 1.5, 700), 0.9) for _ in range(400)]
    places, errs = np.array([trial for trial in trials if trial is not None]).T
    assert places.size == 400
    # 400 trials tell a standard deviation to 3.5 %: 4 of these.
    assert np.std(places) / np.mean(errs) == pytest.approx(1.0, abs=0.14)
    assert np.mean(places) == pytest.approx(0.2, abs=4 * np.std(places) / 20)


@settings(max_examples=40)
@given(
    shift=st.floats(-1.5, 1.5),
    sigma=st.floats(0.5, 2.5),
    guess=st.floats(0.75, 1.33),
    is_falling=st.booleans(),
)
def test_a_place_is_found_from_any_likely_start(
    shift: float, sigma: float, guess: float, is_falling: bool
) -> None:
    distance = np.linspace(-9, 9, 800)
    levels = edge_profile(distance - shift, sigma)
    found = known(_edge_place(distance, 1 - levels if is_falling else levels, guess * sigma))
    assert found[0] == pytest.approx(shift, abs=1e-5)


def test_flat_levels_have_no_place() -> None:
    rng = np.random.default_rng(1)
    assert _edge_place(np.linspace(-5, 5, 20), np.ones(20), 0.8) is None
    found = _edge_place(np.linspace(-5, 5, 500), rng.normal(0, 1, 500), 0.8)
    assert found is None or found[1] > 0.05
