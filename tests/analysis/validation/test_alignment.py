import numpy as np
import pytest
from hypothesis import given, strategies as st

from analysis.errors import OverlapError
from analysis.validation.alignment import bicubic_at, scaled_up, shared_window
from calibration.registration import DistortedPose


@given(
    curve=st.tuples(*[st.floats(-2, 2)] * 6),
    y=st.floats(2.0, 16.0),
    x=st.floats(2.0, 26.0),
)
def test_bicubic_interpolation_reproduces_a_parabola(
    curve: tuple[float, ...], y: float, x: float
) -> None:
    a, b, c, d, e, f = curve
    v, u = np.mgrid[:20, :30].astype(np.float64)
    # Keys, 1981: with a = -1/2 the cubic is exact up to the second power.
    image = a + b * u + c * v + d * u * u + e * u * v + f * v * v
    found = bicubic_at(image, np.array([y]), np.array([x]))
    expected = a + b * x + c * y + d * x * x + e * x * y + f * y * y
    assert found[0] == pytest.approx(expected, abs=1e-9 * (1 + np.abs(image).max()))


def test_at_the_pixels_it_is_the_image_and_outside_its_border_goes_on() -> None:
    image = np.random.default_rng(1).uniform(0, 255, (6, 9))
    y, x = np.mgrid[:6, :9].astype(np.float64)
    np.testing.assert_allclose(bicubic_at(image, y, x), image)
    assert bicubic_at(image, np.array([-4.0]), np.array([20.0]))[0] == pytest.approx(image[0, 8])


def test_scaling_up_keeps_the_centre_by_hand() -> None:
    # A ramp of 10 per pixel about 0 becomes one of 5 per pixel about 0.
    image = np.tile(10.0 * (np.arange(8) - 3.5), (8, 1))
    found = scaled_up(image, 2.0, (16, 16))
    np.testing.assert_allclose(found[:, 3:13], np.tile(5.0 * (np.arange(3, 13) - 7.5), (16, 1)))


@given(
    zoom=st.floats(1.0, 3.0),
    shift_px=st.floats(-20, 20),
    turn=st.floats(-0.05, 0.05),
    k1=st.floats(-0.05, 0.05),
)
def test_the_shared_window_lies_wholly_inside_the_reference(
    zoom: float, shift_px: float, turn: float, k1: float
) -> None:
    shape = (90, 120)
    matrix = np.array(
        [[zoom, -turn, shift_px - 59.5 * (zoom - 1)], [turn, zoom, -44.5 * (zoom - 1)], [0, 0, 1]]
    )
    pose = DistortedPose(matrix=matrix, k1=k1, reference_shape=shape, followup_shape=shape)
    window = shared_window(pose)
    margin_px = (pose.zoom - 1) / 2
    for places, size in ((window.y_px, 90), (window.x_px, 120)):
        assert places.min() >= margin_px - 1e-9
        assert places.max() <= size - 1 - margin_px + 1e-9
    # No more than a quarter of either side is given away.
    assert window.y_px.shape[0] * zoom > 0.6 * (90 - 2 * margin_px)
    assert window.x_px.shape[1] * zoom > 0.5 * (120 - 2 * margin_px)


def test_images_that_do_not_overlap_have_no_window() -> None:
    matrix = np.array([[1.5, 0, 900.0], [0, 1.5, 0], [0, 0, 1]])
    pose = DistortedPose(matrix=matrix, k1=0.0, reference_shape=(90, 120), followup_shape=(90, 120))
    with pytest.raises(OverlapError) as refused:
        shared_window(pose)
    assert refused.value.shared_px == 0


def test_images_that_share_a_strip_alone_have_no_window() -> None:
    # By hand: 1.5 u + 104 <= 119 - 0.25 lets ten columns in.
    matrix = np.array([[1.5, 0, 104.0], [0, 1.5, 0], [0, 0, 1]])
    pose = DistortedPose(matrix=matrix, k1=0.0, reference_shape=(90, 120), followup_shape=(90, 120))
    with pytest.raises(OverlapError) as refused:
        shared_window(pose)
    # Ten columns of the rows that the reference covers: 1.5 v <= 89 - 0.25.
    assert refused.value.shared_px == 10 * 59
