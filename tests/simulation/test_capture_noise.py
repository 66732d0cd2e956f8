import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from simulation import GaussianPsf, SamplingGrid, zoom_operator
from simulation.capture_noise import CaptureNoise, propagated_variance, with_capture_noise
from simulation.choices import MODELS, Model

SHAPE = (18, 23)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("rho", [0.0, 0.3])
def test_the_variance_is_the_sum_of_squared_weights(model: Model, rho: float) -> None:
    grid = SamplingGrid.centred(SHAPE, 1.7)
    operator = zoom_operator(
        SHAPE, grid, GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.7, rho=rho), model
    )
    rng = np.random.default_rng(4)
    variance = rng.uniform(0.5, 4.0, SHAPE)
    # The dense operator, column by column, from unit images.
    expected = np.zeros((grid.rows, grid.cols))
    for row in range(SHAPE[0]):
        for col in range(SHAPE[1]):
            unit = np.zeros(SHAPE)
            unit[row, col] = 1.0
            expected += operator.apply(unit) ** 2 * variance[row, col]
    np.testing.assert_allclose(propagated_variance(operator, variance), expected, rtol=1e-9)


def test_zoom_1_keeps_the_variance() -> None:
    operator = zoom_operator(
        SHAPE, SamplingGrid.centred(SHAPE, 1.0), GaussianPsf(sigma_x_px=1, sigma_y_px=1)
    )
    variance = np.random.default_rng(1).uniform(1, 2, SHAPE)
    np.testing.assert_allclose(propagated_variance(operator, variance), variance, rtol=1e-12)


def test_a_simulated_follow_up_gets_the_noise_of_a_captured_one() -> None:
    shape = (200, 260)
    noise = CaptureNoise(
        gain_e_per_dn=5.0, read_noise_e=12.0, black_level_dn=64.0, frames_averaged=10
    )
    level = np.full(shape, 1000.0)
    rng = np.random.default_rng(7)
    variance = noise.variance_dn2(level)
    reference = level + np.sqrt(variance) * rng.standard_normal(shape)
    grid = SamplingGrid.centred(shape, 2.0)
    operator = zoom_operator(shape, grid, GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.8))
    followup = operator.apply(reference)
    own = propagated_variance(operator, variance)
    inner = np.s_[5:-5, 5:-5]
    # 90 x 120 pixels of correlated noise: the variance is known to 3 %, three of those.
    assert np.var(followup[inner]) == pytest.approx(float(own[inner].mean()), rel=0.09)
    noisy = with_capture_noise(followup, own, noise, rng)
    assert np.var(noisy[inner]) == pytest.approx(float(variance[0, 0]), rel=0.06)


def test_the_variance_of_a_level_is_worked_by_hand() -> None:
    # 500 DN of light at 5 e-/DN are 2500 e-: shot noise 50 e-; read noise 10 e-.
    noise = CaptureNoise(
        gain_e_per_dn=5.0, read_noise_e=10.0, black_level_dn=64.0, frames_averaged=4
    )
    expected = (50.0**2 + 10.0**2) / 5.0**2 / 4
    np.testing.assert_allclose(noise.variance_dn2(np.array([564.0])), [expected])
    # Below the black level there is no light that could be noisy.
    np.testing.assert_allclose(noise.variance_dn2(np.array([0.0])), [10.0**2 / 25 / 4])


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(factor=st.floats(0.1, 10.0), zoom=st.floats(1.0, 2.5))
def test_the_variance_is_linear_and_not_negative(factor: float, zoom: float) -> None:
    operator = zoom_operator(
        SHAPE, SamplingGrid.centred(SHAPE, zoom), GaussianPsf(sigma_x_px=0.7, sigma_y_px=0.9)
    )
    variance = np.random.default_rng(3).uniform(0, 2, SHAPE)
    once = propagated_variance(operator, variance)
    assert np.all(once >= 0)
    np.testing.assert_allclose(propagated_variance(operator, factor * variance), factor * once)


def test_impossible_noise_is_refused() -> None:
    operator = zoom_operator(SHAPE, SamplingGrid.centred(SHAPE, 2.0), None, "bicubic")
    with pytest.raises(ValueError):
        propagated_variance(operator, np.full(SHAPE, -1.0))
    for key, value in (
        ("gain_e_per_dn", 0.0),
        ("read_noise_e", -1.0),
        ("frames_averaged", 0),
        ("black_level_dn", np.nan),
    ):
        good = {"gain_e_per_dn": 5.0, "read_noise_e": 1.0, "black_level_dn": 0.0}
        with pytest.raises(ValueError):
            CaptureNoise(**(good | {key: value}))  # type: ignore[arg-type]  # wrong on purpose
    noise = CaptureNoise(gain_e_per_dn=1.0, read_noise_e=0.0, black_level_dn=0.0)
    with pytest.raises(ValueError):
        with_capture_noise(np.zeros((3, 3)), np.zeros((2, 2)), noise, np.random.default_rng(0))
