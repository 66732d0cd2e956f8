from functools import lru_cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.ndimage import gaussian_filter

from calibration.errors import RegistrationError
from calibration.registration import TrackingReference
from simulation.arrays import FloatArray

ROWS, COLS = 240, 320
CORNERS = np.array([[0, 0, 1], [COLS - 1, 0, 1], [0, ROWS - 1, 1], [COLS - 1, ROWS - 1, 1.0]]).T


@lru_cache
def scene(seed: int = 0) -> FloatArray:
    rng = np.random.default_rng(seed)
    fine = gaussian_filter(rng.standard_normal((ROWS, COLS)), 2.5)
    coarse = gaussian_filter(rng.standard_normal((ROWS, COLS)), 8.0)
    return np.asarray(2000 + 900 * fine / fine.std() / 3 + 900 * coarse / coarse.std() / 3)


def seen_from(
    image: FloatArray, matrix: FloatArray, gain: float = 1.0, offset: float = 0.0
) -> FloatArray:
    """The image from that pose, and its mirror images around it."""
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    seen = cv2.warpPerspective(
        image, matrix, (COLS, ROWS), flags=flags, borderMode=cv2.BORDER_REFLECT_101
    )
    return np.asarray(gain * seen + offset, dtype=np.float64)


def pose(zoom: float, turn: float = 0.0, aside_px: float = 0.0, lean: float = 0.0) -> FloatArray:
    """Frame pixel to reference pixel, about the middle of both."""
    middle = np.array([[1, 0, (COLS - 1) / 2], [0, 1, (ROWS - 1) / 2], [0, 0, 1.0]])
    c, s = np.cos(turn), np.sin(turn)
    inner = np.array([[zoom * c, -zoom * s, aside_px], [zoom * s, zoom * c, 0], [lean, 0, 1.0]])
    matrix = middle @ inner @ np.linalg.inv(middle)
    return np.asarray(matrix / matrix[2, 2])


def error_px(found: FloatArray, true: FloatArray) -> float:
    a, b = found @ CORNERS, true @ CORNERS
    return float(np.max(np.hypot(*(a[:2] / a[2] - b[:2] / b[2]))))


@settings(max_examples=10, deadline=None)
@given(
    zoom=st.floats(0.9, 1.3),
    turn=st.floats(-0.1, 0.1),
    aside_px=st.floats(-12, 12),
    lean=st.floats(-2e-4, 2e-4),
    gain=st.floats(0.6, 1.5),
)
def test_a_motion_in_other_light_is_followed_to_a_fraction_of_a_pixel(
    zoom: float, turn: float, aside_px: float, lean: float, gain: float
) -> None:
    true = pose(zoom, turn, aside_px, lean)
    frame = seen_from(scene(), true, gain, 50.0)
    found = TrackingReference(scene()).followed(frame, pose(zoom))
    # The scene is extrapolated to the corners, beyond the outermost corner of the reference.
    assert error_px(found.matrix, true) < 0.5
    assert found.zoom == pytest.approx(zoom, rel=0.01)
    assert found.rms_px < 0.5


def test_nothing_drifts_over_many_frames() -> None:
    tracked = TrackingReference(scene())
    matrix = np.eye(3)
    for number in range(16):
        true = pose(1.1 + 0.1 * np.sin(number / 5), 0.05 * np.sin(number / 3), 4 * np.sin(number))
        matrix = tracked.followed(seen_from(scene(), true), matrix).matrix
        assert error_px(matrix, true) < 0.5, number


@pytest.mark.slow
def test_an_unknown_pose_is_found_and_a_level_type_does_not_matter() -> None:
    true = pose(1.2, 0.2, 10.0, 1e-4)
    tracked = TrackingReference(scene().astype(np.uint16))
    frame = seen_from(scene(), true)
    for image in (frame, frame.astype(np.uint16), (frame / 16).astype(np.uint8)):
        assert error_px(tracked.anchored(image).matrix, true) < 0.5


def test_a_few_hot_pixels_do_not_matter() -> None:
    true = pose(1.1)
    frame = seen_from(scene(), true)
    frame[::60, ::70] = 65535.0
    found = TrackingReference(scene()).followed(frame, pose(1.12))
    assert error_px(found.matrix, true) < 0.5


def test_another_scene_is_not_followed() -> None:
    with pytest.raises(RegistrationError) as refused:
        TrackingReference(scene(0)).followed(scene(1), np.eye(3))
    assert refused.value.reason in ("no_matches", "no_common_pose")


def test_a_reference_out_of_the_frame_is_told() -> None:
    with pytest.raises(RegistrationError) as refused:
        TrackingReference(scene()).followed(scene(), pose(1.0, aside_px=5000.0))
    assert refused.value.reason == "little_overlap"


@pytest.mark.parametrize("image", [np.ones((200, 200)), np.tile(np.linspace(0, 1, 300), (200, 1))])
def test_a_reference_without_corners_is_refused(image: FloatArray) -> None:
    with pytest.raises(RegistrationError) as refused:
        TrackingReference(image)
    assert (refused.value.reason, refused.value.count) == ("no_detail", 0)


@pytest.mark.parametrize(
    "image", [scene()[:20], np.stack([scene()] * 3, axis=-1), np.where(scene() < 2000, np.nan, 1.0)]
)
def test_what_is_no_grey_image_of_some_size_is_no_reference(image: FloatArray) -> None:
    # Not for want of corners: the scene has them.
    with pytest.raises(ValueError):
        TrackingReference(image)
