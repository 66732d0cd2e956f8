import numpy as np
import pytest
from hypothesis import given, strategies as st

from calibration.registration.distorted_pose import DistortedPose
from hil_mocks.truth.render import CameraPose, PinholeCamera

SHAPE = (58, 78)
CORNERS = (np.array([0.0, 0.0, 57.0, 57.0, 20.0]), np.array([0.0, 77.0, 0.0, 77.0, 31.0]))


def pose_of(
    k1: float, zoom: float = 1.7, shift_px: float = 3.0, bend: float = 0.0
) -> DistortedPose:
    matrix = np.array([[zoom, 0.02, shift_px - 25], [-0.02, zoom, -18.0], [bend, -bend, 1.0]])
    return DistortedPose(matrix=matrix, k1=k1, reference_shape=SHAPE, followup_shape=SHAPE)


@given(
    k1=st.floats(-0.1, 0.1),
    zoom=st.floats(1.0, 3.0),
    shift_px=st.floats(-8, 8),
    bend=st.floats(-3e-4, 3e-4),
)
def test_there_and_back_is_the_same_place(
    k1: float, zoom: float, shift_px: float, bend: float
) -> None:
    pose = pose_of(k1, zoom, shift_px, bend)
    # Places inside the reference; beyond its corners a barrel folds over.
    places = (np.array([3.0, 28.5, 50.0]), np.array([70.0, 38.5, 5.0]))
    back = pose.to_reference_px(*pose.to_followup_px(*places))
    np.testing.assert_allclose(back, places, atol=1e-6)


def test_without_distortion_it_is_the_homography() -> None:
    pose = pose_of(0.0, bend=1e-4)
    y, x = CORNERS
    mapped = pose.matrix @ np.stack([x, y, np.ones_like(x)])
    np.testing.assert_allclose(pose.to_reference_px(y, x), (mapped / mapped[2])[[1, 0]])


@pytest.mark.parametrize("k1", [-0.03, 0.02])
def test_it_distorts_like_the_camera_of_the_bench(k1: float) -> None:
    camera = PinholeCamera(
        width_px=78, height_px=58, focal_length_mm=8.0, pixel_pitch_um=83.0, k1=k1
    )
    near = CameraPose(height_mm=200.0)
    far = CameraPose(height_mm=310.0, offset_x_mm=2.0, roll_deg=1.0, tilt_x_deg=2.0)
    matrix = camera.homography_to_px(near) @ np.linalg.inv(camera.homography_to_px(far))
    pose = DistortedPose(
        matrix=matrix / matrix[2, 2], k1=k1, reference_shape=SHAPE, followup_shape=SHAPE
    )
    y, x = (np.clip(place, 18.0, 40.0) for place in CORNERS)
    true_x, true_y = camera.to_pixel(*camera.to_plane_mm(x, y, far), near)
    np.testing.assert_allclose(pose.to_reference_px(y, x), (true_y, true_x), atol=1e-6)


def test_the_zoom_is_that_of_the_centre() -> None:
    about_centre = np.array([[2.0, 0.0, -38.5], [0.0, 2.0, -28.5], [0.0, 0.0, 1.0]])
    for k1 in (0.0, -0.05):
        pose = DistortedPose(
            matrix=about_centre, k1=k1, reference_shape=SHAPE, followup_shape=SHAPE
        )
        # Half a pixel from the centre the distortion is k1 / corner^2: 1e-5 at most.
        assert pose.zoom == pytest.approx(2.0, rel=1e-4)
