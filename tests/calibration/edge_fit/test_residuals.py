import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.special import ndtr

from calibration.edges.residuals import noise_part, outlier_weights, profile_figures, profile_flags
from simulation.arrays import FloatArray
from tests.calibration.closed_form import point_edge

PIXELS = 3000
CONTRAST_DN = 1000.0
SIGMA_PX = 0.8
UNCLIPPED = np.zeros(PIXELS, np.bool_)
EVEN = np.ones(PIXELS)


def distances(seed: int = 1, reach_px: float = 8.0) -> FloatArray:
    return np.random.default_rng(seed).uniform(-reach_px, reach_px, PIXELS)


def gaussian_noise(scale_dn: float, seed: int = 2) -> FloatArray:
    return np.random.default_rng(seed).normal(0.0, scale_dn, PIXELS)


def flags_of(unit_edge: FloatArray, distance: FloatArray, noise_dn: float = 3.0) -> tuple[str, ...]:
    """Flags of this edge against the Gaussian one of SIGMA_PX."""
    values = CONTRAST_DN * unit_edge + gaussian_noise(noise_dn)
    residuals = values - CONTRAST_DN * point_edge(distance, SIGMA_PX)
    figures = profile_figures(values, residuals, distance, np.ones(PIXELS), SIGMA_PX)
    return profile_flags(figures, CONTRAST_DN)


def test_what_depends_on_the_distance_alone_is_no_noise() -> None:
    d = distances()
    structure = 40.0 * np.sin(d)  # 25 neighbours span 0.13 px: 2.6 DN at the steepest
    noise = gaussian_noise(10.0)
    assert np.std(noise_part(structure, d)) < 1.5
    # A median over 25 takes away pi / 2 / 25 of the variance, and correlates with its middle.
    assert np.std(noise_part(structure + noise, d)) == pytest.approx(10.0, rel=0.05)


@pytest.mark.slow
@given(order_seed=st.integers(0, 1000))
def test_the_order_of_the_pixels_does_not_matter(order_seed: int) -> None:
    d, noise = distances(), gaussian_noise(5.0)
    order = np.random.default_rng(order_seed).permutation(PIXELS)
    np.testing.assert_allclose(noise_part(noise[order], d[order]), noise_part(noise, d)[order])


def test_gaussian_noise_holds_no_outliers() -> None:
    # Beyond 6 sigma lie 2e-9 of all pixels.
    for seed in range(20):
        assert not outlier_weights(gaussian_noise(10.0, seed), UNCLIPPED, EVEN, CONTRAST_DN, 0.0)[0]


def test_an_outlier_weighs_nothing_and_its_neighbours_nearly_all() -> None:
    noise = gaussian_noise(3.0)
    noise[17] = 200.0
    found, weights = outlier_weights(noise, UNCLIPPED, EVEN, CONTRAST_DN, 0.0)
    assert found
    assert weights[17] == 0.0
    # Tukey's (1 - (r / 6 sigma)^2)^2 averages 1 - 2 / 36 + 3 / 36^2 over a Gaussian.
    assert np.mean(np.delete(weights, 17)) == pytest.approx(1 - 2 / 36 + 3 / 36**2, abs=0.005)


def test_a_deviation_below_one_percent_of_the_contrast_is_no_outlier() -> None:
    noise = gaussian_noise(0.01)
    noise[17] = 9.0
    assert not outlier_weights(noise, UNCLIPPED, EVEN, CONTRAST_DN, 0.0)[0]


def test_clipped_pixels_do_not_set_the_scale() -> None:
    # Two thirds that do not scatter: the median of all moduli is 0, and each other an outlier.
    is_clipped = np.arange(PIXELS) % 3 > 0
    noise = np.where(is_clipped, 0.0, gaussian_noise(10.0))
    assert not outlier_weights(noise, is_clipped, EVEN, CONTRAST_DN, 0.0)[0]


def test_the_noisier_side_of_an_edge_is_not_taken_for_outliers() -> None:
    spread = np.where(np.arange(PIXELS) < PIXELS // 5, 10.0, 1.0)
    noise = 5.0 * spread * gaussian_noise(1.0)
    assert not outlier_weights(noise, UNCLIPPED, spread, CONTRAST_DN, 0.0)[0]
    assert outlier_weights(noise, UNCLIPPED, EVEN, CONTRAST_DN, 0.0)[0]


def test_the_models_own_edge_has_no_flags() -> None:
    for seed in range(10):
        d = distances(seed)
        assert flags_of(point_edge(d, SIGMA_PX), d) == ()


def test_overshoot_on_both_sides_is_sharpening() -> None:
    d = distances()
    # By hand: Phi(d / a) + k (Phi(d / a) - Phi(d / b)), an unsharp mask of amount k.
    masked = point_edge(d, 0.6) + 0.8 * (point_edge(d, 0.6) - point_edge(d, 1.5))
    assert "sharpened" in flags_of(masked, d)


def test_overshoot_on_one_side_is_none() -> None:
    d = distances()
    bump = 0.08 * np.exp(-0.5 * ((d - 2.4) / 0.5) ** 2)
    assert "sharpened" not in flags_of(point_edge(d, SIGMA_PX) + bump, d)


def test_without_the_flat_part_of_a_side_nothing_is_said_about_sharpening() -> None:
    d = distances(reach_px=2.0)
    masked = point_edge(d, 0.6) + 0.8 * (point_edge(d, 0.6) - point_edge(d, 1.5))
    assert "sharpened" not in flags_of(masked, d)


def test_a_two_component_lens_is_not_gaussian() -> None:
    d = distances()
    halo = 0.85 * point_edge(d, 0.6) + 0.15 * point_edge(d, 2.5)
    assert "non_gaussian" in flags_of(halo, d)


def test_a_certain_but_tiny_deviation_is_gaussian_enough() -> None:
    d = distances()
    # 0.1 % of the contrast at a noise of 0.003 %.
    tiny = ndtr(d / SIGMA_PX) + 0.001 * np.sin(2 * d) * np.exp(-0.5 * d**2)
    assert flags_of(tiny, d, noise_dn=0.03) == ()


@pytest.mark.slow
def test_noise_is_not_mistaken_for_a_psf_that_is_not_gaussian() -> None:
    d = distances()
    # At the threshold of 1e-5, one of 100 trials would be surprising: 0.1 % probable.
    for seed in range(100):
        rng = np.random.default_rng(seed)
        values = CONTRAST_DN * point_edge(d, SIGMA_PX) + rng.normal(0.0, 50.0, PIXELS)
        residuals = values - CONTRAST_DN * point_edge(d, SIGMA_PX)
        figures = profile_figures(values, residuals, d, np.ones(len(d)), SIGMA_PX)
        assert "non_gaussian" not in profile_flags(figures, CONTRAST_DN)
