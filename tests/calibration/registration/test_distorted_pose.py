"""The smooth displacement of a scene that is not quite planar."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from calibration.registration._distorted_pose import DistortedPose, SmoothDisplacement
from hil_mocks.truth.render import CameraPose, PinholeCamera

SHAPE = (60, 80)
Y, X = (at.astype(np.float64) for at in np.mgrid[2:58:7, 3:77:7])
MATRIX = np.array([[1.2, 0.03, -6.0], [-0.02, 1.2, -5.0], [1e-4, -1e-4, 1.0]])


def displacement(seed: int, largest_px: float = 2.0) -> SmoothDisplacement:
    """Coefficients up to ``largest_px``: its slope stays below 0.3, so that it has an inverse."""
    knots = np.random.default_rng(seed).uniform(-largest_px, largest_px, (2, 6, 7))
    return SmoothDisplacement(knots_px=knots, shape=SHAPE, photograph="followup")


def pose(bend: SmoothDisplacement | None, k1: float = 0.0) -> DistortedPose:
    return DistortedPose(
        matrix=MATRIX, k1=k1, reference_shape=SHAPE, followup_shape=SHAPE, displacement=bend
    )


@given(seed=st.integers(0, 10_000), largest_px=st.floats(0.0, 2.0))
def test_displaced_and_restored_is_the_same_place(seed: int, largest_px: float) -> None:
    bend = displacement(seed, largest_px)
    back = bend.restored(*bend.displaced(Y, X))
    # The iteration contracts by the slope, below 0.7: 30 rounds leave 1e-4 at the very most.
    np.testing.assert_allclose(back, (Y, X), atol=1e-4)


def test_equal_coefficients_are_a_shift() -> None:
    # The basis functions of a B-spline add up to 1.
    knots = np.stack([np.full((6, 7), 0.7), np.full((6, 7), -1.3)])
    bend = SmoothDisplacement(knots_px=knots, shape=SHAPE, photograph="followup")
    y, x = bend.displaced(Y, X)
    np.testing.assert_allclose(y - Y, 0.7, atol=1e-12)
    np.testing.assert_allclose(x - X, -1.3, atol=1e-12)


def test_linear_coefficients_are_a_linear_displacement() -> None:
    # A cubic B-spline reproduces lines: the coefficient of knot j belongs to the place j - 1.
    along = np.arange(7.0) - 1
    knots = np.stack([np.zeros((6, 7)), np.broadcast_to(0.5 * along, (6, 7))])
    bend = SmoothDisplacement(knots_px=knots, shape=SHAPE, photograph="followup")
    _, x = bend.displaced(Y, X)
    np.testing.assert_allclose(x - X, 0.5 * 4 * (X + 0.5) / 80, atol=1e-12)


@pytest.mark.parametrize("k1", [0.0, -0.01])
def test_a_bent_pose_and_its_inverse_lead_back(k1: float) -> None:
    bent = pose(displacement(4), k1)
    places = Y[2:6, 2:8], X[2:6, 2:8]
    np.testing.assert_allclose(
        bent.to_followup_px(*bent.to_reference_px(*places)), places, atol=1e-4
    )
    back = bent.inverse().inverse()
    np.testing.assert_allclose(
        back.to_reference_px(*places), bent.to_reference_px(*places), atol=1e-9
    )


def test_the_nearest_homography_of_a_linear_displacement_is_exact() -> None:
    # Displaced linearly, a homography remains one.
    along = np.arange(7.0) - 1
    knots = np.stack([np.zeros((6, 7)), np.broadcast_to(0.5 * along, (6, 7))])
    bent = pose(SmoothDisplacement(knots_px=knots, shape=SHAPE, photograph="followup"))
    moved = np.array([[1 + 0.5 * 4 / 80, 0, 0.5 * 4 * 0.5 / 80], [0, 1, 0], [0, 0, 1.0]])
    expected = MATRIX @ moved
    # OpenCV fits in single precision: 1e-5 px in 80.
    np.testing.assert_allclose(
        bent.nearest_homography(), expected / expected[2, 2], rtol=1e-4, atol=1e-6
    )


FRAME = (58, 78)
CORNERS = (np.array([0.0, 0.0, 57.0, 57.0, 20.0]), np.array([0.0, 77.0, 0.0, 77.0, 31.0]))


def pose_of(
    k1: float, zoom: float = 1.7, shift_px: float = 3.0, bend: float = 0.0
) -> DistortedPose:
    matrix = np.array([[zoom, 0.02, shift_px - 25], [-0.02, zoom, -18.0], [bend, -bend, 1.0]])
    return DistortedPose(matrix=matrix, k1=k1, reference_shape=FRAME, followup_shape=FRAME)


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
        matrix=matrix / matrix[2, 2], k1=k1, reference_shape=FRAME, followup_shape=FRAME
    )
    y, x = (np.clip(place, 18.0, 40.0) for place in CORNERS)
    true_x, true_y = camera.to_pixel(*camera.to_plane_mm(x, y, far), near)
    np.testing.assert_allclose(pose.to_reference_px(y, x), (true_y, true_x), atol=1e-6)


def test_the_zoom_is_that_of_the_centre() -> None:
    about_centre = np.array([[2.0, 0.0, -38.5], [0.0, 2.0, -28.5], [0.0, 0.0, 1.0]])
    for k1 in (0.0, -0.05):
        pose = DistortedPose(
            matrix=about_centre, k1=k1, reference_shape=FRAME, followup_shape=FRAME
        )
        # Half a pixel from the centre the distortion is k1 / corner^2: 1e-5 at most.
        assert pose.zoom == pytest.approx(2.0, rel=1e-4)
