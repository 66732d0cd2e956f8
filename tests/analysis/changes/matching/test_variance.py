"""The scatter of a difference: its terms, its calibration."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from analysis.changes.matching.matching_kernel import fit_tone_curve
from analysis.changes.matching.smoothed_warp import PixelPositions
from analysis.changes.matching.variance import GRADIENT, VarianceTerms, calibrated_factor, fit_sizes
from simulation.arrays import Float32Array, FloatArray

SHAPE = (300, 320)


def same(y: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    return y, x


PLACED = PixelPositions.of(same, SHAPE, SHAPE)
EVERYWHERE = np.ones(SHAPE, dtype=np.bool_)


def test_the_variance_is_taken_apart_into_what_it_was_made_of() -> None:
    rng = np.random.default_rng(4)
    scene = (100 + gaussian_filter(rng.standard_normal(SHAPE), 2.0) * 300).astype(np.float32)
    along_y, along_x = np.gradient(scene)
    slope = np.sqrt((along_y**2 + along_x**2) / 2)
    difference = 1.5 * rng.standard_normal(SHAPE) + 0.2 * slope * rng.standard_normal(SHAPE)
    terms = VarianceTerms.of(scene, scene, scene, PLACED)
    rows, cols = np.nonzero(EVERYWHERE)
    sizes = fit_sizes(difference.ravel(), terms.at(rows, cols), None)
    # Clipping at 3.5 standard deviations takes 0.7 % of the variance.
    assert terms.noise_dn2(sizes, EVERYWHERE) == pytest.approx(1.5**2, rel=0.05)
    assert np.sqrt(sizes[GRADIENT]) == pytest.approx(0.2, rel=0.06)
    expected = 1.5**2 + (0.2 * slope) ** 2
    assert np.median(terms.variance(sizes) / expected) == pytest.approx(1.0, abs=0.04)
    floor = np.full(SHAPE, np.float32(100))
    assert terms.variance(sizes, floor).min() == 100


def test_a_variance_that_is_wrong_by_a_factor_is_put_right_in_spite_of_changes() -> None:
    rng = np.random.default_rng(6)
    sd = np.where(np.arange(SHAPE[1]) < 160, 1.0, 4.0) * np.ones(SHAPE)
    difference = sd * rng.standard_normal(SHAPE)
    predicted: Float32Array = np.where(sd > 2, 4.0, 1.0).astype(
        np.float32
    )  # 4 times too small on the right
    difference[50:60, 50:60] += 30.0
    factor = calibrated_factor(
        difference.astype(np.float32), predicted, np.float32(0.5) * predicted, EVERYWHERE, 0.3
    )
    # 48,000 pixels tell a robust spread to 0.5 %; 1.33 scatters of the tail are forgiven.
    assert np.median(factor[:, :150]) == pytest.approx(1.0, rel=0.03)
    assert np.median(factor[:, 170:]) == pytest.approx(2.0, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("gamma", [0.45, 1.8])
def test_a_tone_curve_is_found_to_a_fraction_of_the_noise(gamma: float) -> None:
    rng = np.random.default_rng(7)
    light = np.clip(110 + gaussian_filter(rng.standard_normal(SHAPE), 3.0) * 300, 15, 240)
    noise = rng.normal(0, 1.0, (2, *SHAPE))
    source = gaussian_filter(light + noise[0], 1.0).astype(np.float32)
    target = (255 * (np.maximum(light + noise[1], 0) / 255) ** gamma).astype(np.float32)
    valid = EVERYWHERE.copy()
    valid[:8] = valid[-8:] = valid[:, :8] = valid[:, -8:] = False
    curve = fit_tone_curve(source, target, valid, 1.0)
    assert curve is not None
    levels = np.quantile(target, np.linspace(0.03, 0.97, 40)).astype(np.float32)
    truth = 255 * (levels / 255) ** (1 / gamma)
    error = curve.of(levels) - truth
    # Up to the gain and the offset, which the kernel has; noise 1 DN.
    error -= np.polyval(np.polyfit(truth, error, 1), truth)
    assert np.abs(error).max() < 0.3
    assert (np.diff(curve.values_dn) > 0).all()


def test_levels_that_fall_have_no_tone_curve() -> None:
    rng = np.random.default_rng(8)
    light = (110 + gaussian_filter(rng.standard_normal(SHAPE), 3.0) * 300).astype(np.float32)
    assert fit_tone_curve(light, 255 - light, EVERYWHERE, 1.0) is None


def test_few_pixels_that_differ_everywhere_are_still_calibrated() -> None:
    # Of a drawing nothing differs but for pixels that lie within the reach of every other one.
    difference = np.zeros((200, 200), dtype=np.float32)
    difference[::6, ::6] = 1.0
    variance = np.full((200, 200), np.float32(1e-6))
    factor = calibrated_factor(difference, variance, variance, np.ones((200, 200), np.bool_), 1.0)
    assert np.all(np.isfinite(factor))
