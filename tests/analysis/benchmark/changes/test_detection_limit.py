"""Limits of detection from spots that are found or not."""

from math import exp, inf, log

import numpy as np
import pytest

from analysis.benchmark._changes_track import limit_estimate, limits_of
from simulation.arrays import BoolArray, FloatArray


def limit_of(
    amplitudes: FloatArray, is_found: BoolArray, weights: FloatArray, share: float
) -> float:
    return float(limits_of(amplitudes, is_found[None], weights[None], [share])[0, 0])


def test_the_limit_of_an_ideal_observer_is_its_threshold() -> None:
    # Amplitudes lie symmetric about 10 DN in their logarithm, so whatever the penalty of a steep
    # curve is, the amplitude of 50 % is 10 DN.
    steps = np.arange(-7.5, 8) / 5
    amplitudes = 10 * np.exp(steps)
    found = limit_of(amplitudes, amplitudes > 10, np.ones(16), 0.5)
    assert found == pytest.approx(10.0, rel=1e-6)
    higher = limit_of(amplitudes, amplitudes > 10, np.ones(16), 0.8)
    assert 10.0 < higher < amplitudes[10]  # two steps further


def test_a_logistic_curve_is_found_again() -> None:
    # As many spots of each amplitude as the curve says, so many that the penalty is nothing.
    level, slope = -6.0, 2.0
    amplitudes = np.exp(np.linspace(1, 5, 9))
    chance = 1 / (1 + np.exp(-(level + slope * np.log(amplitudes))))
    both = np.tile(amplitudes, 2)
    is_found = np.repeat([True, False], 9)
    weights = 1e6 * np.concatenate([chance, 1 - chance])
    assert limit_of(both, is_found, weights, 0.5) == pytest.approx(exp(3), rel=1e-5)
    wanted = exp((log(4) - level) / slope)
    assert limit_of(both, is_found, weights, 0.8) == pytest.approx(wanted, rel=1e-5)


def test_a_limit_beyond_the_largest_amplitude_is_a_bound_and_no_extrapolation() -> None:
    amplitudes = np.array([1.0, 2.0, 4.0])
    value = limit_of(amplitudes, np.zeros(3, np.bool_), np.ones(3), 0.5)
    assert value == inf
    found = limit_estimate(amplitudes, np.array([value, 3.0, inf, inf]))
    assert (found.relation, found.value, found.high) == (">", 4.0, None)


def test_a_limit_below_the_smallest_amplitude_is_a_bound() -> None:
    amplitudes = np.array([1.0, 2.0, 4.0])
    value = limit_of(amplitudes, np.ones(3, np.bool_), np.ones(3), 0.5)
    found = limit_estimate(amplitudes, np.array([value]))
    assert found.relation == "<"
    assert found.value == pytest.approx(1.0)


def test_what_finds_the_faint_and_misses_the_strong_has_no_limit() -> None:
    amplitudes = np.array([1.0, 2.0, 4.0, 8.0])
    assert limit_of(amplitudes, amplitudes < 2, np.ones(4), 0.5) == inf


def test_draws_are_fitted_as_each_would_be_alone() -> None:
    rng = np.random.default_rng(3)
    amplitudes = np.exp(rng.uniform(0, 4, 40))
    is_found = rng.uniform(size=(5, 40)) < amplitudes / 60
    weights = rng.integers(0, 3, (5, 40)).astype(np.float64)
    together = limits_of(amplitudes, is_found, weights, [0.5, 0.8])
    for at in range(5):
        alone = limits_of(amplitudes, is_found[at : at + 1], weights[at : at + 1], [0.5, 0.8])
        np.testing.assert_allclose(together[:, at], alone[:, 0], rtol=1e-6)
