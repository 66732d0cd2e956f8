"""Pictures that stand for photographs: seeded, within their levels, with spectra like nature's."""

import numpy as np
import pytest

from analysis.study import built_in_scenes
from simulation.psf import GaussianPsf

PSF = GaussianPsf(sigma_px=0.3)


@pytest.mark.slow
def test_the_pictures_are_the_same_every_time_and_differ_from_each_other() -> None:
    first, again = built_in_scenes(100.0, 1100.0, PSF), built_in_scenes(100.0, 1100.0, PSF)
    assert all(np.array_equal(one, other) for one, other in zip(first, again, strict=True))
    assert not np.array_equal(first[0], first[1])
    assert min(one.min() for one in first) > 0
    assert max(one.max() for one in first) < 1200


@pytest.mark.slow
def test_the_amplitude_falls_about_as_the_inverse_of_the_frequency() -> None:
    pictures = built_in_scenes(0.0, 1.0, PSF)
    side = len(pictures[0])
    window = np.hanning(side)[:, None] * np.hanning(side)
    power = np.mean([np.abs(np.fft.fft2(window * (p - p.mean()))) ** 2 for p in pictures], axis=0)
    freq = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.fftfreq(side))
    bands = [(0.02, 0.04), (0.04, 0.08), (0.08, 0.16), (0.16, 0.3)]
    middles = [np.sqrt(low * high) for low, high in bands]
    means = [power[(freq >= low) & (freq < high)].mean() for low, high in bands]
    slope = np.polyfit(np.log(middles), np.log(means), 1)[0]
    # Natural scenes have -1.6 to -2.4 (Tolhurst, Tadmor, Chao, 1992: amplitudes -0.8 to -1.5).
    assert -3.0 < slope < -1.6
