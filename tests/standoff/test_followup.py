import numpy as np
import pytest

from simulation import GaussianPsf, zoom_out
from simulation.capture_noise import CaptureNoise
from standoff.followup import CaptureOptions, captured, own_variance

NOISE = CaptureNoise(gain_e_per_dn=4.0, read_noise_e=8.0, black_level_dn=64.0)
PSF = GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.8)


@pytest.mark.parametrize(("exposure", "vignetting"), [(1.0, 0.0), (1.6, 0.0), (1.0, 0.6)])
def test_the_noise_is_that_of_the_light_that_arrives(exposure: float, vignetting: float) -> None:
    rng = np.random.default_rng(2)
    level = np.full((300, 300), 1064.0)
    reference = level + np.sqrt(NOISE.variance_dn2(level)) * rng.standard_normal(level.shape)
    clean = captured(
        zoom_out(level, 2.0, PSF), CaptureOptions(exposure=exposure, vignetting=vignetting), None
    )
    options = CaptureOptions(exposure=exposure, vignetting=vignetting, noise=NOISE, seed=3)
    noisy = captured(
        zoom_out(reference, 2.0, PSF), options, own_variance(reference, 2.0, PSF, "matched", NOISE)
    )
    inner = np.s_[10:-10, 10:-10]
    # The clean image was lit without a black level; light it as the noisy one.
    expected_level = (clean / 1064.0) * 1000.0 + 64.0
    normalised = (noisy - expected_level) / np.sqrt(NOISE.variance_dn2(expected_level))
    assert np.mean(normalised[inner]) == pytest.approx(0.0, abs=0.05)
    assert np.var(normalised[inner]) == pytest.approx(1.0, rel=0.06)  # 16 900 pixels


def test_without_options_nothing_changes() -> None:
    image = np.random.default_rng(0).uniform(0, 9, (20, 30))
    np.testing.assert_array_equal(captured(image, CaptureOptions(), None), image)
