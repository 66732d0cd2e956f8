"""A Gaussian lens before a sensor whose noise is known: photographs of a dark square."""

from functools import cache

import numpy as np
from scipy.special import ndtr

from calibration.edges import EdgeImage
from calibration.noise import NoiseCalibration
from calibration.psf import PsfCalibration, psf_of_images
from simulation.arrays import FloatArray

SIGMA_PX = 0.8
GAIN_E_PER_DN, READ_NOISE_E, BLACK_DN, SATURATION_DN = 4.0, 8.0, 50.0, 4000.0
DARK_DN, BRIGHT_DN = 600.0, 3000.0

NOISE = NoiseCalibration(
    gain_e_per_dn=GAIN_E_PER_DN,
    gain_e_per_dn_err=0.004,
    read_noise_e=READ_NOISE_E,
    read_noise_e_err=0.01,
    black_level_dn=BLACK_DN,
    saturation_dn=SATURATION_DN,
    frames_averaged=1,
)


def variance_dn2(level_dn: FloatArray | float) -> FloatArray:
    light = np.asarray(level_dn) - BLACK_DN
    return light / GAIN_E_PER_DN + (READ_NOISE_E / GAIN_E_PER_DN) ** 2


def square(turn_deg: float, seed: int, *, noise: float = 1.0, amount: float = 0.0) -> EdgeImage:
    """A photograph of a square turned by an angle; ``amount`` is that of an unsharp mask."""
    y, x = np.mgrid[:170, :170].astype(np.float64)
    y, x = y - 84.7, x - 84.2
    turn = np.deg2rad(turn_deg)
    across = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x

    def blurred(sigma_px: float) -> FloatArray:
        sides = [ndtr((55 - one) / sigma_px) - ndtr((-55 - one) / sigma_px) for one in across]
        return np.asarray(sides[0] * sides[1])

    shape = (1 + amount) * blurred(SIGMA_PX) - amount * blurred(1.8)
    levels = BRIGHT_DN + (DARK_DN - BRIGHT_DN) * shape
    rng = np.random.default_rng(seed)
    scatter = noise * np.sqrt(variance_dn2(levels)) * rng.standard_normal(levels.shape)
    return EdgeImage(name=f"square-{seed}.tif", image_dn=levels + scatter)


@cache
def calibrated(noise: float = 1.0, amount: float = 0.0) -> PsfCalibration:
    images = [
        square(turn, seed, noise=noise, amount=amount) for seed, turn in enumerate((6.0, 50.0))
    ]
    return psf_of_images(images, method="all-angles")
