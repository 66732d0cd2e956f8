"""The coarsest sampling in the overlap of two poses, and the direction of a lean that makes it."""

from math import cos, radians

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from analysis.pose.limits import ViewingCamera, local_sampling, worst_zoom

CAMERA = ViewingCamera(focal_length_px=800.0, width_px=640, height_px=480)

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


@given(zooms, tilts_deg, reference_tilts_deg, directions_deg)
@settings(deadline=None)
def test_no_direction_is_worse_than_the_worst(
    zoom: float, tilt_deg: float, reference_tilt_deg: float, direction_deg: float
) -> None:
    worst = worst_zoom(CAMERA, zoom, tilt_deg, reference_tilt_deg)
    there = worst_zoom(CAMERA, zoom, tilt_deg, reference_tilt_deg, direction_deg)
    # Directions between those that are tried exceed them by next to nothing.
    assert there <= worst * 1.0001


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
