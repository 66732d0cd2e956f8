"""Scenes with depth beside closed forms of pinhole cameras."""

from functools import cache
from math import pi, radians, tan

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.ndimage import binary_dilation, map_coordinates

from benchmarks.truth.depth import DepthPair, DepthScene, Hill, Plate, View, depth_pair
from benchmarks.truth.pairs import SAMPLES_PER_PX, FlatScene
from simulation.arrays import FloatArray

FRAME = (60, 90)
ROWS, COLS = FRAME
FOCAL_PX = DISTANCE_PX = 1200.0
HEIGHT_PX = 300.0
HILLS = (
    Hill(x_px=-15.0, y_px=-5.0, sigma_px=18.0, height_px=40.0),
    Hill(x_px=20.0, y_px=10.0, sigma_px=14.0, height_px=-15.0),
)
LEANING = View(
    distance_px=1350.0, x_px=4.0, y_px=-3.0, tilt_deg=9.0, bearing_deg=35.0, roll_deg=4.0
)


def waves(phase: float) -> FlatScene:
    """Waves of 11 to 17 px around the frame; coefficients of a spline hardly differ from levels."""
    margin = 60
    rows, cols = (np.arange(-margin * SAMPLES_PER_PX, (n + margin) * SAMPLES_PER_PX) for n in FRAME)
    x, y = np.meshgrid(cols / SAMPLES_PER_PX, rows / SAMPLES_PER_PX)
    levels = 110 + 20 * np.sin(2 * pi * x / 11 + phase) + 20 * np.sin(2 * pi * (x + y) / 17 - phase)
    return FlatScene(
        name="waves",
        coefficients=(levels + 20 * np.sin(2 * pi * y / 13)).astype(np.float32),
        origin_px=(float(margin), float(margin)),
    )


@cache
def ground() -> FlatScene:
    return waves(0.0)


def plate(*, is_round: bool = False, x_px: float = 0.0, height_px: float = HEIGHT_PX) -> Plate:
    return Plate(
        x_px=x_px,
        y_px=0.0,
        half_width_px=14.0,
        half_height_px=12.0,
        is_round=is_round,
        height_px=height_px,
        texture=waves(2.0),
    )


def made_of(plates: tuple[Plate, ...] = (), hills: tuple[Hill, ...] = ()) -> DepthScene:
    return DepthScene(ground=ground(), plates=plates, hills=hills, frame=FRAME)


def pixels() -> tuple[FloatArray, FloatArray]:
    y, x = np.meshgrid(np.arange(float(ROWS)), np.arange(float(COLS)), indexing="ij")
    return x, y


def aside(baseline_px: float, made: DepthScene) -> DepthPair:
    """From two cameras of one height, side by side, both looking straight down."""
    return depth_pair(made, View(), View(x_px=baseline_px))


def inner(pair: DepthPair, off: int) -> FloatArray:
    """Pixels that are seen in both, and further than ``off`` from jumps and borders."""
    steps = np.hypot(*np.gradient(pair.height_px)) > 5
    away = ~binary_dilation(steps | ~pair.is_seen, iterations=off)
    away[:off], away[-off:], away[:, :off], away[:, -off:] = False, False, False, False
    return np.asarray(away)


@pytest.mark.parametrize("baseline_px", [-16.0, 5.0, 12.0])
def test_a_plate_has_the_parallax_of_similar_triangles(baseline_px: float) -> None:
    pair = aside(baseline_px, made_of((plate(),)))
    above = pair.height_px == HEIGHT_PX
    parallax = FOCAL_PX * baseline_px * HEIGHT_PX / (DISTANCE_PX * (DISTANCE_PX - HEIGHT_PX))
    moved_y, moved_x = pair.places_px - pair.plane_px
    assert above.any()
    np.testing.assert_allclose(moved_x[above], parallax, atol=1e-9)
    np.testing.assert_allclose(moved_x[~above], 0.0, atol=1e-9)
    np.testing.assert_allclose(moved_y, 0.0, atol=1e-9)
    x, _ = pixels()
    np.testing.assert_allclose(pair.plane_px[1] - x, baseline_px, atol=1e-9)


@pytest.mark.parametrize("baseline_px", [-16.0, 12.0])
def test_a_plate_hides_a_strip_as_wide_as_its_parallax(baseline_px: float) -> None:
    pair = aside(baseline_px, made_of((plate(),)))
    width = abs(FOCAL_PX * baseline_px * HEIGHT_PX / (DISTANCE_PX * (DISTANCE_PX - HEIGHT_PX)))
    row = ROWS // 2
    on_plate = np.flatnonzero(pair.height_px[row] == HEIGHT_PX)
    inside = (pair.places_px[1, row] > -0.5) & (pair.places_px[1, row] < COLS - 0.5)
    hidden = np.flatnonzero(inside & ~pair.is_seen[row])
    # Both ends of the strip lie between pixels.
    assert abs(len(hidden) - width) <= 1
    assert np.all(np.diff(hidden) == 1)
    # From the right of the reference's camera more is seen on the right of the plate.
    assert hidden[0] == on_plate[-1] + 1 if baseline_px > 0 else hidden[-1] == on_plate[0] - 1


def test_of_two_plates_the_higher_hides_the_lower_in_any_order() -> None:
    high, low = plate(), plate(x_px=25.0, height_px=50.0)
    found = [made_of(both).points(View(), *pixels())[0][2] for both in ((high, low), (low, high))]
    np.testing.assert_array_equal(*found)
    # Both cover this place, and the plates alone these.
    columns = [COLS // 2 + 14, COLS // 2, COLS // 2 + 30, COLS // 2 - 30]
    assert found[0][ROWS // 2, columns].tolist() == [HEIGHT_PX, HEIGHT_PX, 50.0, 0.0]


@given(
    tilt_deg=st.floats(0.0, 30.0),
    bearing_deg=st.floats(0.0, 360.0),
    roll_deg=st.floats(-180.0, 180.0),
    distance_px=st.floats(700.0, 2000.0),
)
def test_a_camera_looks_where_it_says_from_where_it_says(
    tilt_deg: float, bearing_deg: float, roll_deg: float, distance_px: float
) -> None:
    view = View(
        distance_px=distance_px,
        x_px=7.0,
        y_px=-4.0,
        tilt_deg=tilt_deg,
        bearing_deg=bearing_deg,
        roll_deg=roll_deg,
    )
    middle = np.array([(COLS - 1) / 2]), np.array([(ROWS - 1) / 2])
    points, _ = made_of().points(view, *middle)
    np.testing.assert_allclose(points[:, 0], [7.0, -4.0, 0.0], atol=1e-9)
    apart = points[:, 0] - view.centre
    assert -apart[2] == pytest.approx(distance_px)
    assert np.hypot(*apart[:2]) == pytest.approx(
        distance_px * tan(radians(tilt_deg)), rel=1e-9, abs=1e-9
    )
    np.testing.assert_allclose(view.rotation @ view.rotation.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("view", [View(), View(x_px=-70.0), LEANING])
def test_what_a_pixel_sees_lies_on_the_hills_and_is_projected_to_it(view: View) -> None:
    x, y = pixels()
    points, _ = made_of(hills=HILLS).points(view, x, y)
    height = sum(
        one.height_px
        * np.exp(
            -((points[0] - one.x_px) ** 2 + (points[1] - one.y_px) ** 2) / (2 * one.sigma_px**2)
        )
        for one in HILLS
    )
    # 40 rounds whose slopes times obliqueness stay below .5 leave 1e-9 px at most.
    np.testing.assert_allclose(points[2], height, atol=1e-8)
    np.testing.assert_allclose(view.pixels(points, FRAME), (x, y), atol=1e-8)


def test_a_point_of_a_hill_is_one_point_in_both_views() -> None:
    made = made_of(hills=HILLS)
    pair = depth_pair(made, View(), LEANING)
    seen = pair.is_seen
    there = pair.places_px[1][seen], pair.places_px[0][seen]
    again, _ = made.points(View(), *there)
    x, y = LEANING.pixels(again, FRAME)
    expected_x, expected_y = pixels()
    # By the tolerance with which heights are said to be the same, times the obliqueness.
    np.testing.assert_allclose(x, expected_x[seen], atol=1e-3)
    np.testing.assert_allclose(y, expected_y[seen], atol=1e-3)
    assert seen.mean() > 0.7


def test_a_flat_scene_lies_where_its_plane_does_and_hides_nothing() -> None:
    pair = depth_pair(made_of(), View(), LEANING)
    np.testing.assert_array_equal(pair.places_px, pair.plane_px)
    y, x = pair.places_px
    inside = (x > -0.5) & (x < COLS - 0.5) & (y > -0.5) & (y < ROWS - 0.5)
    np.testing.assert_array_equal(pair.is_seen, inside)
    assert not pair.height_px.any()


@pytest.mark.parametrize(
    ("plates", "hills"), [((plate(),), ()), ((), HILLS)], ids=["plate", "hills"]
)
def test_the_reference_at_the_true_places_is_the_follow_up(
    plates: tuple[Plate, ...], hills: tuple[Hill, ...]
) -> None:
    pair = aside(16.0, made_of(plates, hills))
    counts = inner(pair, 5)
    left, moved = (
        (map_coordinates(pair.reference_dn, places, order=3) - pair.followup_dn)[counts]
        for places in (pair.places_px, pair.plane_px)
    )
    assert np.count_nonzero(counts) > 1000
    # Level plates are as sharp in both. The slope of a hill, 1.4, times the baseline's share, .013,
    # stretches one photograph's waves by .018; of their 60 DN the lens takes 8 %, here twice .018
    # times that more or less: .17 DN.
    assert np.abs(left).max() < (0.01 if plates else 0.2)
    assert np.std(moved) > 10 * np.std(left)
