"""Photographs of edges through one tilted anisotropic lens, in closed form."""

from collections.abc import Iterable
from functools import cache
from math import sqrt

import numpy as np

from calibration.edges import EdgeImage
from calibration.noise import LevelNoise
from simulation.arrays import FloatArray
from tests.calibration.closed_form import edge_image

SIGMA_X_PX, SIGMA_Y_PX, RHO = 0.62, 0.48, 0.35
EIGHT_NORMALS_DEG = tuple(6.0 + 22.5 * k for k in range(8))
NOISE = LevelNoise(offset_dn2=4e4, slope_dn=4.0, floor_dn2=1.0)


def width_across(normal_deg: float) -> float:
    """Optical width along this normal: sqrt(n' Sigma n)."""
    nx, ny = np.cos(np.deg2rad(normal_deg)), np.sin(np.deg2rad(normal_deg))
    xy = RHO * SIGMA_X_PX * SIGMA_Y_PX
    return sqrt(SIGMA_X_PX**2 * nx**2 + 2 * xy * nx * ny + SIGMA_Y_PX**2 * ny**2)


@cache
def clean_photograph(normal_deg: float) -> FloatArray:
    """An edge behind square pixels, without noise; do not write to it."""
    return edge_image(width_across(normal_deg), normal_deg, has_pixel=True)


def photograph(normal_deg: float, rng: np.random.Generator) -> FloatArray:
    """The same with shot and read noise: an SNR of about 100."""
    clean = clean_photograph(normal_deg)
    return clean + rng.normal(size=clean.shape) * np.sqrt(NOISE.variance_dn2(clean))


def photographs(normals_deg: Iterable[float], seed: int = 4) -> list[EdgeImage]:
    rng = np.random.default_rng(seed)
    return [
        EdgeImage(name=f"edge-{normal:g}.tif", image_dn=photograph(normal, rng), noise=NOISE)
        for normal in normals_deg
    ]
