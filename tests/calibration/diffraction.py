"""Edges of a diffraction-limited lens behind square pixels, from their Fourier integral."""

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from simulation.arrays import FloatArray

_NODES = 400
_REACH_PX = 75.0
_STEP_PX = 0.04


def lens_mtf(freq: FloatArray, cutoff: float) -> FloatArray:
    """Incoherent MTF of a round, perfect lens (Goodman, Introduction to Fourier Optics, 6.3)."""
    v = np.clip(freq / cutoff, 0, 1)
    return np.asarray(2 / np.pi * (np.arccos(v) - v * np.sqrt(1 - v * v)))


def system_mtf(freq: FloatArray, cutoff: float, normal_rad: float) -> FloatArray:
    square = np.sinc(freq * np.cos(normal_rad)) * np.sinc(freq * np.sin(normal_rad))
    return np.asarray(lens_mtf(freq, cutoff) * square)


def system_mtf50(cutoff: float, normal_rad: float) -> float:
    return float(
        brentq(lambda f: float(system_mtf(np.array(f), cutoff, normal_rad)) - 0.5, 1e-3, 0.9)
    )


def diffracted_edge(
    cutoff: float, normal_deg: float, shape: tuple[int, int] = (90, 110)
) -> FloatArray:
    """E(d) = 1/2 + integral of MTF(f) sin(2 pi f d) / (pi f) df, by Gauss-Legendre."""
    normal = np.deg2rad(normal_deg)
    x, weight = np.polynomial.legendre.leggauss(_NODES)
    u = (x + 1) / 2
    freq = cutoff * u * u * (3 - 2 * u)  # dense at both ends
    weight = cutoff * 6 * u * (1 - u) / 2 * weight
    amplitude = system_mtf(freq, cutoff, float(normal)) * weight / (np.pi * freq)
    grid = np.arange(-_REACH_PX, _REACH_PX, _STEP_PX)
    profile = 0.5 + np.sin(2 * np.pi * np.outer(grid, freq)) @ amplitude
    rows, cols = shape
    row, col = np.mgrid[:rows, :cols].astype(np.float64)
    distance = (
        np.cos(normal) * (col - (cols - 1) / 2) + np.sin(normal) * (row - (rows - 1) / 2) - 0.37
    )
    return np.asarray(8_000.0 + 44_000.0 * CubicSpline(grid, profile)(distance))
