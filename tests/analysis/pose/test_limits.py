"""The coarsest sampling in the overlap of two poses, and follow-ups aimed elsewhere."""

from math import cos, radians, sin, tan

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from analysis.pose import ViewingCamera, limits_of_curve
from analysis.pose._limits import local_sampling, worst_zoom
from tests.analysis.detectability.test_curves import on_zooms

CAMERA = ViewingCamera(focal_length_px=800.0, width_px=640, height_px=480)
MIDDLE = np.array([319.5, 239.5])
CURVE = on_zooms([1.0, 1.5, 2.0], [6.0, 3.0, 1.0])

places_px = st.tuples(st.floats(100, 540), st.floats(100, 380))


@given(places_px, st.floats(1.0, 2.0), st.floats(0, 25), st.floats(-20, 20), st.floats(0, 360))
@settings(deadline=None, max_examples=50)
def test_the_middle_of_the_follow_up_shows_what_it_is_aimed_at(
    aim_px: tuple[float, float], zoom: float, tilt_deg: float, reference_deg: float, lean_deg: float
) -> None:
    matrix = CAMERA.followup_to_reference(zoom, tilt_deg, reference_deg, lean_deg, aim_px)
    seen = matrix @ np.array([*MIDDLE, 1.0])
    np.testing.assert_allclose(seen[:2] / seen[2], aim_px, atol=1e-7)


@given(places_px, st.floats(1.0, 2.0))
@settings(deadline=None, max_examples=30)
def test_a_sideways_move_leaves_the_sampling_and_shrinks_the_overlap(
    aim_px: tuple[float, float], zoom: float
) -> None:
    matrix = CAMERA.followup_to_reference(zoom, 0.0, aim_px=aim_px)
    shift = np.array(aim_px) - zoom * MIDDLE
    expected = [[zoom, 0.0, shift[0]], [0.0, zoom, shift[1]], [0.0, 0.0, 1.0]]
    np.testing.assert_allclose(matrix, expected, atol=1e-7)
    assert worst_zoom(CAMERA, zoom, 0.0, aim_px=aim_px) == pytest.approx(zoom, rel=1e-9)


def test_a_camera_that_turns_in_its_place_is_a_rotation() -> None:
    # It looks at a point by t to the side: 1 / cos(t) as far away, leaning by t; the homography of
    # a rotation is K R K^-1, whatever the plane.
    turn = radians(12.0)
    aim_px = (MIDDLE[0] + 800.0 * tan(turn), MIDDLE[1])
    k = np.array([[800.0, 0.0, MIDDLE[0]], [0.0, 800.0, MIDDLE[1]], [0.0, 0.0, 1.0]])
    rotation = np.array(
        [[cos(turn), 0.0, sin(turn)], [0.0, 1.0, 0.0], [-sin(turn), 0.0, cos(turn)]]
    )
    expected = k @ rotation @ np.linalg.inv(k)
    matrix = CAMERA.followup_to_reference(1 / cos(turn), 12.0, 0.0, 0.0, aim_px)
    np.testing.assert_allclose(matrix, expected / expected[2, 2], atol=1e-6)


def test_a_tilted_reference_and_a_follow_up_beside_it_are_composed_of_two_poses() -> None:
    # Worked from rays: pixel -> ray -> plane -> pixel, with rotation matrices of its own.
    aim_px, zoom, near_deg, far_deg = (400.0, 200.0), 1.3, 15.0, 10.0

    def axes(lean_deg: float) -> np.ndarray:
        t = radians(lean_deg)
        return np.array([[cos(t), 0.0, sin(t)], [0.0, 1.0, 0.0], [-sin(t), 0.0, cos(t)]])

    near, far = axes(near_deg), axes(far_deg)
    near_pupil = -near[:, 2]
    ray = near @ np.array([(aim_px[0] - MIDDLE[0]) / 800.0, (aim_px[1] - MIDDLE[1]) / 800.0, 1.0])
    aimed = near_pupil - ray * near_pupil[2] / ray[2]
    far_pupil = aimed - zoom * far[:, 2]
    matrix = CAMERA.followup_to_reference(zoom, far_deg, near_deg, 0.0, aim_px)
    for pixel in ((0.0, 0.0), (630.0, 20.0), (300.0, 470.0)):
        ray = far @ np.array([(pixel[0] - MIDDLE[0]) / 800.0, (pixel[1] - MIDDLE[1]) / 800.0, 1.0])
        seen = near.T @ (far_pupil - ray * far_pupil[2] / ray[2] - near_pupil)
        expected = 800.0 * seen[:2] / seen[2] + MIDDLE
        found = matrix @ np.array([*pixel, 1.0])
        np.testing.assert_allclose(found[:2] / found[2], expected, atol=1e-6)


@pytest.mark.slow
@given(places_px, st.floats(1.0, 1.5), st.floats(1, 25), st.sampled_from([0.0, 15.0]))
@settings(deadline=None, max_examples=20)
def test_no_direction_of_a_lean_is_worse_than_the_worst(
    aim_px: tuple[float, float], zoom: float, tilt_deg: float, reference_deg: float
) -> None:
    worst = worst_zoom(CAMERA, zoom, tilt_deg, reference_deg, aim_px=aim_px)
    around = [
        worst_zoom(CAMERA, zoom, tilt_deg, reference_deg, b, aim_px) for b in range(0, 360, 7)
    ]
    assert max(around) <= worst * (1 + 2e-3)


def test_aiming_at_the_middle_changes_nothing() -> None:
    plain = limits_of_curve(CURVE, 2.0, CAMERA, 10.0)
    aimed = limits_of_curve(CURVE, 2.0, CAMERA, 10.0, aim_px=(319.5, 239.5))
    assert aimed.tilt_deg == pytest.approx(plain.tilt_deg)
    assert dict(aimed.zoom_by_tilt)[10.0] == pytest.approx(dict(plain.zoom_by_tilt)[10.0], rel=1e-3)
    assert aimed.aimed_overlap == pytest.approx(1.0)


def test_a_follow_up_beside_its_reference_may_go_back_as_far_with_less_overlap() -> None:
    found = limits_of_curve(CURVE, 2.0, CAMERA, aim_px=(319.5 + 160, 239.5 + 48))
    assert dict(found.zoom_by_tilt)[0.0] == pytest.approx(found.zoom, abs=1e-6)
    # Three quarters of the width, nine tenths of the height; places are 4 px apart.
    assert found.aimed_overlap == pytest.approx(0.75 * 0.9, abs=0.01)


def test_limits_and_the_map_of_the_same_pose_agree() -> None:
    aim_px, reference_deg = (420.0, 180.0), 8.0
    found = limits_of_curve(CURVE, 2.0, CAMERA, reference_deg, 30.0, aim_px)
    zoom = dict(found.zoom_by_tilt)[15.0]
    assert zoom is not None
    matrix = CAMERA.followup_to_reference(zoom, 15.0, reference_deg, 30.0, aim_px)
    sampled = local_sampling(matrix, CAMERA.size, CAMERA.size, step_px=1)
    least = np.nanmin(CURVE.d_prime_at(sampled.worst_zoom[sampled.inside]))
    assert least == pytest.approx(2.0, rel=0.01)


def test_what_the_reference_does_not_show_cannot_be_aimed_at() -> None:
    with pytest.raises(ValueError, match="must lie in the reference of 640 x 480 px"):
        CAMERA.aimed_at((700.0, 100.0))
    with pytest.raises(ValueError, match="horizon"):
        CAMERA.aimed_at((639.0, 100.0), 75.0)


zooms = st.floats(1.0, 1.6)
tilts_deg = st.floats(0.0, 30.0)
reference_tilts_deg = st.sampled_from([0.0, 10.0, -10.0, 25.0])
directions_deg = st.floats(0.0, 360.0)


def test_a_frame_seen_whole_is_coarsest_at_its_far_end() -> None:
    # The reference sees more than the follow-up from half the distance: A = z cos(t) diag(k^2, k)
    # with k = cos(a) / cos(a + t) at the frame's end, a = atan(319.5 / 800).
    lean, end = radians(8.0), np.arctan(319.5 / 800.0)
    closed = 0.5 * cos(lean) * (cos(end) / cos(end + lean)) ** 2
    # In the frame's corners the sampling is turned, and a little coarser still.
    found = worst_zoom(CAMERA, 0.5, 8.0, direction_deg=0.0)
    assert closed <= found <= closed * 1.02


def test_a_straight_move_back_is_its_own_worst_zoom() -> None:
    assert worst_zoom(CAMERA, 1.7, 0.0) == pytest.approx(1.7, rel=1e-12)


def test_what_only_the_follow_up_sees_does_not_count() -> None:
    lean, end = radians(8.0), np.arctan(319.5 / 800.0)
    closed = cos(lean) * (cos(end) / cos(end + lean)) ** 2
    assert 1.0 < worst_zoom(CAMERA, 1.0, 8.0, direction_deg=0.0) < closed


def test_a_horizon_in_the_frame_is_beyond_any_zoom() -> None:
    assert worst_zoom(CAMERA, 1.0, 72.0) == np.inf
    assert worst_zoom(CAMERA, 1.0, 60.0, direction_deg=90.0) < np.inf


@pytest.mark.slow
@given(zooms, tilts_deg, reference_tilts_deg, directions_deg)
@settings(deadline=None)
def test_no_place_of_the_overlap_is_sampled_more_coarsely(
    zoom: float, tilt_deg: float, reference_tilt_deg: float, direction_deg: float
) -> None:
    matrix = CAMERA.followup_to_reference(zoom, tilt_deg, reference_tilt_deg, direction_deg)
    sampled = local_sampling(matrix, CAMERA.size, CAMERA.size, step_px=4)
    coarsest = sampled.worst_zoom[sampled.inside].max()
    found = worst_zoom(CAMERA, zoom, tilt_deg, reference_tilt_deg, direction_deg)
    # Places 4 px apart come within 4 px of the overlap's corner.
    assert coarsest <= found * (1 + 1e-9)
    assert found <= coarsest * 1.05


@pytest.mark.slow
@given(zooms, tilts_deg, reference_tilts_deg, directions_deg)
@settings(deadline=None)
def test_no_direction_is_worse_than_the_worst(
    zoom: float, tilt_deg: float, reference_tilt_deg: float, direction_deg: float
) -> None:
    worst = worst_zoom(CAMERA, zoom, tilt_deg, reference_tilt_deg)
    there = worst_zoom(CAMERA, zoom, tilt_deg, reference_tilt_deg, direction_deg)
    # Directions between those that are tried exceed them by next to nothing.
    assert there <= worst * 1.0001


@pytest.mark.slow
def test_the_worst_direction_is_one_that_exists() -> None:
    around = [worst_zoom(CAMERA, 1.3359375, 21.0, -10.0, b) for b in np.arange(0, 360, 0.5)]
    assert worst_zoom(CAMERA, 1.3359375, 21.0, -10.0) == pytest.approx(max(around), rel=1e-4)


def test_a_lean_and_its_mirror_image_sample_alike() -> None:
    for direction in (0.0, 37.0, 90.0):
        values = [
            worst_zoom(CAMERA, 1.2, 12.0, 0.0, b)
            for b in (direction, -direction, 180 - direction, 180 + direction)
        ]
        np.testing.assert_allclose(values, values[0], rtol=1e-9)


def test_many_directions_at_once_are_each_alone() -> None:
    directions = np.array([0.0, 40.0, 275.0])
    together = CAMERA.followup_to_reference(1.3, 12.0, -7.0, directions)
    for matrix, direction in zip(together, directions, strict=True):
        alone = CAMERA.followup_to_reference(1.3, 12.0, -7.0, direction)
        np.testing.assert_allclose(matrix, alone, rtol=1e-13)
