"""Levelling against pinhole projections that the test makes itself."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.geometry import Levelling, level_by_board, level_by_focus
from calibration.geometry.board import BoardCorners
from simulation.arrays import FloatArray

SHAPE = (580, 780)
FOCAL_PX = 960.0
NOISE_PX = 0.03
TILTS_DEG = [(0.0, 0.0), (0.5, 0.0), (0.0, -0.7), (-1.3, 2.1), (8.0, -5.0)]


def photographed(
    right_deg: float, down_deg: float, turn_deg: float, rng: np.random.Generator
) -> BoardCorners:
    """A board 300 mm away on a plane whose distance grows by these angles, turned in its plane."""
    grid: FloatArray = (
        np.stack(np.meshgrid(np.arange(13), np.arange(9)), axis=-1)
        .reshape(-1, 2)
        .astype(np.float64)
        * 12.5
    )
    away = (grid - grid.mean(axis=0)) @ Rotation.from_euler(
        "z", turn_deg, degrees=True
    ).as_matrix()[:2, :2].T
    slopes = np.tan(np.deg2rad([right_deg, down_deg]))
    # Points of the plane Z = 300 + slopes . (X, Y), with the board's lengths along it.
    normal = np.array([-slopes[0], -slopes[1], 1.0])
    first = np.array([1.0, 0.0, slopes[0]])
    first /= np.linalg.norm(first)
    second = np.cross(normal / np.linalg.norm(normal), first)
    points = np.array([5.0, -8.0, 300.0 + slopes @ [5.0, -8.0]]) + away @ np.stack([first, second])
    seen = FOCAL_PX * points[:, :2] / points[:, 2:] + [(SHAPE[1] - 1) / 2, (SHAPE[0] - 1) / 2]
    noisy = seen + rng.normal(0, NOISE_PX, seen.shape)
    return BoardCorners(seen_px=noisy, plane_mm=grid, err_px=np.full(len(grid), NOISE_PX))


@pytest.mark.slow
@pytest.mark.parametrize(("right_deg", "down_deg"), TILTS_DEG)
@pytest.mark.parametrize("turn_deg", [0.0, 37.0, 180.0])
def test_the_tilt_of_a_board_is_found_within_its_errors(
    right_deg: float, down_deg: float, turn_deg: float
) -> None:
    rng = np.random.default_rng(round(10 * right_deg + 100 * down_deg + turn_deg) % 1000)
    found = [
        level_by_board(photographed(right_deg, down_deg, turn_deg, rng), SHAPE, FOCAL_PX)
        for _ in range(40)
    ]
    for name, truth in (("right", right_deg), ("down", down_deg)):
        angles = np.array([getattr(each, f"{name}_deg") for each in found])
        errs = np.array([getattr(each, f"{name}_err_deg") for each in found])
        # Forty draws: their mean is within 4.4 standard errors but for one time in 10^5, and
        # their scatter within 2 of what is stated.
        assert abs(angles.mean() - truth) < 4.4 * errs.mean() / np.sqrt(40)
        assert 0.5 < angles.std(ddof=1) / errs.mean() < 1.6
        assert errs.mean() < 0.2


def test_the_advice_names_the_side_that_is_nearer() -> None:
    level = Levelling(right_deg=0.4, right_err_deg=0.01, down_deg=-0.3, down_err_deg=0.01)
    assert level.advice == "raise the left side by 0.40°; raise the bottom side by 0.30°"
    unsure = Levelling(right_deg=0.4, right_err_deg=0.3, down_deg=0.02, down_err_deg=0.001)
    assert unsure.advice == "level"


def field_of(right_deg: float, down_deg: float, bend_mm: float) -> tuple[FloatArray, FloatArray]:
    """Heights at which four corners of the picture are sharp, 0.3 mm a pixel."""
    positions = np.array([[90.0, 70], [690, 70], [90, 510], [690, 510]])
    offset_mm = 0.3 * (positions - [390, 290])
    slopes = np.tan(np.deg2rad([right_deg, down_deg]))
    # In focus at 200 mm from the camera; the field bends alike at the corners.
    return 200.0 - offset_mm @ slopes + bend_mm, positions


@pytest.mark.parametrize(("right_deg", "down_deg"), TILTS_DEG)
@pytest.mark.parametrize("bend_mm", [0.0, 3.0])
def test_four_peaks_of_focus_give_the_slopes_of_the_scene(
    right_deg: float, down_deg: float, bend_mm: float
) -> None:
    peaks, positions = field_of(right_deg, down_deg, bend_mm)
    found = level_by_focus(peaks, np.full(4, 0.1), positions, 0.3)
    assert (found.right_deg, found.down_deg) == pytest.approx((right_deg, down_deg), abs=1e-9)
    # Two pairs 180 mm apart, 0.1 mm each: 0.1 / 180 rad for a flat scene.
    if right_deg == 0:
        assert found.right_err_deg == pytest.approx(np.rad2deg(0.1 / 180), rel=1e-6)


def test_regions_on_one_line_level_nothing() -> None:
    positions = np.array([[0.0, 0], [100, 100], [200, 200]])
    with pytest.raises(ValueError, match="not on one line"):
        level_by_focus(np.full(3, 200.0), np.full(3, 0.1), positions, 0.3)
