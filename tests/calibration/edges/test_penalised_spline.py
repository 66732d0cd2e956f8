import numpy as np
import pytest

from calibration.edges.penalised_spline import band_solve, curve_values, fit_penalised_spline

COUNT = 40


def stiffness() -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.ones(COUNT + 3)


def test_what_is_a_spline_itself_is_returned() -> None:
    coefficients = np.sin(np.arange(COUNT) / 6.0)
    places = np.linspace(0, COUNT + 1, 2000)
    values = curve_values(places, coefficients)
    fitted, _, variance = fit_penalised_spline(places, values, np.ones(2000), stiffness())
    np.testing.assert_allclose(fitted, coefficients, atol=2e-3)
    assert variance < 1e-9


def test_a_constant_stays_constant_and_is_not_penalised() -> None:
    places = np.random.default_rng(1).uniform(0, COUNT + 1, 300)
    fitted, _, _ = fit_penalised_spline(places, np.full(300, 3.5), np.ones(300), stiffness())
    # The stiffest penalty tried is 1e6: the equations keep ten digits of sixteen.
    np.testing.assert_allclose(fitted, 3.5, rtol=1e-7)


def test_the_curve_is_flat_at_both_ends() -> None:
    coefficients = np.linspace(2.0, 5.0, COUNT)
    ends = curve_values(np.array([0.0, 1e-3, COUNT + 1 - 1e-3, COUNT + 1.0]), coefficients)
    np.testing.assert_allclose(ends, [2, 2, 5, 5], atol=1e-9)


def test_pure_noise_is_smoothed_to_little_more_than_its_mean() -> None:
    rng = np.random.default_rng(3)
    places = rng.uniform(0, COUNT + 1, 4000)
    fitted, _, variance = fit_penalised_spline(
        places, rng.normal(size=4000), np.ones(4000), stiffness()
    )
    assert np.std(fitted) < 0.06  # a quarter of what 40 free means would scatter
    assert variance == pytest.approx(1.0, abs=3 * np.sqrt(2 / 4000))


def test_the_factor_solves_the_penalised_equations() -> None:
    rng = np.random.default_rng(4)
    places = rng.uniform(0, COUNT + 1, 500)
    values = np.tanh(places - 20.0) + rng.normal(size=500) * 0.1
    fitted, factor, _ = fit_penalised_spline(places, values, np.ones(500), stiffness())
    full = np.zeros((COUNT, COUNT))
    for row in range(COUNT):
        for d in range(min(4, row + 1)):
            full[row, row - d] = factor[row, d]
    matrix = full @ full.T
    right = matrix @ fitted
    np.testing.assert_allclose(band_solve(factor, right), fitted, rtol=1e-8)


def test_a_gap_without_samples_is_bridged() -> None:
    places = np.concatenate([np.linspace(0, 12, 300), np.linspace(28, COUNT + 1, 300)])
    fitted, factor, _ = fit_penalised_spline(
        places, np.tanh((places - 20) / 8), np.ones(600), stiffness()
    )
    assert factor[0, 0] > 0
    middle = curve_values(np.array([20.0]), fitted)
    assert middle[0] == pytest.approx(0.0, abs=0.1)
