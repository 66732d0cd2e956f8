"""How well the noise of a pixel is known from what noise.json states."""

import pytest

from calibration.noise import NoiseCalibration


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
