"""Transfer function of a circular pupil: closed form where it is perfect, quadrature otherwise.

The aberrated one is the perfect one times the mean, over the common part of two shifted pupils,
of the phase difference's phasor. That mean is smooth, tabulated once a lens, and read by cubic
interpolation.
"""

from math import pi, sqrt

import numpy as np
import scipy.fft
from numba import njit
from numpy.typing import NDArray

ZERNIKE_TERMS = ("defocus", "astig1", "astig2", "coma1", "coma2", "spher")
"""Noll's Z4 to Z8 and Z11: Z5 and Z7 are the sine terms."""

_RADII = 161
_BEARINGS = 64
"""Measured over half a turn: a real pupil's other half is the conjugate."""

_FINER = 8
_NODES = 40

PupilTable = NDArray[np.complex128]
"""Mean phasor, shape (radii, bearings): equal steps of sqrt(1 - relative frequency), and of a
whole turn."""


def diffraction_mtf(relative_freq: NDArray[np.float64]) -> NDArray[np.float64]:
    """MTF of a perfect circular pupil at frequencies over the cut-off.

    References
    ----------
    J. W. Goodman, Introduction to Fourier Optics, 4th ed. 2017, section 7.2.2.
    """
    v = np.minimum(relative_freq, 1.0)
    return np.asarray(2 / pi * (np.arccos(v) - v * np.sqrt(1 - v * v)))


def pupil_table(zernike_waves: tuple[float, ...]) -> PupilTable:
    """Tabulate the mean phasor of a pupil with these coefficients of `ZERNIKE_TERMS`.

    References
    ----------
    R. J. Noll, "Zernike polynomials and atmospheric turbulence", J. Opt. Soc. Am. 66 (1976),
    207-211, table I.
    """
    nodes, weights = (of.astype(np.float64) for of in np.polynomial.legendre.leggauss(_NODES))
    # Common parts of pupils narrow to points at the cut-off, where nothing is left to average.
    frequency = 1 - np.linspace(0.0, 1.0, _RADII) ** 2
    bearing = np.arange(_BEARINGS, dtype=np.float64) * (pi / _BEARINGS)
    half = _mean_phasors(np.array(zernike_waves), frequency, bearing, nodes, weights)
    series = scipy.fft.fft(np.hstack([half, half.conj()]), axis=1)
    wide = np.zeros((_RADII, 2 * _BEARINGS * _FINER), dtype=np.complex128)
    wide[:, :_BEARINGS] = series[:, :_BEARINGS]
    wide[:, -_BEARINGS:] = series[:, -_BEARINGS:]
    return np.ascontiguousarray(scipy.fft.ifft(wide, axis=1) * _FINER)


def read_pupil_table(
    table: PupilTable, relative_freq: NDArray[np.float64], bearing_rad: NDArray[np.float64]
) -> PupilTable:
    """Mean phasor at frequencies over the cut-off and bearings; beyond it, that at the cut-off."""
    flat = _read(table, relative_freq.ravel(), bearing_rad.ravel())
    return np.asarray(flat.reshape(relative_freq.shape))


@njit(cache=True)
def _path_waves(waves: NDArray[np.float64], x: float, y: float) -> float:
    r2 = x * x + y * y
    coma = sqrt(8.0) * (3 * r2 - 2)
    path: float = (
        waves[0] * sqrt(3.0) * (2 * r2 - 1)
        + waves[1] * sqrt(6.0) * 2 * x * y
        + waves[2] * sqrt(6.0) * (x * x - y * y)
        + waves[3] * coma * y
        + waves[4] * coma * x
        + waves[5] * sqrt(5.0) * (6 * r2 * r2 - 6 * r2 + 1)
    )
    return path


@njit(cache=True)
def _mean_phasors(
    waves: NDArray[np.float64],
    frequency: NDArray[np.float64],
    bearing: NDArray[np.float64],
    nodes: NDArray[np.float64],
    weights: NDArray[np.float64],
) -> NDArray[np.complex128]:
    """Means over the common part of two unit pupils ``2 frequency`` apart, shape (f, bearing)."""
    made = np.empty((len(frequency), len(bearing)), dtype=np.complex128)
    for i in range(len(frequency)):
        s = min(frequency[i], 1 - 1e-9)
        for j in range(len(bearing)):
            c, d = np.cos(bearing[j]), np.sin(bearing[j])
            real, imaginary, area = 0.0, 0.0, 0.0
            for k in range(len(nodes)):
                v = sqrt(1 - s * s) * np.sin(pi / 2 * nodes[k])
                wide = sqrt(1 - v * v) - s
                row_weight = weights[k] * np.cos(pi / 2 * nodes[k]) * wide
                for m in range(len(nodes)):
                    u = wide * nodes[m]
                    ahead, behind = u + s, u - s
                    phase = (
                        2
                        * pi
                        * (
                            _path_waves(waves, ahead * c - v * d, ahead * d + v * c)
                            - _path_waves(waves, behind * c - v * d, behind * d + v * c)
                        )
                    )
                    weight = row_weight * weights[m]
                    real += weight * np.cos(phase)
                    imaginary += weight * np.sin(phase)
                    area += weight
            made[i, j] = complex(real / area, imaginary / area)
    return made


@njit(cache=True)
def _cubic(t: float, weight: NDArray[np.float64]) -> None:
    """Lagrange's weights of the points -1, 0, 1, 2 at ``t``."""
    weight[0] = -t * (t - 1) * (t - 2) / 6
    weight[1] = (t + 1) * (t - 1) * (t - 2) / 2
    weight[2] = -(t + 1) * t * (t - 2) / 2
    weight[3] = (t + 1) * t * (t - 1) / 6


@njit(cache=True)
def _read(
    table: PupilTable, relative_freq: NDArray[np.float64], bearing_rad: NDArray[np.float64]
) -> PupilTable:
    radii, bearings = table.shape
    made = np.empty(len(relative_freq), dtype=np.complex128)
    down, across = np.empty(4), np.empty(4)
    for i in range(len(relative_freq)):
        row = sqrt(max(1 - relative_freq[i], 0.0)) * (radii - 1)
        top = min(max(int(row), 1), radii - 3)
        _cubic(row - top, down)
        col = bearing_rad[i] / (2 * pi) * bearings
        left = int(np.floor(col))
        _cubic(col - left, across)
        total = 0j
        for j in range(4):
            for k in range(4):
                total += down[j] * across[k] * table[top - 1 + j, (left - 1 + k) % bearings]
        made[i] = total
    return made
