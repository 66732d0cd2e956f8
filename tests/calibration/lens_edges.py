"""Straight edges through a known lens behind square pixels, from Fourier integrals in closed form.

Shares nothing with the code under test: the pupil's transfer is integrated across its lens-shaped
common part, the edge's profile by a sine series of a long period.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import cos, pi, sin

import numpy as np
from scipy.interpolate import CubicSpline

from calibration.edges import EdgeImage
from simulation.arrays import FloatArray

LOW_DN, HIGH_DN = 8_000.0, 48_000.0
_PERIOD_PX = 800.0
_SINES = 12_000  # odd ones: up to 30 cy/px, where a sharp lens leaves 1e-4 of an edge
_GRID_PX = 1 / 48
_REACH_PX = 40.0


def pupil_transfer(
    relative_freq: FloatArray, waves: float | FloatArray, across_waves: float | FloatArray = 0.0
) -> FloatArray:
    """Hopkins (1955): the overlap of two pupils, integrated along the line between them.

    ``waves`` is the defocus along that line; of an astigmatic pupil there is a part across it, over
    which the integral is known.
    """
    nu = np.minimum(np.abs(np.asarray(relative_freq, dtype=np.float64)), 1.0)
    node, weight = np.polynomial.legendre.leggauss(80)
    u = (node + 1) / 2
    out = np.zeros_like(nu)
    for uk, wk in zip(u.tolist(), weight.tolist(), strict=True):
        # x = (1 - nu) (1 - s^2) removes the root at the rim of the pupil.
        x = (1 - nu) * (1 - uk * uk)
        height = np.sqrt(np.maximum(1 - (x + nu) ** 2, 0.0))
        height = height * np.sinc(8 * across_waves * nu * height)
        out += wk / 2 * 2 * uk * (1 - nu) * np.cos(8 * pi * waves * nu * x) * height
    return np.asarray(4 / pi * out)


@dataclass(frozen=True)
class Lens:
    """A pupil with cut-off periods along its two axes, turned; waves of defocus; a Gaussian."""

    along_px: float
    across_px: float
    turn_deg: float = 0.0
    waves: float = 0.0
    sigma_px: float = 0.0

    def otf(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """Lens and pixel together."""
        turn = np.deg2rad(self.turn_deg)
        p = self.along_px * (fx * np.cos(turn) + fy * np.sin(turn))
        q = self.across_px * (fy * np.cos(turn) - fx * np.sin(turn))
        gauss = np.exp(-2 * (pi * self.sigma_px) ** 2 * (fx * fx + fy * fy))
        pupil = pupil_transfer(np.hypot(p, q), self.waves)
        return np.asarray(pupil * gauss * np.sinc(fx) * np.sinc(fy))


@dataclass(frozen=True)
class AstigmaticLens(Lens):
    """A round pupil whose path difference is ``x_waves u^2 + y_waves v^2``, turned.

    Between points p of two pupils ``2 nu`` apart along n it is ``4 nu n . D p``: along n a defocus
    of ``n . D n``, across it one of ``m . D n``.
    """

    x_waves: float = 0.0
    y_waves: float = 0.0

    def otf(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """Lens and pixel together."""
        fx, fy = np.broadcast_arrays(fx, fy)
        turn = np.deg2rad(self.turn_deg)
        u, v = fx * np.cos(turn) + fy * np.sin(turn), fy * np.cos(turn) - fx * np.sin(turn)
        freq = np.hypot(u, v)
        cosine, sine = u / np.maximum(freq, 1e-12), v / np.maximum(freq, 1e-12)
        along = self.x_waves * cosine**2 + self.y_waves * sine**2
        across = (self.y_waves - self.x_waves) * cosine * sine
        gauss = np.exp(-2 * (pi * self.sigma_px) ** 2 * freq**2)
        pupil = pupil_transfer(freq * self.along_px, along, across)
        return np.asarray(pupil * gauss * np.sinc(fx) * np.sinc(fy))


@cache
def profile(lens: Lens, normal_deg: float) -> CubicSpline:
    """Level by distance of an edge from 0 to 1: one flank of a square wave of a long period."""
    normal = np.deg2rad(normal_deg)
    freq = (2 * np.arange(_SINES) + 1) / _PERIOD_PX
    amplitude = lens.otf(freq * cos(normal), freq * sin(normal)) * 2 / (pi * freq * _PERIOD_PX)
    points = round(_PERIOD_PX / _GRID_PX)
    spectrum = np.zeros(points // 2 + 1, dtype=np.complex128)
    kept = 2 * np.arange(min(_SINES, points // 4)) + 1
    spectrum[kept] = -0.5j * points * amplitude[: kept.size]
    wave = np.fft.irfft(spectrum, points)
    count = round(_REACH_PX / _GRID_PX)
    distance = np.arange(-count, count + 1) * _GRID_PX
    return CubicSpline(distance, 0.5 + np.concatenate([wave[-count:], wave[: count + 1]]))


def edge_photograph(
    lens: Lens, normal_deg: float, length_px: float = 200.0, half_width_px: float = 30.0
) -> FloatArray:
    """An edge of this length in a tilted strip; outside it the levels go on as they are."""
    normal = np.deg2rad(normal_deg)
    c, s = cos(normal), sin(normal)
    cols = int(abs(c) * 2 * half_width_px + abs(s) * length_px) + 1
    rows = int(abs(s) * 2 * half_width_px + abs(c) * length_px) + 1
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    distance = c * (x - (cols - 1) / 2) + s * (y - (rows - 1) / 2) - 0.37
    level = profile(lens, normal_deg)(np.clip(distance, -_REACH_PX, _REACH_PX))
    return np.asarray(LOW_DN + (HIGH_DN - LOW_DN) * level)


def edge_photographs(
    lens: Lens, normals_deg: Sequence[float], snr: float, seed: int, length_px: float = 200.0
) -> list[EdgeImage]:
    """Photographs of one edge each, with noise of the contrast over ``snr``."""
    rng = np.random.default_rng(seed)
    sources = []
    for normal in normals_deg:
        clean = edge_photograph(lens, normal, length_px)
        noise = rng.normal(size=clean.shape) * (HIGH_DN - LOW_DN) / snr
        sources.append(EdgeImage(name=f"{normal:g}", image_dn=clean + noise))
    return sources
