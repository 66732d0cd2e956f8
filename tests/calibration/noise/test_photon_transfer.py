"""How well the noise of a pixel is known from what noise.json states."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from pydantic import ValidationError

from calibration.errors import NoiseError, NoiseReason
from calibration.noise import (
    LevelNoise,
    LevelSample,
    NoiseCalibration,
    Saturation,
    fit_level_noise,
    fit_photon_transfer,
)
from calibration.noise._measurement import _VarianceByLevel
from calibration.noise._photon_transfer import _measure_linearity
from simulation.arrays import FloatArray
from tests.calibration.poisson_frames import (
    BLACK_DN,
    GAIN_E_PER_DN,
    READ_NOISE_E,
    SATURATION,
    TOP_DN,
    frames_dn,
    ladder,
    sample,
)


def exact(kind: str, light_dn: float, exposure_us: float) -> LevelSample:
    """A capture without any scatter, by the linear camera model."""
    read_dn2 = (READ_NOISE_E / GAIN_E_PER_DN) ** 2 + 1 / 12
    return LevelSample(
        kind="dark" if kind == "dark" else "flat",
        capture=kind,
        mean_dn=BLACK_DN + light_dn,
        variance_dn2=read_dn2 + light_dn / GAIN_E_PER_DN,
        pixels=10_000,
        frames=16,
        exposure_us=exposure_us,
        time_s=0.0,
    )


def changed(sample: LevelSample, **values: Any) -> LevelSample:
    return sample.model_copy(update=values)


EXACT = [exact("dark", 0.0, 21.0), *(exact("flat", 400.0 * k, 1000.0 * k) for k in (1, 2, 4, 6))]


def test_the_linear_camera_model_is_inverted_exactly() -> None:
    found = fit_photon_transfer(EXACT, SATURATION)
    assert found.gain_e_per_dn == pytest.approx(GAIN_E_PER_DN, rel=1e-9)
    assert found.read_noise_e == pytest.approx(READ_NOISE_E, rel=1e-7)
    assert found.dark.black_level_dn == pytest.approx(BLACK_DN, rel=1e-12)
    assert found.saturation_e == pytest.approx(GAIN_E_PER_DN * (TOP_DN - BLACK_DN))
    assert found.linearity is not None
    assert found.linearity.worst_deviation < 1e-12
    assert found.light_flicker == 0.0


def test_poisson_frames_give_their_gain_and_read_noise_with_honest_errors() -> None:
    pulls = []
    for seed in range(40):
        found = fit_photon_transfer(ladder(np.random.default_rng([7, seed])), SATURATION)
        pulls.append(
            (
                (found.gain_e_per_dn - GAIN_E_PER_DN) / found.gain_e_per_dn_err,
                (found.read_noise_e - READ_NOISE_E) / found.read_noise_e_err,
            )
        )
        assert found.gain_e_per_dn == pytest.approx(GAIN_E_PER_DN, rel=0.02)
        assert found.read_noise_e == pytest.approx(READ_NOISE_E, rel=0.02)
    inside = np.mean(np.abs(pulls) < 2, axis=0)
    assert np.all(inside >= 0.85)  # 95 % of 40 seeds, less three binomial deviations
    assert np.all(np.std(pulls, axis=0) < 1.4)


def test_light_that_flickers_does_not_change_the_gain() -> None:
    found = fit_photon_transfer(
        ladder(
            np.random.default_rng(3),
            exposures=(500.0, 1000.0, 2000.0, 3000.0, 4000.0, 5000.0, 6000.0, 7000.0, 8000.0),
            flicker=0.01,
        ),
        SATURATION,
    )
    plain_gain = GAIN_E_PER_DN
    assert found.light_flicker == pytest.approx(0.01, rel=0.5)  # 8 frames: 25 %
    assert abs(found.gain_e_per_dn - plain_gain) < 3 * found.gain_e_per_dn_err
    assert any("flickers" in text for text in found.notes)


def test_a_drift_of_the_light_is_taken_out_where_exposures_come_twice() -> None:
    drifting = [
        changed(one, time_s=10.0 * k, mean_dn=BLACK_DN + 400.0 * e * (1 + 0.001 * k))
        for k, (one, e) in enumerate(
            (exact("flat", 400.0 * e, 1000.0 * e), e) for e in (1, 2, 3, 4, 6, 1, 6)
        )
    ]
    found = fit_photon_transfer([EXACT[0], *drifting], SATURATION)
    assert found.linearity is not None
    assert found.linearity.worst_deviation < 1e-5  # second order of 0.6 %
    assert found.linearity.light_drift_per_s == pytest.approx(1e-4, rel=0.02)


def test_dark_current_is_told_from_the_black_level() -> None:
    darks = [
        changed(exact("dark", 0.0, t), mean_dn=BLACK_DN + 1e-4 * t)
        for t in (100.0, 3000.0, 9000.0, 20000.0)
    ]
    found = fit_photon_transfer([*darks, *EXACT[1:]], SATURATION)
    assert found.dark.black_level_dn == pytest.approx(BLACK_DN, abs=1e-3)
    assert found.dark.current_e_per_s == pytest.approx(1e-4 * 1e6 * GAIN_E_PER_DN, rel=1e-3)


def test_flats_above_the_fit_range_are_left_out() -> None:
    odd = changed(exact("flat", 3500.0, 9000.0), variance_dn2=5.0)
    found = fit_photon_transfer([*EXACT, odd], SATURATION)
    assert found.gain_e_per_dn == pytest.approx(GAIN_E_PER_DN, rel=1e-9)
    assert found.samples[-1].is_fitted is False


@pytest.mark.parametrize(
    ("samples", "reason", "saturated"),
    [
        (EXACT[1:], "no_dark", 0),
        (EXACT[:1], "no_flat", 0),
        (EXACT[:3], "levels", 0),
        ([*EXACT[:3], changed(EXACT[3], clipped_fraction=0.5)], "levels", 1),
        ([*EXACT[:3], EXACT[1], EXACT[2]], "levels", 0),
        ([EXACT[0], *(changed(s, variance_dn2=5.84) for s in EXACT[1:])], "no_gain", 0),
    ],
)
def test_captures_that_tell_no_gain_are_refused_in_one_line(
    samples: list[LevelSample], reason: NoiseReason, saturated: int
) -> None:
    with pytest.raises(NoiseError) as refused:
        fit_photon_transfer(samples, SATURATION)
    assert (refused.value.reason, refused.value.saturated) == (reason, saturated)
    assert "\n" not in str(refused.value)


def test_a_dark_level_cut_off_at_zero_is_noted() -> None:
    low = changed(EXACT[0], mean_dn=1.0)
    flats = [changed(s, mean_dn=s.mean_dn - 63.0) for s in EXACT[1:]]
    found = fit_photon_transfer([low, *flats], SATURATION)
    assert any("BlackLevel" in text for text in found.notes)


@pytest.mark.parametrize("top_e", [15_000.0, 1e9])
def test_saturation_is_where_the_variance_collapses(top_e: float) -> None:
    rng = np.random.default_rng(4)
    levels = _VarianceByLevel(TOP_DN)
    for electrons in (5000.0, 10_000.0, 14_000.0, 19_000.0, 30_000.0):
        collected = np.minimum(rng.poisson(electrons, (6, 60, 80)), top_e)
        noisy = collected + READ_NOISE_E * rng.standard_normal(collected.shape)
        stack = np.clip(np.rint(BLACK_DN + noisy / GAIN_E_PER_DN), 0, TOP_DN)
        levels.add(stack.mean(axis=0), stack.var(axis=0, ddof=1))
    found = levels.saturation()
    expected = min(BLACK_DN + top_e / GAIN_E_PER_DN, TOP_DN)
    assert found.is_reached
    assert found.level_dn == pytest.approx(expected, abs=1.5)


def test_saturation_that_no_flat_reached_is_the_formats() -> None:
    levels = _VarianceByLevel(TOP_DN)
    stack = frames_dn(np.random.default_rng(1), 5000.0)
    levels.add(stack.mean(axis=0), stack.var(axis=0, ddof=1))
    assert levels.saturation() == Saturation(level_dn=TOP_DN, err_dn=None)
    found = fit_photon_transfer(EXACT, levels.saturation())
    assert any("expose longer" in text for text in found.notes)


def test_a_sample_of_one_frame_is_refused() -> None:
    with pytest.raises(ValidationError) as refused:
        sample(frames_dn(np.random.default_rng(1), 10.0, frames=1), 1.0)
    assert [error["loc"] for error in refused.value.errors()] == [("frames",)]


def test_three_flats_and_a_dark_give_a_line_and_no_bend() -> None:
    # A bend of three figures would leave one of four captures to check it.
    bent = [changed(s, variance_dn2=s.variance_dn2 * (1 + 0.002 * k)) for k, s in enumerate(EXACT)]
    found = fit_photon_transfer(bent[:4], SATURATION)
    assert found.curvature == 0.0
    assert found.light_flicker == 0.0
    assert found.gain_e_per_dn == pytest.approx(GAIN_E_PER_DN, rel=0.02)


def test_read_noise_below_the_rounding_is_zero_and_noted() -> None:
    # 0.05 DN^2 in the dark, where rounding alone makes 1/12.
    quiet = [changed(s, variance_dn2=s.variance_dn2 - EXACT[0].variance_dn2 + 0.05) for s in EXACT]
    found = fit_photon_transfer(quiet, SATURATION)
    assert found.read_noise_e == 0.0
    assert found.read_noise_e_err > 0.0
    assert found.gain_e_per_dn == pytest.approx(GAIN_E_PER_DN, rel=1e-9)
    assert "the read noise is below the rounding to whole DN and cannot be measured" in found.notes


def test_a_variance_that_bends_down_is_noted_and_its_slope_in_the_dark_is_the_gain() -> None:
    bent = [
        changed(s, variance_dn2=s.variance_dn2 - 1e-5 * (s.mean_dn - BLACK_DN) ** 2) for s in EXACT
    ]
    found = fit_photon_transfer(bent, SATURATION)
    assert found.curvature == pytest.approx(-1e-5, rel=1e-6)
    assert found.light_flicker == 0.0
    assert found.gain_e_per_dn == pytest.approx(GAIN_E_PER_DN, rel=1e-9)
    assert any("a nonlinear camera" in text for text in found.notes)


def test_two_exposures_tell_no_linearity() -> None:
    # Of four flats two lie between 5 and 95 % of the range.
    levels = [(e, 0.0, light) for e, light in ((10.0, 10.0), (500.0, 500.0), (900.0, 900.0))]
    assert _measure_linearity([*levels, (990.0, 0.0, 990.0)], range_dn=1000.0) is None
    assert _measure_linearity([*levels, (700.0, 0.0, 700.0)], range_dn=1000.0) is not None


def test_a_few_pixels_tell_no_saturation() -> None:
    levels = _VarianceByLevel(TOP_DN)
    # 20 pixels at each of two levels, the upper without variance as if clipped.
    levels.add(np.repeat([1000.0, 3000.0], 20), np.repeat([200.0, 0.0], 20))
    assert levels.saturation() == Saturation(level_dn=TOP_DN, err_dn=None)
    levels.add(np.repeat([1000.0, 3000.0], 20), np.repeat([200.0, 0.0], 20))
    assert levels.saturation().level_dn == pytest.approx(3000.0)


def test_a_dark_current_within_its_error_is_none_but_its_bound_is_told() -> None:
    # By hand: levels without a trend over the exposure, 0.01 DN to and fro.
    wander = ((100.0, 0.01), (5000.0, -0.01), (10_000.0, -0.01), (14_900.0, 0.01))
    darks = [changed(exact("dark", 0.0, t), mean_dn=BLACK_DN + dn) for t, dn in wander]
    found = fit_photon_transfer([*darks, *EXACT[1:]], SATURATION)
    assert found.dark.rate_dn_per_us == 0.0
    assert found.dark.black_level_dn == pytest.approx(BLACK_DN, abs=1e-9)
    assert found.dark.current_e_per_s is not None
    assert found.dark.current_e_per_s_err is not None
    # 0.01 sqrt(4 / 2) over sqrt(sum of squares about the mean exposure), in e/s.
    expected = 0.01 * np.sqrt(2) / np.sqrt(2 * (7400.0**2 + 2500.0**2)) * 1e6 * GAIN_E_PER_DN
    assert found.dark.current_e_per_s_err == pytest.approx(expected, rel=0.01)
    assert abs(found.dark.current_e_per_s) < found.dark.current_e_per_s_err


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


def noise(read_noise_e: float) -> NoiseCalibration:
    return NoiseCalibration(
        gain_e_per_dn=5.0,
        gain_e_per_dn_err=0.5,
        read_noise_e=read_noise_e,
        read_noise_e_err=0.1 * read_noise_e,
        black_level_dn=64.0,
        frames_averaged=1,
    )


def test_shot_noise_goes_with_the_root_of_the_gain() -> None:
    assert noise(0.0).relative_err(2000.0) == pytest.approx(0.05)


def test_read_noise_goes_with_gain_and_electrons() -> None:
    # At the black level: read noise in DN is electrons over gain, each known to 10 %.
    assert noise(20.0).relative_err(64.0) == pytest.approx(0.1 * 2**0.5)
