from dataclasses import replace

import numpy as np
import pytest

from calibration.psf import calibrate_psf
from calibration.psf.consistency import HeightTrend, fit_height_trend
from tests.calibration.edge_photographs import photographs

HEIGHTS_MM = np.repeat([100.0, 200.0, 300.0, 400.0], 8)
ERR = 0.005


def trend_of(bend: float = 0.0, slope_per_mm: float = 0.0, seed: int = 1) -> HeightTrend:
    rng = np.random.default_rng(seed)
    away = HEIGHTS_MM - 250.0
    width = 1 + slope_per_mm * away + bend * away**2 + rng.normal(size=HEIGHTS_MM.size) * ERR
    trend = fit_height_trend(HEIGHTS_MM, width, np.full(HEIGHTS_MM.size, ERR))
    assert trend is not None
    return trend


def test_the_slope_of_a_straight_line_by_hand() -> None:
    width = 1 + 2e-4 * (HEIGHTS_MM - 250.0)
    trend = fit_height_trend(HEIGHTS_MM, width, np.full(HEIGHTS_MM.size, 1e-3))
    assert trend is not None
    assert trend.slope_per_mm == pytest.approx(2e-4)
    # 32 edges of error 1e-3, heights with a standard deviation of sqrt(12500) mm.
    assert trend.slope_err_per_mm == pytest.approx(1e-3 / np.sqrt(32 * 12_500))
    assert trend.change == pytest.approx(0.06)
    assert trend.is_drift
    assert [group.edges for group in trend.heights] == [8, 8, 8, 8]


def test_chance_alone_gives_even_p_values() -> None:
    trends = [trend_of(seed=s) for s in range(200)]
    for name in ("p_value", "p_value_between"):
        small = np.mean([getattr(t, name) < 0.1 for t in trends])
        assert small == pytest.approx(0.1, abs=3 * np.sqrt(0.1 * 0.9 / 200))
    assert not any(t.is_drift for t in trends)


def test_a_bend_through_best_focus_is_found_though_it_has_no_slope() -> None:
    trend = trend_of(bend=2e-6)
    assert trend.p_value > 0.01
    assert trend.p_value_between < 1e-6
    assert trend.is_drift


def test_scatter_beyond_the_errors_makes_the_test_milder() -> None:
    rng = np.random.default_rng(5)
    width = 1 + rng.normal(size=HEIGHTS_MM.size) * 0.02
    trend = fit_height_trend(HEIGHTS_MM, width, np.full(HEIGHTS_MM.size, 1e-4))
    assert trend is not None
    assert trend.heights[0].relative_width_err == pytest.approx(0.02 / np.sqrt(8), rel=0.4)
    assert trend.p_value > 0.01


def test_one_height_or_one_edge_at_each_tells_nothing() -> None:
    same = np.full(8, 100.0)
    assert fit_height_trend(same, np.ones(8), np.full(8, 0.01)) is None
    each = np.array([100.0, 200.0, 300.0])
    assert fit_height_trend(each, np.ones(3), np.full(3, 0.01)) is None
    assert fit_height_trend(np.array([]), np.array([]), np.array([])) is None


def test_heights_of_diagonal_edges_alone_have_a_relative_width_and_none_along_an_axis() -> None:
    sources = [
        replace(source, height_mm=height_mm)
        for seed, height_mm in enumerate((100.0, 150.0, 200.0))
        for source in photographs((45.0, 50.0, 130.0, 135.0), seed=seed)
    ]
    trend = calibrate_psf(sources).height_trend
    assert trend is not None
    assert [group.height_mm for group in trend.heights] == [100.0, 150.0, 200.0]
    for group in trend.heights:
        assert group.edges == 4
        # One lens at all heights.
        assert group.relative_width == pytest.approx(1.0, abs=4 * group.relative_width_err)
        assert group.sigma_x_px is group.sigma_x_err_px is None
        assert group.sigma_y_px is group.sigma_y_err_px is None
