"""Siemens stars whose photographs are known in closed form.

The light of a sinusoidal star keeps its angular period behind any round Gaussian; what is left of
its amplitude at a radius is an integral over modified Bessel functions (of the Gaussian in polar
coordinates). Behind an elliptic one the star is a plane wave about each point. Shares nothing with
``calibration``.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import pi

import numpy as np
from scipy.special import ive

from simulation.arrays import FloatArray

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
_RADIAL_NODES = 4001
_REACH_SIGMAS = 8.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Star:
    """A sinusoidal Siemens star: its place, cycles around, radius, and levels in DN.

    With ``is_square``, spokes have two levels only.
    """

    x_px: float
    y_px: float
    cycles: int
    radius_px: float
    mean_dn: float = 1500.0
    modulation: float = 0.8
    is_square: bool = False

    def photograph(
        self, shape: tuple[int, int], sigma_px: float, stretch: float = 1.0
    ) -> FloatArray:
        """Photograph behind a Gaussian and square pixels, ``stretch`` times as wide along x."""
        rows, cols = shape
        y, x = np.mgrid[:rows, :cols].astype(np.float64)
        image = np.zeros(shape)
        for dx, wx in zip(_NODES / 2, _WEIGHTS / 2, strict=True):
            for dy, wy in zip(_NODES / 2, _WEIGHTS / 2, strict=True):
                image += wx * wy * self._light(x + dx, y + dy, sigma_px, stretch)
        return image

    def _light(
        self, x_px: FloatArray, y_px: FloatArray, sigma_px: float, stretch: float
    ) -> FloatArray:
        right, down = x_px - self.x_px, y_px - self.y_px
        radius, turn = np.hypot(right, down), np.arctan2(down, right)
        light = np.zeros_like(radius)
        for order, share in self._harmonics():
            cycles = order * self.cycles
            if stretch == 1.0:
                left = self._round(radius, sigma_px, cycles)
            else:
                freq = cycles / (2 * pi * np.maximum(radius, 1e-9))
                across = (stretch * np.sin(turn)) ** 2 + np.cos(turn) ** 2
                left = np.exp(-2 * (pi * sigma_px * freq) ** 2 * across)
                left = left * (radius <= self.radius_px)
            light += share * left * np.cos(cycles * turn)
        return np.asarray(self.mean_dn * (1 + self.modulation * light))

    def _harmonics(self) -> tuple[tuple[int, float], ...]:
        if not self.is_square:
            return ((1, 1.0),)
        return tuple((n, 4 / pi * (-1) ** ((n - 1) // 2) / n) for n in (1, 3, 5, 7))

    def _round(self, radius_px: FloatArray, sigma_px: float, cycles: int) -> FloatArray:
        """What is left of the amplitude at radii: exact, also at the rim."""
        table, left = _radial(self.radius_px, sigma_px, cycles)
        return np.asarray(np.interp(radius_px, table, left, right=0.0))


@lru_cache(maxsize=16)
def _radial(radius_px: float, sigma_px: float, cycles: int) -> tuple[FloatArray, FloatArray]:
    """Radii, and what is left of the amplitude there."""
    table = np.linspace(0.0, radius_px + _REACH_SIGMAS * sigma_px, _RADIAL_NODES)
    away = np.linspace(-_REACH_SIGMAS, _REACH_SIGMAS, 641) * sigma_px
    source = table[:, None] + away
    weight = source / sigma_px**2 * np.exp(-0.5 * (away / sigma_px) ** 2)
    weight = weight * ive(cycles, np.abs(source) * table[:, None] / sigma_px**2)
    weight[(source < 0) | (source > radius_px)] = 0.0
    return table, weight.sum(axis=1) * (away[1] - away[0])
