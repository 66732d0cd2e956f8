import numpy as np
import pytest
from hypothesis import given, strategies as st

from hil_mocks.truth.render import CameraPose, PinholeCamera, distort, undistort


def camera(k1: float = 0.0, pupil_offset_mm: float = 0.0) -> PinholeCamera:
    return PinholeCamera(
        width_px=780,
        height_px=580,
        focal_length_mm=8.0,
        pixel_pitch_um=8.3,
        pupil_offset_mm=pupil_offset_mm,
        k1=k1,
    )


@given(
    radius=st.floats(0, 1.0),
    k1=st.floats(-0.13, 0.3).filter(lambda k1: k1 == 0 or abs(k1) > 1e-12),
)
def test_undistortion_is_the_inverse_of_distortion(radius: float, k1: float) -> None:
    seen = distort(np.asarray(radius), k1)
    assert undistort(seen, k1) == pytest.approx(radius, abs=1e-9)


def test_barrel_distortion_draws_the_corner_inwards_by_k1() -> None:
    assert distort(np.asarray(1.0), -0.02) == pytest.approx(0.98)


def test_a_picture_that_folds_over_is_refused() -> None:
    with pytest.raises(ValueError):
        camera(k1=-0.2)


def test_the_scale_is_focal_length_over_distance_from_the_pupil() -> None:
    # 8 mm / 8.3 um = 963.855 px; over 212.5 mm that is 4.5358 px/mm.
    assert camera(pupil_offset_mm=12.5).scale_px_per_mm(200.0) == pytest.approx(4.53579, abs=1e-5)


def test_a_plane_that_is_behind_the_pupil_is_refused() -> None:
    with pytest.raises(ValueError):
        camera(pupil_offset_mm=-30.0).scale_px_per_mm(20.0)


def test_an_upright_camera_sees_x_to_the_right_and_y_down() -> None:
    x_px, y_px = camera().to_pixel(
        np.array([0.0, 10.0, 0.0]), np.array([0.0, 0.0, 10.0]), CameraPose(height_mm=200.0)
    )
    scale = 963.8554217 / 200
    np.testing.assert_allclose(x_px, [389.5, 389.5 + 10 * scale, 389.5])
    np.testing.assert_allclose(y_px, [289.5, 289.5, 289.5 + 10 * scale])


def test_a_camera_moved_right_sees_the_scene_move_left() -> None:
    pose = CameraPose(height_mm=200.0, offset_x_mm=5.0)
    x_px, y_px = camera().to_pixel(np.array([0.0]), np.array([0.0]), pose)
    np.testing.assert_allclose((x_px[0], y_px[0]), (389.5 - 5 * 963.8554217 / 200, 289.5))


def test_a_roll_turns_the_camera_from_x_towards_y() -> None:
    pose = CameraPose(height_mm=200.0, roll_deg=90.0)
    x_px, y_px = camera().to_pixel(np.array([0.0]), np.array([10.0]), pose)
    np.testing.assert_allclose((x_px[0], y_px[0]), (389.5 + 10 * 963.8554217 / 200, 289.5))


@pytest.mark.parametrize(("tilt_x", "tilt_y"), [(20.0, 0.0), (0.0, 20.0)])
def test_a_tilted_camera_looks_at_distance_times_tangent(tilt_x: float, tilt_y: float) -> None:
    pose = CameraPose(height_mm=200.0, tilt_x_deg=tilt_x, tilt_y_deg=tilt_y)
    x_mm, y_mm = camera().to_plane_mm(np.array([389.5]), np.array([289.5]), pose)
    reach_mm = 200 * np.tan(np.radians(20.0))
    expected = (reach_mm, 0.0) if tilt_x else (0.0, reach_mm)
    np.testing.assert_allclose((x_mm[0], y_mm[0]), expected, atol=1e-9)


@given(
    pose=st.builds(
        CameraPose,
        height_mm=st.floats(50, 500),
        offset_x_mm=st.floats(-30, 30),
        offset_y_mm=st.floats(-30, 30),
        roll_deg=st.floats(-180, 180),
        tilt_x_deg=st.floats(-20, 20),
        tilt_y_deg=st.floats(-20, 20),
    ),
    k1=st.sampled_from([-0.05, 0.0, 0.05]),
    x_px=st.floats(0, 779),
    y_px=st.floats(0, 579),
)
def test_to_the_plane_and_back_is_the_identity(
    pose: CameraPose, k1: float, x_px: float, y_px: float
) -> None:
    lens = camera(k1=k1)
    there = lens.to_plane_mm(np.array([x_px]), np.array([y_px]), pose)
    back = lens.to_pixel(*there, pose)
    np.testing.assert_allclose((back[0][0], back[1][0]), (x_px, y_px), atol=1e-7)
