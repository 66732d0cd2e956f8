import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st

from acquisition.devices import FrameImage
from standoff.console.devices.frame_broadcaster import LiveFrame
from standoff.console.devices.picture_encoder import (
    FORMS,
    HEADER,
    PictureEncoder,
    PictureForm,
    levels_8bit,
)
from standoff.console.devices.picture_monitor import BINS, levels_of
from tests.acquisition.fakes import SETTINGS


@given(level=st.integers(0, 4095))
def test_only_the_largest_level_is_255(level: int) -> None:
    shown = levels_8bit(np.full((2, 3), level, np.uint16), 4095)
    if level == 4095:
        assert (shown == 255).all()
    else:
        assert (np.abs(shown.astype(float) - 254 * level / 4095) <= 0.5 + 1e-9).all()


def test_eight_bit_frames_are_shown_too() -> None:
    image = np.arange(256, dtype=np.uint8).reshape(16, 16)
    shown = levels_8bit(image, 255)
    assert shown[-1, -1] == 255
    assert shown[-1, -2] == 253  # round(254 * 254 / 255)
    assert (np.diff(shown.reshape(-1).astype(int)) >= 0).all()


def test_a_picture_begins_with_its_size_and_keeps_its_orientation() -> None:
    image: FrameImage = np.zeros((4, 6), np.uint16)
    image[1, 5] = 4095
    frame = LiveFrame(image_dn=image, sequence=7, received_s=1000.25, settings=SETTINGS)
    data = PictureEncoder().encode(frame)
    assert HEADER.unpack_from(data) == (b"SOF1", 7, 1000250.0, 6, 4, 0)
    pixels = np.frombuffer(data, np.uint8, offset=HEADER.size).reshape(4, 6)
    assert np.argwhere(pixels == 255).tolist() == [[1, 5]]


def test_a_frame_is_encoded_once_for_all_viewers() -> None:
    encoder = PictureEncoder()
    frame = LiveFrame(
        image_dn=np.zeros((4, 6), np.uint16), sequence=1, received_s=0.0, settings=SETTINGS
    )
    for form in FORMS:
        assert encoder.encode(frame, form) is encoder.encode(frame, form)


def shaded_frame(rows: int = 61, cols: int = 83) -> LiveFrame:
    """Shades without noise, and one saturated pixel, in the last row and column."""
    y_px, x_px = np.mgrid[:rows, :cols]
    image = np.asarray(500 + 20 * x_px + 15 * y_px, np.uint16)
    image[-1, -1] = 4095
    return LiveFrame(image_dn=image, sequence=3, received_s=2.0, settings=SETTINGS)


@pytest.mark.parametrize("form", FORMS[1:])
def test_a_compressed_picture_shows_the_same_levels_and_every_saturated_pixel(
    form: PictureForm,
) -> None:
    frame = shaded_frame()
    data = PictureEncoder().encode(frame, form)
    *facts, jpeg_bytes = HEADER.unpack_from(data)
    assert facts == [b"SOF2", 3, 2000.0, 83, 61]
    body = np.frombuffer(data, np.uint8, offset=HEADER.size)
    shown = cv2.imdecode(body[:jpeg_bytes], cv2.IMREAD_UNCHANGED)
    marks = cv2.imdecode(body[jpeg_bytes:], cv2.IMREAD_UNCHANGED)
    assert shown is not None
    assert marks is not None
    size = (-(-61 // form.reduction), -(-83 // form.reduction))
    assert shown.shape == marks.shape == size
    assert np.argwhere(marks > 127).tolist() == [[size[0] - 1, size[1] - 1]]
    # The shades are linear: the mean of a square is the level at its middle.
    down, right = 61 / size[0], 83 / size[1]
    y_px, x_px = np.mgrid[: size[0], : size[1]]
    level_dn = 500 + 20 * ((x_px + 0.5) * right - 0.5) + 15 * ((y_px + 0.5) * down - 0.5)
    difference = shown.astype(float) - 254 * level_dn / 4095
    assert np.abs(difference[:-1, :-1]).mean() < 2.0
    assert np.abs(difference[: size[0] // 2, : size[1] // 2]).max() < 8.0


def test_where_nothing_is_saturated_no_marks_are_sent() -> None:
    frame = shaded_frame()
    frame.image_dn[-1, -1] = 0
    data = PictureEncoder().encode(frame, FORMS[2])
    assert len(data) == HEADER.size + HEADER.unpack_from(data)[-1]


def test_smaller_forms_take_fewer_bytes_and_their_sizes_are_learnt() -> None:
    noise = np.random.default_rng(5).integers(0, 3000, (580, 780)).astype(np.uint16)
    frame = LiveFrame(image_dn=noise, sequence=1, received_s=0.0, settings=SETTINGS)
    encoder = PictureEncoder()
    sizes = [len(encoder.encode(frame, form)) for form in FORMS]
    assert sizes == sorted(sizes, reverse=True)
    assert [encoder.size_bytes(frame, form) for form in FORMS] == pytest.approx(sizes)
    # What was never encoded is expected to be as detailed as what was.
    other = PictureEncoder()
    other.encode(frame, FORMS[3])
    ratio = sizes[3] / (noise.size * FORMS[3].bytes_per_px)
    expected = noise.size * FORMS[5].bytes_per_px * ratio
    assert other.size_bytes(frame, FORMS[5]) == pytest.approx(expected)
    assert other.size_bytes(frame, FORMS[0]) == noise.size


def test_every_pixel_is_in_the_histogram_and_the_clipped_ones_in_its_last_bin() -> None:
    image = np.random.default_rng(3).integers(0, 4000, (40, 50)).astype(np.uint16)
    image[:2] = 4095
    levels = levels_of(image, 4095)
    assert levels.counts.sum() == image.size
    assert levels.counts[BINS - 1] == 100  # 2 rows; nothing else is above 4063
    assert levels.saturated_fraction == pytest.approx(0.05)
    assert levels.mean_dn == pytest.approx(image.mean())
