"""Information capacity against closed forms."""

from math import exp, log, pi

import numpy as np
import pytest
from scipy.special import spence

from calibration.capacity import (
    NoisePower,
    SignalAndNoise,
    edge_information_bits_per_px,
    information_bits_per_px,
)
from simulation.arrays import FloatArray


def flat(fx: FloatArray, fy: FloatArray) -> FloatArray:
    return np.ones_like(fx + fy)


def test_a_perfect_lens_passes_what_shannon_says() -> None:
    # All of the band has the same S / N: here 3, which is 1 bit a pixel, log2(4) / 2.
    noise = NoisePower(variance_dn2=100.0)
    camera = SignalAndNoise(transfer=flat, noise=noise, signal_dn=1.0)
    assert information_bits_per_px(camera, 60.0) == pytest.approx(1.0)
    assert edge_information_bits_per_px(np.ones_like, 60.0, 10.0) == pytest.approx(pi / 4)


def test_a_gaussian_lens_passes_what_the_dilogarithm_says() -> None:
    sigma_px, range_dn, noise_dn = 0.7, 900.0, 6.0
    fall, most = 4 * pi**2 * sigma_px**2, range_dn**2 / (12 * noise_dn**2)

    def dilog(value: float) -> float:
        return float(spence(1 - value))

    closed = 0.5 * pi / (fall * log(2)) * (dilog(-most * exp(-fall / 4)) - dilog(-most))
    found = edge_information_bits_per_px(
        lambda freq: np.exp(-2 * pi**2 * sigma_px**2 * freq**2), range_dn, noise_dn
    )
    assert found == pytest.approx(closed, rel=1e-9)


def test_without_the_corners_of_the_band_both_ways_agree() -> None:
    # A lens that passes nothing beyond the disc of radius 1/2: the square has no more than that.
    sigma_px, range_dn, noise_dn = 1.5, 500.0, 20.0

    def soft(fx: FloatArray, fy: FloatArray) -> FloatArray:
        return np.asarray(np.exp(-2 * pi**2 * sigma_px**2 * (fx**2 + fy**2)))

    noise = NoisePower(variance_dn2=noise_dn**2)
    camera = SignalAndNoise(transfer=soft, noise=noise, signal_dn=1.0)
    by_edge = edge_information_bits_per_px(lambda freq: soft(freq, 0 * freq), range_dn, noise_dn)
    assert information_bits_per_px(camera, range_dn) == pytest.approx(by_edge, rel=1e-4)


@pytest.mark.parametrize(("range_dn", "noise_dn"), [(0.0, 1.0), (1.0, 0.0), (float("nan"), 1.0)])
def test_no_range_and_no_noise_are_refused(range_dn: float, noise_dn: float) -> None:
    with pytest.raises(ValueError, match="must be positive"):
        edge_information_bits_per_px(np.ones_like, range_dn, noise_dn)
