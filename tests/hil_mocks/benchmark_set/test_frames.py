"""Light on pixels beside closed forms, and how exact the sampling of scenes is."""

from dataclasses import replace
from math import hypot

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.special import ndtr

from hil_mocks.benchmark_set._lenses import CircularPupil, round_lens
from hil_mocks.benchmark_set._photographs import (
    INK,
    PAPER,
    Chart,
    Grid,
    Square,
    pixels,
    sampled,
    spot_series,
)
from hil_mocks.benchmark_set._scenes import SCENES, Pose, scene
from hil_mocks.benchmark_set._tasks import SAMPLES_PER_PX, View, chart_light, gradient

FloatArray = NDArray[np.float64]
LENS = round_lens(0.7)
SHAPE = (40, 56)
GRID = Grid(rows=40, cols=56, band_cy_per_px=LENS.band_cy_per_px)


def blurred_interval(x: FloatArray, start: float, end: float, sigma: float) -> FloatArray:
    """Mean over each pixel of an interval's indicator after a Gaussian blur."""

    def integral(distance: FloatArray) -> FloatArray:
        z = distance / sigma
        return np.asarray(distance * ndtr(z) + sigma * np.exp(-z * z / 2) / np.sqrt(2 * np.pi))

    up = integral(x + 0.5 - start) - integral(x - 0.5 - start)
    return np.asarray(up - integral(x + 0.5 - end) + integral(x - 0.5 - end))


def test_an_upright_square_is_the_product_of_two_blurred_intervals() -> None:
    chart = Chart(shape=SHAPE, squares=(Square(x_px=30.3, y_px=17.6, side_px=15, slant_deg=0),))
    y, x = np.mgrid[:40, :56].astype(np.float64)
    across = blurred_interval(x, 22.8, 37.8, 0.7)
    expected = PAPER + (INK - PAPER) * across * blurred_interval(y, 10.1, 25.1, 0.7)
    # What a Gaussian passes beyond its band is left out.
    assert chart_light(chart, LENS) == pytest.approx(expected, abs=1e-9)


def test_a_slanted_square_is_turned_from_x_towards_y_and_as_dark_in_sum() -> None:
    square = Square(x_px=28.0, y_px=20.0, side_px=16, slant_deg=20)
    light = chart_light(Chart(shape=SHAPE, squares=(square,)), LENS)
    assert (PAPER - light).sum() == pytest.approx((PAPER - INK) * 16**2, rel=1e-9)
    # (9, -4) from its middle is (7.1, -6.8) along its own sides, (9, 4) is (9.8, 0.7).
    assert light[16, 37] < PAPER - 0.6
    assert light[24, 37] > PAPER - 0.05


def test_a_spot_is_a_gaussian_over_the_pixels() -> None:
    spot = pixels(spot_series(GRID, 20.25, 12.5, 1.2, 0.3), LENS, GRID)
    y, x = np.mgrid[:40, :56].astype(np.float64)
    s = hypot(1.2, 0.7)

    def steps(at: FloatArray) -> FloatArray:
        return np.asarray(ndtr((at + 0.5) / s) - ndtr((at - 0.5) / s))

    expected = 0.3 * 2 * np.pi * 1.2**2 * steps(x - 20.25) * steps(y - 12.5)
    assert spot == pytest.approx(expected, abs=1e-9)


def test_a_wave_is_seen_with_the_contrast_of_lens_and_pixel() -> None:
    rows, cols = GRID.period_px
    fx, fy = 9 / cols, -4 / rows  # whole waves in a period
    wave = sampled(lambda x, y: np.cos(2 * np.pi * (fx * x + fy * y)), GRID)
    y, x = np.mgrid[:40, :56]
    passed = np.exp(-2 * np.pi**2 * 0.7**2 * (fx**2 + fy**2)) * np.sinc(fx) * np.sinc(fy)
    expected = passed * np.cos(2 * np.pi * (fx * x + fy * y))
    assert pixels(wave, LENS, GRID) == pytest.approx(expected, abs=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("kind", SCENES)
def test_more_samples_a_pixel_change_a_frame_by_less_than_a_ten_thousandth(kind: str) -> None:
    """By the sharpest lens, at the largest zoom of each number of samples."""
    lens, shape = CircularPupil(f_number=4.0), (20, 28)
    for zoom, count in {1.0: 8, **SAMPLES_PER_PX}.items():
        pose = Pose(reference_shape=shape, followup_shape=shape, zoom=zoom, roll_deg=12.0)
        view = View(scene=f"{kind}-1", seed=1, lens=lens, pose=pose)
        grid = replace(view.followup_grid(), per_px=24)
        assert view.followup_grid().per_px == count
        coarse, fine = view.followup_light(), pixels(view.series_on(grid), lens, grid)
        assert np.abs(coarse - fine).max() < 1e-4 * fine.max()


@pytest.mark.slow
def test_a_wider_margin_changes_a_frame_by_less_than_a_thousandth() -> None:
    """What lies beyond the margin is another part of the scene: a perfect lens's halo is faint."""
    lens = CircularPupil(f_number=8.0)
    known = scene("rectangles-1", (96, 128), 1)
    small = Grid(rows=48, cols=64, band_cy_per_px=lens.band_cy_per_px)
    wide = replace(small, rows=48 + 160, cols=64 + 160)
    near = pixels(sampled(known.at, small), lens, small)
    whole = pixels(sampled(lambda x, y: known.at(x - 80, y - 80), wide), lens, wide)
    assert np.abs(near - whole[80:-80, 80:-80]).max() < 1e-3


def test_light_rises_over_the_width_by_its_slope() -> None:
    light = gradient((30, 50), 0.4, 0.0)
    assert light.mean() == pytest.approx(1.0)
    assert light[3, 49] - light[3, 0] == pytest.approx(0.4 * 49 / 50)
    assert np.all(light[0] == light[29])
    assert gradient((30, 50), 0.4, 90.0)[29, 0] > 1.1
