"""Levels of a pixel and along a line: at full depth, in the right place."""

import math

import numpy as np
import pytest

from acquisition.devices import FrameImage
from standoff.console.devices.frame_broadcaster import LiveFrame
from standoff.console.devices.frame_sampling import MOST_SAMPLES, line_profile, pixel_reading
from tests.acquisition.fakes import SETTINGS


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
