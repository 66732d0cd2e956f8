"""The newest frame, its levels at full depth, and the picture that is sent of it."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st

from acquisition.devices import FrameImage
from standoff.console.frames import (
    FORMS,
    HEADER,
    MOST_SAMPLES,
    FrameBroadcaster,
    LiveFrame,
    PictureEncoder,
    PictureForm,
    levels_8bit,
    line_profile,
    pixel_reading,
)
from standoff.console.monitors import BINS, levels_of
from tests.acquisition.fakes import SETTINGS, frame


def test_the_newest_frame_is_shown_and_counted() -> None:
    broadcaster = FrameBroadcaster(clock=iter(np.arange(100) * 0.02).__next__)
    for number in (1, 2, 3):
        broadcaster.publish(frame(100 * number, number), SETTINGS)
    latest = broadcaster.latest
    assert latest is not None
    assert (latest.sequence, latest.image_dn[0, 0]) == (3, 300)
    counts = broadcaster.counts
    assert (counts.complete, counts.incomplete, counts.lost) == (3, 0, 0)
    assert abs(counts.rate_hz - 50.0) < 1e-6


def test_frames_that_never_came_are_counted_by_their_ids() -> None:
    broadcaster = FrameBroadcaster()
    for number in (1, 2, 5):
        broadcaster.publish(frame(1, number), SETTINGS)
    broadcaster.publish(frame(1, 6, is_complete=False), SETTINGS)
    assert (
        broadcaster.counts.lost,
        broadcaster.counts.incomplete,
        broadcaster.counts.complete,
    ) == (2, 1, 3)


def test_a_stream_that_begins_anew_has_lost_nothing() -> None:
    broadcaster = FrameBroadcaster()
    broadcaster.publish(frame(1, 900), SETTINGS)
    broadcaster.stream_began()
    broadcaster.publish(frame(1, 3), SETTINGS)
    assert broadcaster.counts.lost == 0


def test_ids_wrap_at_16_bits_without_zero() -> None:
    broadcaster = FrameBroadcaster()
    for number in (65534, 65535, 1, 2):
        broadcaster.publish(frame(1, number), SETTINGS)
    assert broadcaster.counts.lost == 0


@given(missing=st.sets(st.integers(2, 99), max_size=50))
def test_as_many_are_lost_as_were_left_out(missing: set[int]) -> None:
    broadcaster = FrameBroadcaster()
    for number in range(1, 101):
        if number not in missing:
            broadcaster.publish(frame(1, number), SETTINGS)
    assert broadcaster.counts.lost == len(missing)


def test_listeners_are_called_until_they_end() -> None:
    broadcaster, heard = FrameBroadcaster(), []
    end = broadcaster.subscribe(lambda: heard.append(1))
    broadcaster.publish(frame(1, 1), SETTINGS)
    end()
    end()
    broadcaster.publish(frame(1, 2), SETTINGS)
    assert heard == [1]
    assert broadcaster.wait_newer(2, 0.0) is None
    newer = broadcaster.wait_newer(1, 0.0)
    assert newer is not None
    assert newer.sequence == 2


def live(image_dn: FrameImage) -> LiveFrame:
    return LiveFrame(image_dn=image_dn, sequence=1, received_s=0.0, settings=SETTINGS)


def ramp_dn(rows: int, cols: int) -> FrameImage:
    """Levels of 10 a column and 23 a row, whose bilinear interpolation is exact."""
    y_px, x_px = np.mgrid[:rows, :cols]
    return np.asarray(10 * x_px + 23 * y_px, dtype=np.uint16)


def test_a_pixel_is_read_by_column_and_row_at_full_depth() -> None:
    reading = pixel_reading(live(ramp_dn(30, 40)), 37, 5)
    assert reading is not None
    assert reading.level_dn == 10 * 37 + 23 * 5
    assert reading.mean_dn == reading.level_dn  # of a plane, in the middle of 5 x 5


def test_at_a_corner_the_neighbours_that_exist_are_averaged() -> None:
    reading = pixel_reading(live(ramp_dn(30, 40)), 0, 0)
    assert reading is not None
    assert (reading.level_dn, reading.mean_dn) == (0, 33.0)  # 3 x 3: one column and one row on


@pytest.mark.parametrize("pixel", [(40, 0), (0, 30), (65535, 65535)])
def test_outside_the_frame_there_is_no_level(pixel: tuple[int, int]) -> None:
    assert pixel_reading(live(ramp_dn(30, 40)), *pixel) is None


def test_a_line_is_sampled_between_the_pixels_both_ends_included() -> None:
    profile = line_profile(live(ramp_dn(30, 40)), (2.5, 3.25), (32.5, 23.25))
    assert profile is not None
    assert profile.length_px == pytest.approx(math.hypot(30, 20))
    assert len(profile.levels_dn) == 38
    along = np.linspace(0, 1, 38)
    expected = 10 * (2.5 + 30 * along) + 23 * (3.25 + 20 * along)
    np.testing.assert_allclose(profile.levels_dn, expected, rtol=1e-12)


def test_a_long_line_has_a_bounded_number_of_samples_and_a_point_has_two() -> None:
    wide = live(np.zeros((2, 5000), dtype=np.uint8))
    profile = line_profile(wide, (0.0, 0.0), (4999.0, 1.0))
    assert profile is not None
    assert len(profile.levels_dn) == MOST_SAMPLES
    point = line_profile(wide, (7.0, 1.0), (7.0, 1.0))
    assert point is not None
    assert (len(point.levels_dn), point.length_px) == (2, 0.0)


def test_a_line_that_leaves_the_frame_has_no_profile() -> None:
    assert line_profile(live(ramp_dn(30, 40)), (0.0, 0.0), (40.0, 3.0)) is None


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
