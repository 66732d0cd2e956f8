from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from calibration.edges import EdgeLine, EdgeSegment, band_half_width, band_pixels, side_level
from tests.calibration.closed_form import edge_image

SEGMENT = EdgeSegment(
    x_px=60.0, y_px=40.0, normal_rad=0.2, length_px=50.0, found_length_px=56.0, sigma_px=0.8
)


def along(segment: EdgeSegment, x_px: float, y_px: float) -> float:
    """Place on the line of the segment, from its middle."""
    return float(
        -np.sin(segment.normal_rad) * (x_px - segment.x_px)
        + np.cos(segment.normal_rad) * (y_px - segment.y_px)
    )


def test_a_short_edge_stays_one_piece() -> None:
    assert SEGMENT.pieces(128.0) == [SEGMENT]


def test_a_vertical_edge_of_300_px_by_hand() -> None:
    segment = replace(SEGMENT, normal_rad=0.0, y_px=150.0, length_px=300.0, found_length_px=310.0)
    pieces = segment.pieces(100.0)
    assert [(p.x_px, p.y_px) for p in pieces] == [(60.0, 50.0), (60.0, 150.0), (60.0, 250.0)]
    assert [(p.length_px, p.found_length_px) for p in pieces] == [(100.0, 100.0)] * 3


@given(
    normal=st.floats(-4.0, 4.0),
    length=st.floats(12.0, 2000.0),
    longest=st.floats(20.0, 300.0),
)
def test_the_pieces_cover_the_edge_once_and_end_where_it_ends(
    normal: float, length: float, longest: float
) -> None:
    segment = replace(SEGMENT, normal_rad=normal, length_px=length)
    pieces = segment.pieces(longest)
    places = [along(segment, p.x_px, p.y_px) for p in pieces]
    starts = [t - p.length_px / 2 for t, p in zip(places, pieces, strict=True)]
    ends = [t + p.length_px / 2 for t, p in zip(places, pieces, strict=True)]
    assert starts[0] == pytest.approx(-length / 2, abs=1e-6)
    assert ends[-1] == pytest.approx(length / 2, abs=1e-6)
    np.testing.assert_allclose(starts[1:], ends[:-1], atol=1e-6)
    assert all(p.length_px <= 1.5 * longest for p in pieces)


@given(
    normal=st.floats(-4.0, 4.0),
    sigma=st.floats(0.3, 2.0),
    x=st.floats(10.0, 100.0),
    y=st.floats(10.0, 70.0),
)
def test_the_band_holds_every_pixel_of_the_band_and_no_other(
    normal: float, sigma: float, x: float, y: float
) -> None:
    rows, cols = 80, 120
    image = np.arange(rows * cols, dtype=np.float64).reshape(rows, cols)
    band = band_pixels(image, EdgeLine(x, y, normal, 25.0), band_half_width(sigma))
    # Every pixel names itself by its value.
    picked_y, picked_x = np.divmod(band.values, cols)
    np.testing.assert_allclose(band.x, picked_x - x, atol=1e-9)
    np.testing.assert_allclose(band.y, picked_y - y, atol=1e-9)
    all_y, all_x = np.mgrid[:rows, :cols].astype(np.float64)
    across = np.cos(normal) * (all_x - x) + np.sin(normal) * (all_y - y)
    beside = -np.sin(normal) * (all_x - x) + np.cos(normal) * (all_y - y)
    inside = (np.abs(across) <= 6 * sigma + 3) & (np.abs(beside) <= 25.0)
    np.testing.assert_array_equal(np.sort(band.values), image[inside])
    np.testing.assert_allclose(np.sort(band.across), np.sort(across[inside]), atol=1e-9)


def test_the_levels_of_the_sides_are_those_of_the_edge() -> None:
    image = edge_image(0.8, np.rad2deg(0.2), shape=(81, 121), offset_px=0.0)
    band = band_pixels(image, EdgeLine(60.0, 40.0, 0.2, 25.0), band_half_width(0.8))
    sides = side_level(band.values, -band.across, 0.8), side_level(band.values, band.across, 0.8)
    # Beyond 1.5 sigma a Gaussian edge is within 7 % of its level, on average within 0.3 %.
    assert sides == pytest.approx((8_000.0, 52_000.0), abs=0.005 * 44_000.0)


def test_a_band_outside_the_image_is_empty() -> None:
    band = band_pixels(np.zeros((30, 30)), EdgeLine(500.0, 40.0, 0.2, 25.0), 7.8)
    assert band.values.size == 0
    assert side_level(band.values, band.across, 0.8) == 0.0
