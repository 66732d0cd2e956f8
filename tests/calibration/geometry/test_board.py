"""Corners of a chessboard whose photograph has a closed form: a product of two blurred steps.

Levelling against pinhole projections that the test makes itself.
"""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation
from scipy.special import ndtr

from calibration.geometry import Levelling, level_by_board, level_by_focus
from calibration.geometry._board import BoardCorners, _fit_corners, _FittedCorners
from simulation.arrays import FloatArray

SHAPE = (60, 80)
SIDE_PX = 24.0
CLEAR = 0.125
UPRIGHT = np.diag([SIDE_PX, SIDE_PX])


def step(distance_px: FloatArray, sigma_px: float) -> FloatArray:
    """From -1 to 1, averaged over a pixel: the integral of ndtr is z ndtr(z) + pdf(z)."""

    def integral(z: FloatArray) -> FloatArray:
        return np.asarray(z * ndtr(z) + np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi))

    upper, lower = (distance_px + 0.5) / sigma_px, (distance_px - 0.5) / sigma_px
    return 2 * sigma_px * (integral(upper) - integral(lower)) - 1


def corner(
    x_px: float, y_px: float, sigma_px: float = 0.6, contrast_dn: float = 400.0
) -> FloatArray:
    """Black above left and below right of an upright corner, white elsewhere."""
    y, x = np.arange(SHAPE[0], dtype=np.float64), np.arange(SHAPE[1], dtype=np.float64)
    product = np.outer(step(y - y_px, sigma_px), step(x - x_px, sigma_px))
    return 1000.0 - contrast_dn * product


def fitted(image: FloatArray, *points: tuple[float, float]) -> _FittedCorners:
    at = np.array(points)
    return _fit_corners(image, at, np.tile(UPRIGHT, (len(at), 1, 1)), CLEAR)


@settings(max_examples=25)
@given(
    x=st.floats(-0.5, 0.5),
    y=st.floats(-0.5, 0.5),
    sigma=st.floats(0.45, 1.2),
    contrast=st.floats(-900.0, 900.0).filter(lambda value: abs(value) > 50),
)
def test_a_corner_is_found_to_a_hundredth_of_a_pixel_whichever_squares_are_black(
    x: float, y: float, sigma: float, contrast: float
) -> None:
    found = fitted(corner(40.0 + x, 30.0 + y, sigma, contrast), (40.0, 30.0))
    assert found.is_good.tolist() == [True]
    # Two nodes a pixel and axis do not integrate a step of 0.45 px exactly.
    np.testing.assert_allclose(found.points_px, [[40.0 + x, 30.0 + y]], atol=0.01)


def test_the_standard_error_is_that_of_the_scatter() -> None:
    rng = np.random.default_rng(5)
    clean = corner(40.2, 29.7)
    errors, stated = [], []
    for _ in range(30):
        found = fitted(clean + rng.normal(0, 15.0, SHAPE), (40.0, 30.0))
        errors.append(found.points_px[0] - (40.2, 29.7))
        stated.append(found.err_px[0])
    # 60 coordinates: their rms scatters by 9 %.
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.mean(stated), rel=0.3)


@pytest.mark.parametrize(("x_px", "y_px"), [(5.0, 30.0), (75.0, 30.0), (40.0, 5.0), (40.0, 55.0)])
def test_a_corner_whose_cross_leaves_the_frame_is_not_good(x_px: float, y_px: float) -> None:
    found = fitted(corner(x_px, y_px), (x_px, y_px))
    assert found.is_good.tolist() == [False]
    assert found.err_px.tolist() == [np.inf]


def test_squares_too_small_for_a_fit_are_not_good() -> None:
    at = np.array([[40.0, 30.0]])
    assert not _fit_corners(corner(40.0, 30.0), at, UPRIGHT[None] * 0.25, CLEAR).is_good.any()


def test_where_there_is_no_corner_none_is_good() -> None:
    rng = np.random.default_rng(1)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    flat, ramp = np.full(SHAPE, 1000.0), 1000.0 + 3.0 * x - 2.0 * y
    for image in (flat, ramp, rng.normal(1000.0, 100.0, SHAPE)):
        found = fitted(image, (40.0, 30.0))
        assert not found.is_good.any()
        np.testing.assert_array_equal(found.points_px, [[40.0, 30.0]])


def test_a_corner_far_from_where_it_was_looked_for_is_another_one() -> None:
    image = corner(42.0, 30.0)
    found = fitted(image, (40.0, 30.0), (41.0, 30.0))
    # Right to a pixel is what the detector promises.
    assert found.is_good.tolist() == [False, True]
    np.testing.assert_allclose(found.points_px[1], [42.0, 30.0], atol=0.01)


PICTURE = (580, 780)
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
    seen = FOCAL_PX * points[:, :2] / points[:, 2:] + [
        (PICTURE[1] - 1) / 2,
        (PICTURE[0] - 1) / 2,
    ]
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
        level_by_board(photographed(right_deg, down_deg, turn_deg, rng), PICTURE, FOCAL_PX)
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
