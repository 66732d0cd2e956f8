import numpy as np
import pytest

from simulation.zoom_kernels import ImageCovariance, largest_variance, shortest
from tests.simulation.exact_photographs import FloatArray


def gaussian(freq: FloatArray) -> FloatArray:
    return np.asarray(np.exp(-2 * (np.pi * 1.0 * freq) ** 2))


COVARIANCE = ImageCovariance.seen_through(gaussian, 80)
PLACE = np.arange(80) - 39.5
BUMP = np.exp(-(PLACE**2) / (2 * 1.5**2)) / np.exp(-(PLACE**2) / (2 * 1.5**2)).sum()
TAIL = 1e-3 * np.cos(np.pi * np.arange(80)) * np.cos(np.pi * PLACE / 80) ** 2
WITH_TAIL = (BUMP + TAIL)[None]


def test_an_alternating_tail_costs_no_weights_and_a_constant_and_a_ramp_stay() -> None:
    short = shortest(WITH_TAIL, COVARIANCE, 1.0)
    taps = short.shape[1]
    assert taps <= 16
    place = np.arange(taps) - (taps - 1) / 2
    assert short.sum() == pytest.approx(WITH_TAIL.sum(), abs=1e-12)
    assert (short @ place)[0] == pytest.approx((WITH_TAIL @ PLACE)[0], abs=1e-10)


def test_images_seen_through_the_lens_hardly_change() -> None:
    short = shortest(WITH_TAIL, COVARIANCE, 1.0)
    padding = (80 - short.shape[1]) // 2
    change = WITH_TAIL - np.pad(short, ((0, 0), (padding, padding)))
    # 1e-6 of it is the noise that is reckoned with, on the tail that was left out.
    assert largest_variance(change, COVARIANCE) <= 1.01 * COVARIANCE.tolerance


def test_a_difference_that_matters_is_kept_whole() -> None:
    far = np.zeros((1, 80))
    far[0, [0, 79]] = 0.5
    np.testing.assert_array_equal(shortest(far, COVARIANCE, 1.0), far)
