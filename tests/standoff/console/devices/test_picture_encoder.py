import numpy as np
import pytest
from hypothesis import given, strategies as st

from acquisition.devices import FrameImage
from standoff.console.devices.frame_broadcaster import LiveFrame
from standoff.console.devices.picture_encoder import HEADER, PictureEncoder, levels_8bit
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
    assert HEADER.unpack_from(data) == (b"SOF1", 7, 1000250.0, 6, 4)
    pixels = np.frombuffer(data, np.uint8, offset=HEADER.size).reshape(4, 6)
    assert np.argwhere(pixels == 255).tolist() == [[1, 5]]


def test_a_frame_is_encoded_once_for_all_viewers() -> None:
    encoder = PictureEncoder()
    frame = LiveFrame(
        image_dn=np.zeros((4, 6), np.uint16), sequence=1, received_s=0.0, settings=SETTINGS
    )
    assert encoder.encode(frame) is encoder.encode(frame)


def test_every_pixel_is_in_the_histogram_and_the_clipped_ones_in_its_last_bin() -> None:
    image = np.random.default_rng(3).integers(0, 4000, (40, 50)).astype(np.uint16)
    image[:2] = 4095
    levels = levels_of(image, 4095)
    assert levels.counts.sum() == image.size
    assert levels.counts[BINS - 1] == 100  # 2 rows; nothing else is above 4063
    assert levels.saturated_fraction == pytest.approx(0.05)
    assert levels.mean_dn == pytest.approx(image.mean())
