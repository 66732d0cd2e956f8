"""Photographs of slanted opaque rectangles by Fourier optics; shares no code with ``simulation``.

The scene is a periodic array of ``FINE`` samples a pixel. Its photographs are the product of its
transform and the transfer function, sampled where the pixels are: exact to rounding.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

FINE = 8
SIDE_PX = 192
_ALIASES = 3
_REACH_PX = 33  # beyond the corner of the largest rectangle


@dataclass(frozen=True)
class Optics:
    """A lens over square pixels: pupil cut-off matrix (xx, xy, yy) in px and defocus in waves.

    Without a pupil, a total Gaussian of ``sigma_px`` and no pixel.
    """

    cut_off_px: tuple[float, float, float] | None = None
    defocus_waves: float = 0.0
    sigma_px: float = 0.0

    def otf(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        if self.cut_off_px is None:
            return np.asarray(np.exp(-2 * (np.pi * self.sigma_px) ** 2 * (fx**2 + fy**2)))
        xx, xy, yy = self.cut_off_px
        nu = np.hypot(xx * fx + xy * fy, xy * fx + yy * fy)
        curve = _pupil_curve(self.defocus_waves)
        lens = np.interp(nu, np.linspace(0, 1, len(curve)), curve, right=0.0)
        return np.asarray(lens * np.sinc(fx) * np.sinc(fy))


@lru_cache
def _pupil_curve(defocus_waves: float) -> FloatArray:
    """Overlap of two discs with the phase of the defocus between them, by the midpoint rule."""
    steps = 512
    y = (np.arange(steps) + 0.5) / steps
    values = []
    for nu in np.linspace(0, 1, 257):
        half_width = np.sqrt(1 - y**2) - nu
        inside = np.maximum(half_width, 0.0)
        # cos integrated along x over the lens of the overlap, in closed form.
        slope = 8 * np.pi * defocus_waves * nu
        along_x = 2 * inside * np.sinc(slope * inside / np.pi)
        values.append(2 * along_x.mean() / np.pi)
    return np.asarray(np.array(values) / values[0], dtype=np.float64)


@lru_cache
def scene_spectrum(seed: int) -> NDArray[np.complex128]:
    """Transform of a scene of opaque rectangles of 20 to 235 DN."""
    rng = np.random.default_rng(seed)
    size = SIDE_PX * FINE
    scene = np.full((size, size), 128.0)
    around = np.arange(-_REACH_PX * FINE, _REACH_PX * FINE)
    for _ in range(60):
        centre, angle = rng.uniform(0, SIDE_PX, 2), rng.uniform(0, np.pi)
        half = rng.uniform(2, 22, 2)
        nearest = np.round(centre * FINE).astype(int)
        dy, dx = ((nearest + around[:, None]) / FINE - centre).T
        u = np.abs(np.cos(angle) * dx + np.sin(angle) * dy[:, None])
        v = np.abs(np.cos(angle) * dy[:, None] - np.sin(angle) * dx)
        covered = np.clip((half[0] - u) * FINE + 0.5, 0, 1)
        covered *= np.clip((half[1] - v) * FINE + 0.5, 0, 1)
        patch = np.ix_((nearest[0] + around) % size, (nearest[1] + around) % size)
        scene[patch] += covered * (rng.uniform(20, 235) - scene[patch])
    return np.asarray(np.fft.fft2(scene))


def photographed(seed: int, optics: Optics, zoom: float) -> FloatArray:
    """Image from ``zoom`` times further away; pixel (0, 0) is at the scene's origin.

    Its pixels are ``zoom`` reference pixels apart; ``zoom * FINE`` must be whole.
    """
    freq = np.fft.fftfreq(SIDE_PX * FINE, 1 / FINE).astype(np.float64)
    otf = optics.otf(zoom * freq[None, :], zoom * freq[:, None])
    step = round(zoom * FINE)
    return np.asarray(np.fft.ifft2(scene_spectrum(seed) * otf).real[::step, ::step])


def ideal_estimate(near: FloatArray, optics: Optics, zoom: float) -> FloatArray:
    """Best linear estimate of the further photograph with the true OTF and unlimited support.

    Y. C. Eldar and M. Unser, "Nonideal sampling and interpolation", 2006: the spectrum is
    ``H(z f) H(f) S(f) / sum_m |H(f + m)|^2 S(f + m)`` times the periodic one of the pixels.
    """
    count = (2 * _ALIASES + 1) * SIDE_PX
    freq = (np.arange(count) - count // 2).astype(np.float64) / SIDE_PX
    fy, fx = freq[:, None], freq[None, :]
    power = (1 / 900 + (2 * np.pi) ** 2 * (fy**2 + fx**2)) ** -1.5
    otf = optics.otf(fx, fy)
    order = 2 * _ALIASES + 1
    seen = (otf**2 * power).reshape(order, SIDE_PX, order, SIDE_PX).sum(axis=(0, 2))
    index = np.arange(count) - count // 2
    wrapped = index % SIDE_PX
    folded_at = np.arange(count) % SIDE_PX
    pixels = np.fft.fft2(near)[np.ix_(wrapped, wrapped)]
    estimate = optics.otf(zoom * fx, zoom * fy) * otf * power
    estimate = estimate / np.maximum(seen, 1e-12 * seen.max())[np.ix_(folded_at, folded_at)]
    fine = np.zeros((SIDE_PX * FINE, SIDE_PX * FINE), complex)
    fine[np.ix_(index % len(fine), index % len(fine))] = estimate * pixels
    step = round(zoom * FINE)
    return np.asarray(np.fft.ifft2(fine).real[::step, ::step]) * FINE**2
