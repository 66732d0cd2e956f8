from math import pi, sqrt

import numpy as np
import pytest
from numba import njit

from calibration.robust import median_err, robust_sigma


def test_the_scatter_is_that_of_gaussian_noise_without_its_outliers() -> None:
    noise = np.random.default_rng(2).normal(0.0, 10.0, 3000)
    noise[:30] = 5000.0
    # The variance from the MAD scatters by sqrt(2 / (0.368 * 3000)) = 4 %; 1 % of outliers
    # move the median by as much again.
    assert robust_sigma(noise) ** 2 == pytest.approx(100.0, rel=0.15)


def test_the_scatter_of_three_values_by_hand() -> None:
    # The median modulus is 2; that of a unit normal 0.67449, the quantile at 3/4.
    assert robust_sigma(np.array([-2.0, 9.0, 1.0])) == pytest.approx(2.0 / 0.6744898, rel=1e-7)


@pytest.mark.slow
def test_compiled_code_gets_the_same_scatter() -> None:
    values = np.random.default_rng(3).normal(0.0, 1.0, 100)
    compiled = njit(lambda deviations: robust_sigma(deviations))
    assert compiled(values) == robust_sigma(values)


def test_the_error_of_a_median_is_that_of_its_noise_or_of_its_scatter() -> None:
    errs = np.full((4, 1), 0.1)
    assert median_err(np.array([[1.0], [9.0]]), errs[:2]) == pytest.approx(0.1 / sqrt(2))
    few, even = np.array([[1.0], [5.0], [9.0]]), np.zeros((4, 1))
    of_three, of_four = (sqrt(pi / 2) * 0.1 / sqrt(count) for count in (3, 4))
    assert median_err(few, errs[:3]) == pytest.approx(of_three)
    assert median_err(even, errs) == pytest.approx(of_four)
    # -2 to 2: the median modulus is 1, which is that of a Gaussian of 1.4826.
    scattered = np.arange(-2.0, 3.0)[:, None]
    expected = sqrt(pi / 2) * 1.482602 / sqrt(5)
    assert median_err(scattered, errs) == pytest.approx(expected, rel=1e-6)
