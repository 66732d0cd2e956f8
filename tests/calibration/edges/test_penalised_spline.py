import numpy as np
import pytest

from calibration.edges._penalised_spline import (
    SplineFit,
    curve_values,
    fit_penalised_spline,
    variances,
)
from simulation.arrays import FloatArray

COUNT = 40


def fitted(
    places: FloatArray, values: FloatArray, terms: FloatArray | None = None, sd: float = 1.0
) -> SplineFit:
    shapes = np.empty((places.size, 0)) if terms is None else terms
    return fit_penalised_spline(
        places,
        values,
        np.full(places.size, sd**-2),
        shapes,
        np.zeros(shapes.shape[1]),
        np.ones(COUNT + 3),
    )


def uniform(seed: int, size: int) -> FloatArray:
    return np.random.default_rng(seed).uniform(0, COUNT + 1, size)


def test_what_is_a_spline_itself_is_returned() -> None:
    coefficients = np.sin(np.arange(COUNT) / 6.0)
    places = np.linspace(0, COUNT + 1, 2000)
    fit = fitted(places, curve_values(places, coefficients), sd=1e-4)
    # Noise of 1e-4 in 50 samples a knot.
    np.testing.assert_allclose(fit.coefficients, coefficients, atol=1e-3)


def test_a_constant_stays_constant_and_is_not_penalised() -> None:
    fit = fitted(uniform(1, 300), np.full(300, 3.5))
    # The stiffest penalty tried is 1e6: the equations keep ten digits of sixteen.
    np.testing.assert_allclose(fit.coefficients, 3.5, rtol=1e-7)


def test_the_curve_is_flat_at_both_ends() -> None:
    coefficients = np.linspace(2.0, 5.0, COUNT)
    ends = curve_values(np.array([0.0, 1e-3, COUNT + 1 - 1e-3, COUNT + 1.0]), coefficients)
    np.testing.assert_allclose(ends, [2, 2, 5, 5], atol=1e-9)


def test_pure_noise_is_smoothed_to_little_more_than_its_mean() -> None:
    noise = np.random.default_rng(3).normal(size=4000)
    assert np.std(fitted(uniform(3, 4000), noise).coefficients) < 0.06  # 40 free means: 0.1


def test_a_known_term_is_found_beside_noise_and_takes_the_spline_s_part() -> None:
    places = uniform(4, 3000)
    term = np.tanh(places - 20.0)[:, None]
    noise = np.random.default_rng(5).normal(size=3000) * 0.1
    fit = fitted(places, 2.0 * term[:, 0] + noise, term, 0.1)
    # A step known from both sides: 0.1 / sqrt(3000), and a few times that with a free spline.
    assert fit.terms[0] == pytest.approx(2.0, abs=0.02)
    left = curve_values(np.linspace(1, COUNT, 50), fit.coefficients)
    np.testing.assert_allclose(left, 0.0, atol=0.04)


def test_the_variances_are_the_bordered_inverse() -> None:
    places = uniform(6, 500)
    term = np.tanh(places - 20.0)[:, None]
    noise = np.random.default_rng(7).normal(size=500) * 0.1
    fit = fitted(places, np.sin(places / 5) + term[:, 0] + noise, term, 0.1)
    lower = np.zeros((COUNT + 1, COUNT + 1))
    for row in range(COUNT):
        for d in range(min(4, row + 1)):
            lower[row, row - d] = fit.factor[row, d]
    lower[COUNT, :COUNT] = fit.cross[:, 0]
    lower[COUNT, COUNT] = fit.border[0, 0]
    inverse = fit.scale * np.linalg.inv(lower @ lower.T)
    chosen = np.random.default_rng(8).normal(size=(COUNT + 1, 3))
    expected = np.einsum("ik,ij,jk->k", chosen, inverse, chosen)
    found = variances(fit, chosen[:COUNT], chosen[COUNT:])
    np.testing.assert_allclose(found, expected, rtol=1e-8)


@pytest.mark.slow
def test_the_variances_cover_a_curve_that_is_no_spline() -> None:
    at = np.linspace(2, COUNT - 1, 60)
    pulls = []
    for seed in range(20):
        places = uniform(seed, 800)
        noise = np.random.default_rng(100 + seed).normal(size=800) * 0.2
        fit = fitted(places, np.sin(places / 4) + noise, sd=0.2)
        basis = np.column_stack([curve_values(at, unit) for unit in np.eye(COUNT)])
        sd = np.sqrt(variances(fit, np.ascontiguousarray(basis.T), np.empty((0, at.size))))
        pulls.append((curve_values(at, fit.coefficients) - np.sin(at / 4)) / sd)
    # 1200 points, of which some 15 a curve are independent: 0.95 +- 0.013.
    assert 0.90 < np.mean(np.abs(pulls) < 1.96) < 0.99


def test_a_gap_without_samples_is_bridged() -> None:
    places = np.concatenate([np.linspace(0, 12, 300), np.linspace(28, COUNT + 1, 300)])
    fit = fitted(places, np.tanh((places - 20) / 8), sd=1e-3)
    assert fit.is_found
    assert curve_values(np.array([20.0]), fit.coefficients)[0] == pytest.approx(0.0, abs=0.1)
