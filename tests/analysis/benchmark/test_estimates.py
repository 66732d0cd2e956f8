"""Estimates with intervals over scenes."""

import numpy as np
import pytest

from analysis.benchmark.scores import estimate, scene_numbers, share, share_of_sums


def test_a_single_scene_has_no_interval() -> None:
    found = estimate(np.array([1.0, 3.0]), np.array([0, 0]), np.mean)
    assert found is not None
    assert (found.value, found.low, found.high) == (2.0, None, None)


def test_nothing_has_no_estimate() -> None:
    assert estimate(np.array([]), np.array([], np.int64), np.mean) is None
    assert share([], np.array([], np.int64)) is None
    assert share_of_sums(np.zeros((2, 2)), np.array([0, 1])) is None


def test_whole_scenes_are_drawn_so_two_scenes_give_their_own_values_as_ends() -> None:
    # Each scene is drawn twice with a chance of 1/4, more than 2.5 %.
    found = estimate(np.array([1.0, 1.0, 5.0]), np.array([0, 0, 1]), np.mean)
    assert found is not None
    assert (found.low, found.high) == (1.0, 5.0)


def test_the_interval_of_a_mean_is_that_of_its_standard_error() -> None:
    values = np.random.default_rng(2).normal(size=400)
    found = estimate(values, np.arange(400), np.mean)
    assert found is not None
    assert found.low is not None
    assert found.high is not None
    # 1000 draws know the ends to some 7 % of the half width: a few times that.
    half = 1.96 * values.std() / 20
    assert found.high - found.value == pytest.approx(half, rel=0.2)
    assert found.value - found.low == pytest.approx(half, rel=0.2)


def test_the_interval_of_all_is_the_exact_rule_of_three_of_scenes() -> None:
    for found in (
        share([True] * 12, np.arange(12) // 3),
        share_of_sums(np.full((12, 2), 5.0), np.arange(12) // 3),
    ):
        assert found is not None
        assert found.value == found.high == 100.0
        assert found.low == pytest.approx(100 * 0.025 ** (1 / 4))


def test_scenes_are_numbered_by_name_whatever_their_order() -> None:
    assert scene_numbers(["b", "a", "b"]).tolist() == [1, 0, 1]
