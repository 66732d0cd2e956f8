"""The error of the pupil offset, against the closed form of a straight line through heights."""

from dataclasses import replace
from math import sqrt

import numpy as np
import pytest

from analysis.study import BoardCapture, BoardSession, EdgeLevels, pupil_errors
from calibration.geometry import DEFAULT_BOARD
from calibration.noise import LevelNoise

HEIGHTS_MM = (360.0, 400.0, 460.0, 520.0)
BOARD = BoardSession(
    captures=tuple(
        BoardCapture(placement=0, orientation_deg=0.0, height_mm=height) for height in HEIGHTS_MM
    ),
    board=DEFAULT_BOARD,
    width_px=240,
    height_px=180,
    focal_length_px=964.0,
    pupil_offset_mm=12.5,
    sigma_px=0.6,
    levels=EdgeLevels(
        low_dn=226.0,
        high_dn=2764.0,
        frame_noise=LevelNoise(offset_dn2=6.0, slope_dn=0.2, floor_dn2=6.0),
    ),
    frames=4,
)


def test_heights_that_scatter_leave_the_intercept_of_a_line_uncertain() -> None:
    found = pupil_errors(replace(BOARD, height_scatter_mm=0.5))
    assert found is not None
    distance_mm = np.array(HEIGHTS_MM) + 12.5
    away = distance_mm - distance_mm.mean()
    closed = 0.5 * sqrt(1 / 4 + distance_mm.mean() ** 2 / float(away @ away))
    # The corners' own errors shift the weights a little.
    assert sqrt(found.heights) == pytest.approx(closed, rel=1e-3)
    assert found.degrees_of_freedom == 2


def test_four_times_the_frames_halve_what_the_pixels_leave() -> None:
    once, again = pupil_errors(BOARD), pupil_errors(replace(BOARD, frames=16))
    assert once is not None
    assert again is not None
    # A corner is never known better than to 0.001 px, a height to 0.0005 mm.
    assert 1.0 < once.pixels / again.pixels < 4.0
    noisy = replace(
        BOARD.levels, frame_noise=LevelNoise(offset_dn2=6e3, slope_dn=200.0, floor_dn2=6e3)
    )
    first = pupil_errors(replace(BOARD, levels=noisy))
    second = pupil_errors(replace(BOARD, levels=noisy, frames=16))
    assert first is not None
    assert second is not None
    assert first.pixels / second.pixels == pytest.approx(4.0, rel=0.01)


def test_one_height_or_squares_too_small_determine_nothing() -> None:
    assert pupil_errors(replace(BOARD, captures=BOARD.captures[:1])) is None
    far = tuple(replace(one, height_mm=2000.0 + one.height_mm) for one in BOARD.captures)
    assert pupil_errors(replace(BOARD, captures=far)) is None


@pytest.mark.parametrize(("height_mm", "corners"), [(360.0, 18), (400.0, 30), (460.0, 40)])
def test_corners_count_whose_two_markers_are_in_view(height_mm: float, corners: int) -> None:
    # As OpenCV found on rendered boards; by hand at 400 mm: a frame of 102.3 x 76.3 mm has corners
    # at 0, +-12 .. +-36 or so along one axis, and their markers reach 10.5 mm further.
    capture = BoardCapture(placement=0, orientation_deg=0.0, height_mm=height_mm)
    assert len(BOARD.corners_mm(capture)) == corners
