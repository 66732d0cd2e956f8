"""Photographs of a sum of plane waves through a Gaussian PSF, in closed form."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

MIDDLE_DN = 500.0


@dataclass(frozen=True)
class WaveScene:
    """Waves of up to ``freq_cy_per_px`` in reference pixels, of 5 to 15 DN."""

    seed: int
    freq_cy_per_px: float = 0.12
    count: int = 40

    def photographed(self, x_px: FloatArray, y_px: FloatArray, blur_px2: FloatArray) -> FloatArray:
        """Levels at places of the reference; ``blur_px2`` has the PSF's xx, xy, yy there, last."""
        rng = np.random.default_rng(self.seed)
        level = np.full(np.broadcast(x_px, y_px).shape, MIDDLE_DN)
        xx, xy, yy = np.moveaxis(blur_px2, -1, 0)
        for _ in range(self.count):
            fx, fy = rng.uniform(-self.freq_cy_per_px, self.freq_cy_per_px, 2)
            size, phase = rng.uniform(5, 15), rng.uniform(0, 2 * np.pi)
            passed = np.exp(-2 * np.pi**2 * (xx * fx * fx + 2 * xy * fx * fy + yy * fy * fy))
            level = level + size * passed * np.cos(2 * np.pi * (fx * x_px + fy * y_px) + phase)
        return np.asarray(level)
