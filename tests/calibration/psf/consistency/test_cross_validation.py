"""Each fault is named at about twice the strength that matters, and nothing without one."""

import numpy as np
import pytest

from calibration.edges import EdgeMeasurement
from calibration.psf.calibration import psf_of_edges
from calibration.psf.consistency import check_edges, check_heights
from tests.calibration.psf.consistency.measured_edges import edge, series, square

HEIGHTS_MM = (180.0, 220.0, 270.0, 330.0, 400.0)


def named(edges: list[EdgeMeasurement]) -> set[str]:
    found = psf_of_edges(edges).cross_validation
    assert found is not None
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
    for found in (check_edges(edges), check_heights(edges)):
        assert found is not None
        # 120 edges: a reduced chi-squared scatters by 0.13, three and a half of those.
        assert found.chi2_reduced == pytest.approx(1.0, abs=0.45)


def test_too_few_edges_have_no_halves() -> None:
    assert check_edges([edge()]) is None
    assert check_heights([edge()]) is None
