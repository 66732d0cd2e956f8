import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calibration.edges import EdgeImage, edge_profile, measure_edges, plane_places
from calibration.sharpness.resolution import edge_place, with_colour_shifts
from simulation.arrays import FloatArray

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
    [edge] = with_colour_shifts(measure_edges(source), source)
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
    edges = measure_edges(grey)
    [edge] = with_colour_shifts(edges, EdgeImage(name="raw", image_dn=mosaic, pattern="GRBG"))
    # A quarter of the pixels, at two phases of the rows: 1e-3 px of aliasing.
    assert edge.red_shift_px == pytest.approx(SHIFTS_PX["red"], abs=2e-3)
    assert edge.blue_shift_px == pytest.approx(SHIFTS_PX["blue"], abs=2e-3)


def test_a_grey_photograph_stored_in_colour_has_no_lateral_colour() -> None:
    plane = colour_edge(5.0, 100.3, "green")
    source = EdgeImage(name="grey", image_dn=plane, colours_dn=np.dstack([plane] * 3))
    [edge] = with_colour_shifts(measure_edges(source), source)
    assert edge.red_shift_px is None


def test_the_stated_error_of_a_place_is_the_scatter_over_noise() -> None:
    rng = np.random.default_rng(4)
    distance = np.sort(rng.uniform(-5, 5, 700))
    clean = 100.0 + 50.0 * edge_profile(distance - 0.2, 0.8)
    trials = [edge_place(distance, clean + rng.normal(0, 1.5, 700), 0.9) for _ in range(400)]
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
    found = edge_place(distance, 1 - levels if is_falling else levels, guess * sigma)
    assert found is not None
    assert found[0] == pytest.approx(shift, abs=1e-5)


def test_flat_levels_have_no_place() -> None:
    rng = np.random.default_rng(1)
    assert edge_place(np.linspace(-5, 5, 20), np.ones(20), 0.8) is None
    found = edge_place(np.linspace(-5, 5, 500), rng.normal(0, 1, 500), 0.8)
    assert found is None or found[1] > 0.05
