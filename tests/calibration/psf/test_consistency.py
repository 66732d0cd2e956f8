"""Each fault is named at about twice the strength that matters, and nothing without one."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.edges import EdgeMeasurement
from calibration.psf import HeightTrend, psf_of_images
from calibration.psf._calibration import _psf_of_edges
from calibration.psf._consistency import _check_edges, _check_heights, fit_height_trend
from tests.calibration.edge_photographs import photographs
from tests.calibration.known import known
from tests.calibration.psf.measured_edges import edge, series, square

HEIGHTS_MM = (180.0, 220.0, 270.0, 330.0, 400.0)


def named(edges: list[EdgeMeasurement]) -> set[str]:
    found = known(_psf_of_edges(edges).cross_validation)
    return {one.kind for one in found.named}


def test_nothing_is_named_where_nothing_is_wrong() -> None:
    assert named(series(np.random.default_rng(1))) == set()


def test_a_soft_target_is_named() -> None:
    assert named(series(np.random.default_rng(2), blur_mm=0.1)) == {"soft_target"}


def test_a_focus_that_drifts_with_the_height_is_named() -> None:
    rng = np.random.default_rng(3)
    edges: list[EdgeMeasurement] = []
    for capture, height_mm in enumerate(HEIGHTS_MM):
        edges += square(0.4 + 0.0005 * (height_mm - 180.0), height_mm, capture, rng)
    assert named(edges) == {"focus_drift"}


def test_a_focus_that_scatters_is_named() -> None:
    rng = np.random.default_rng(4)
    offsets = (0.05, -0.06, 0.04, -0.03, 0.05, -0.04)
    edges = [
        one
        for capture, offset in enumerate(offsets)
        for one in square(0.5 + offset, 250.0, capture, rng)
    ]
    assert named(edges) == {"focus_scatter"}


def test_a_stage_that_wanders_is_named() -> None:
    rng = np.random.default_rng(5)
    edges: list[EdgeMeasurement] = []
    away_mm = (3.0, -4.0, 5.0, -6.0, 7.0)
    for capture, (height_mm, away) in enumerate(zip(HEIGHTS_MM, away_mm, strict=True)):
        edges += square(0.5, height_mm, capture, rng, read_mm=height_mm + away)
    assert named(edges) == {"stage"}


def test_halves_that_agree_have_a_chi_squared_of_one() -> None:
    rng = np.random.default_rng(6)
    edges = [one for k in range(60) for one in square(0.5, 200.0 + 3.0 * k, k, rng)]
    for found in (_check_edges(edges), _check_heights(edges)):
        assert found is not None
        # 120 edges: a reduced chi-squared scatters by 0.13, three and a half of those.
        assert found.chi2_reduced == pytest.approx(1.0, abs=0.45)


def test_too_few_edges_have_no_halves() -> None:
    assert _check_edges([edge()]) is None
    assert _check_heights([edge()]) is None


TREND_HEIGHTS_MM = np.repeat([100.0, 200.0, 300.0, 400.0], 8)
ERR = 0.005


def trend_of(bend: float = 0.0, slope_per_mm: float = 0.0, seed: int = 1) -> HeightTrend:
    rng = np.random.default_rng(seed)
    away = TREND_HEIGHTS_MM - 250.0
    width = 1 + slope_per_mm * away + bend * away**2 + rng.normal(size=TREND_HEIGHTS_MM.size) * ERR
    return known(fit_height_trend(TREND_HEIGHTS_MM, width, np.full(TREND_HEIGHTS_MM.size, ERR)))


def test_the_slope_of_a_straight_line_by_hand() -> None:
    width = 1 + 2e-4 * (TREND_HEIGHTS_MM - 250.0)
    trend = known(fit_height_trend(TREND_HEIGHTS_MM, width, np.full(TREND_HEIGHTS_MM.size, 1e-3)))
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
    width = 1 + rng.normal(size=TREND_HEIGHTS_MM.size) * 0.02
    trend = known(fit_height_trend(TREND_HEIGHTS_MM, width, np.full(TREND_HEIGHTS_MM.size, 1e-4)))
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
    trend = known(psf_of_images(sources).height_trend)
    assert [group.height_mm for group in trend.heights] == [100.0, 150.0, 200.0]
    for group in trend.heights:
        assert group.edges == 4
        # One lens at all heights.
        assert group.relative_width == pytest.approx(1.0, abs=4 * group.relative_width_err)
        assert group.sigma_x_px is group.sigma_x_err_px is None
        assert group.sigma_y_px is group.sigma_y_err_px is None
