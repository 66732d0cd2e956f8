import numpy as np
import pytest
from hypothesis import given, strategies as st

from calibration.noise import LevelNoise, fit_level_noise
from simulation.arrays import FloatArray

OFFSET_DN2, SLOPE_DN = 6.0, 0.11
FRAMES = 10


def noisy_ramp(rng: np.random.Generator, pixels: int = 20_000) -> tuple[FloatArray, FloatArray]:
    """Levels from 64 to 3500 DN and the unbiased variance of 10 Gaussian samples of each."""
    mean = rng.uniform(64.0, 3500.0, pixels)
    line = OFFSET_DN2 + SLOPE_DN * mean
    return mean, line * rng.chisquare(FRAMES - 1, pixels) / (FRAMES - 1)


def test_exact_variances_give_the_exact_line() -> None:
    mean = np.linspace(100.0, 3000.0, 5000).reshape(50, 100)
    noise = fit_level_noise(mean, OFFSET_DN2 + SLOPE_DN * mean, 4095.0)
    assert noise.slope_dn == pytest.approx(SLOPE_DN, rel=1e-9)
    assert noise.offset_dn2 == pytest.approx(OFFSET_DN2, rel=1e-6)


def test_the_photon_transfer_line_is_recovered_within_its_sampling_error() -> None:
    rng = np.random.default_rng(3)
    fits, bounds = [], []
    for _ in range(40):
        mean, variance = noisy_ramp(rng)
        noise = fit_level_noise(mean, variance, 4095.0)
        fits.append((noise.offset_dn2, noise.slope_dn))
        # The variance of a sample variance of n Gaussian values is 2 v^2 / (n - 1).
        weight = (FRAMES - 1) / (2 * (OFFSET_DN2 + SLOPE_DN * mean) ** 2)
        design = np.column_stack([np.ones_like(mean), mean])
        bounds.append(np.linalg.inv(design.T @ (weight[:, None] * design)))
    errors = np.sqrt(np.diag(np.mean(bounds, axis=0)))
    bias = np.mean(fits, axis=0) - (OFFSET_DN2, SLOPE_DN)
    assert np.all(np.abs(bias) < 4 * errors / np.sqrt(40))
    # 40 draws know their own scatter to 11 %: three of those.
    np.testing.assert_allclose(np.std(fits, axis=0), errors, rtol=0.35)


def test_the_clipped_variance_of_saturated_pixels_is_left_out() -> None:
    mean = np.concatenate([np.linspace(100.0, 3000.0, 3000), np.full(3000, 4095.0)])
    variance = np.where(mean < 4000.0, OFFSET_DN2 + SLOPE_DN * mean, 0.0)
    assert fit_level_noise(mean, variance, 4095.0).slope_dn == pytest.approx(SLOPE_DN, rel=1e-9)


@pytest.mark.parametrize("level_dn", [0.0, 1000.1, 1234.567, 60_000.3])
def test_a_single_level_has_no_slope(level_dn: float) -> None:
    noise = fit_level_noise(np.full((20, 30), level_dn), np.full((20, 30), 9.0), 65_535.0)
    assert noise.slope_dn == 0.0
    assert noise.offset_dn2 == pytest.approx(9.0)


def test_a_capture_of_identical_frames_still_has_a_positive_floor() -> None:
    mean = np.linspace(0.0, 100.0, 400)
    noise = fit_level_noise(mean, np.zeros(400), 255.0)
    assert np.all(noise.variance_dn2(mean) > 0)


@given(level=st.floats(-1e6, 1e6), slope=st.floats(-1.0, 1.0), offset=st.floats(-100.0, 100.0))
def test_the_variance_never_falls_below_the_floor(
    level: float, slope: float, offset: float
) -> None:
    noise = LevelNoise(offset_dn2=offset, slope_dn=slope, floor_dn2=0.25)
    variance = float(noise.variance_dn2(np.array([level]))[0])
    assert variance == max(offset + slope * level, 0.25)


def test_a_mean_of_frames_has_their_share_of_the_variance() -> None:
    mean = LevelNoise(offset_dn2=6.0, slope_dn=0.5, floor_dn2=1.0).averaged(10)
    # By hand: (6 + 0.5 * 100) / 10 and the floor of 1 / 10.
    np.testing.assert_allclose(mean.variance_dn2(np.array([100.0, -50.0])), [5.6, 0.1])


def test_fewer_than_100_unsaturated_pixels_are_too_few() -> None:
    mean = np.concatenate([np.linspace(10.0, 200.0, 99), np.full(500, 255.0)])
    fit_level_noise(np.linspace(10.0, 200.0, 100), np.ones(100), 255.0)
    with pytest.raises(ValueError):
        fit_level_noise(mean, np.ones(599), 255.0)


@pytest.mark.parametrize("floor_dn2", [0.0, -1.0, float("nan")])
def test_a_floor_that_is_not_positive_is_refused(floor_dn2: float) -> None:
    with pytest.raises(ValueError):
        LevelNoise(offset_dn2=1.0, slope_dn=0.0, floor_dn2=floor_dn2)
