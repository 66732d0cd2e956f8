"""What pixels see beside projections written out."""

from math import cos, radians, sin

import numpy as np
import pytest

from hil_mocks.benchmark_set._scenes import REFERENCE_DISTANCE_MM, Bump, Pose

SHAPE = (90, 120)
X, Y = np.array([3.0, 70.5, 118.0]), np.array([80.0, 44.5, 2.0])


def test_a_pose_without_motion_sees_each_point_at_its_pixel_through_any_lens() -> None:
    pose = Pose(reference_shape=SHAPE, followup_shape=SHAPE, k1=-0.05)
    u, v = pose.reference_points(X, Y)
    assert u == pytest.approx(X, abs=1e-9)
    assert v == pytest.approx(Y, abs=1e-9)


def test_a_zoom_with_shift_scales_about_the_middles_of_both_frames() -> None:
    pose = Pose(reference_shape=SHAPE, followup_shape=(30, 40), zoom=2.0, shift_px=(5.0, -3.0))
    u, v = pose.reference_points(np.array([19.5 + 10]), np.array([14.5 + 4]))
    assert u == pytest.approx([59.5 + 5 + 20])
    assert v == pytest.approx([44.5 - 3 + 8])


def test_a_camera_that_is_rolled_sees_the_scene_turn_back() -> None:
    pose = Pose(reference_shape=SHAPE, followup_shape=SHAPE, roll_deg=30.0)
    u, v = pose.reference_points(np.array([59.5 + 10]), np.array([44.5]))
    assert (u[0] - 59.5, v[0] - 44.5) == pytest.approx((10 * cos(radians(30)), 5.0))


def test_distortion_moves_a_corner_out_by_its_share() -> None:
    pose = Pose(reference_shape=SHAPE, followup_shape=SHAPE, zoom=2.0, k1=0.06)
    # The ideal radius that is seen at half the diagonal, twice as far for the reference.
    ideal = np.roots([0.06, 0, 1, -0.5])[-1].real
    seen = 2 * ideal * (1 + 0.06 * (2 * ideal) ** 2)
    u, v = pose.reference_points(np.array([59.5 * 1.5]), np.array([44.5 * 1.5]))
    assert u == pytest.approx([59.5 * (1 + seen)])
    assert v == pytest.approx([44.5 * (1 + seen)])


def test_what_stands_out_is_seen_where_its_ray_meets_the_sensor() -> None:
    """A point above the plane, projected into the tilted camera step by step."""
    bump = Bump(x_px=70.0, y_px=40.0, sigma_px=15.0, height_mm=9.0)
    pose = Pose(
        reference_shape=SHAPE,
        followup_shape=SHAPE,
        zoom=1.5,
        tilt_deg=12.0,
        bearing_deg=0.0,
        relief=(bump,),
    )
    focal = 1.24 * 120
    # As the reference sees the point: pixel, depth, position in mm.
    x, y = 74.0, 47.0
    height = 9.0 * np.exp(-((x - 70) ** 2 + (y - 40) ** 2) / (2 * 15**2))
    depth = REFERENCE_DISTANCE_MM - height
    point = np.array([(x - 59.5) / focal * depth, (y - 44.5) / focal * depth, depth])
    # The follow-up's axis leans to +x and meets the plane below the reference.
    t = radians(12)
    pupil = np.array([0, 0, REFERENCE_DISTANCE_MM])
    pupil = pupil - 1.5 * REFERENCE_DISTANCE_MM * np.array([sin(t), 0, cos(t)])
    ray = point - pupil
    across, along = ray[0] * cos(t) - ray[2] * sin(t), ray[0] * sin(t) + ray[2] * cos(t)
    seen_x, seen_y = 59.5 + focal * across / along, 44.5 + focal * ray[1] / along
    u, v = pose.seen_by_followup(np.array([seen_x]), np.array([seen_y]))
    assert (u[0], v[0]) == pytest.approx((x, y), abs=1e-4)
    # And the plane's point on that ray is another one.
    assert abs(pose.on_plane(np.array([seen_x]), np.array([seen_y]))[0][0] - x) > 0.5
