"""What a camera's pixels receive: the light's Fourier series times the system's transfer function.

A frame is rendered as one period of a periodic picture, wider than the frame on all sides. Charts
and spots have their series in closed form, so nothing is sampled; scenes are sampled ``per_px``
times a pixel, at which cubic B-splines of fine coefficients hardly alias. All is float64: the last
bits, which differ between processors, are far below what rounding to levels shows.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from hil_mocks.benchmark_set.lenses import Lens, system_otf

MARGIN_PX = 24
"""Beyond the frame on each side: what lies there blurs into the frame as it would in a scene."""

_ROWS_AT_ONCE = 192

FloatArray = NDArray[np.float64]
Series = NDArray[np.complex128]
"""Fourier coefficients, shape (rows, cols) of `Grid.freq_y` and `Grid.freq_x`."""

Light = Callable[[FloatArray, FloatArray], FloatArray]
"""Light at positions (x, y) in pixels of the frame; 1 is white."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """Frequencies that a frame of ``(rows, cols)`` is rendered from, for lenses up to ``band``."""

    rows: int
    cols: int
    band_cy_per_px: float
    per_px: int = 8

    @property
    def period_px(self) -> tuple[int, int]:
        """Rows and columns of the periodic picture."""
        return tuple(scipy.fft.next_fast_len(n + 2 * MARGIN_PX, real=True) for n in self.shape)  # type: ignore[return-value]

    @property
    def shape(self) -> tuple[int, int]:
        """``(rows, cols)`` of the frame."""
        return self.rows, self.cols

    @property
    def freq_y(self) -> FloatArray:
        """Cycles per pixel, positive and negative, shape (rows, 1)."""
        rows = self.period_px[0]
        return np.asarray(scipy.fft.fftfreq(rows * self.per_px, 1 / self.per_px)[:, None])

    @property
    def freq_x(self) -> FloatArray:
        """Cycles per pixel from 0 to the band's end, shape (1, cols)."""
        cols = self.period_px[1]
        count = min(int(self.band_cy_per_px * cols) + 1, cols * self.per_px // 2 + 1)
        return np.asarray(np.arange(count)[None, :] / cols)


def pixels(series: Series, lens: Lens, grid: Grid) -> FloatArray:
    """Light on each pixel of a frame, shape ``grid.shape``."""
    rows, cols = grid.period_px
    seen = series * _transfer(lens, grid)
    folded = seen.reshape(grid.per_px, rows, -1).sum(axis=0)
    lines = scipy.fft.ifft(folded, axis=0, norm="forward")
    image = scipy.fft.irfft(lines, n=cols * grid.per_px, axis=1, norm="forward")
    top, left = MARGIN_PX, MARGIN_PX * grid.per_px
    within = image[top : top + grid.rows, left : left + grid.cols * grid.per_px : grid.per_px]
    return np.ascontiguousarray(within)


@lru_cache(maxsize=3)
def _transfer(lens: Lens, grid: Grid) -> NDArray[np.float64] | NDArray[np.complex128]:
    return system_otf(lens, grid.freq_x, grid.freq_y)


def sampled(light: Light, grid: Grid) -> Series:
    """Series of light that is given at positions."""
    rows, cols = (n * grid.per_px for n in grid.period_px)
    x = np.arange(cols) / grid.per_px - MARGIN_PX
    y = np.arange(rows) / grid.per_px - MARGIN_PX
    series = np.empty((rows, grid.freq_x.size), dtype=np.complex128)
    for top in range(0, rows, _ROWS_AT_ONCE):
        part = slice(top, min(top + _ROWS_AT_ONCE, rows))
        levels = light(*np.meshgrid(x, y[part]))
        lines = scipy.fft.rfft(levels, axis=1, norm="forward")
        series[part] = lines[:, : series.shape[1]]
    return np.asarray(scipy.fft.fft(series, axis=0, norm="forward", overwrite_x=True))


def spot_series(
    grid: Grid, x_px: float, y_px: float, sigma_px: float, amplitude: float
) -> Series:
    """Series of a Gaussian spot."""
    rows, cols = grid.period_px
    fx, fy = grid.freq_x, grid.freq_y
    volume = amplitude * 2 * np.pi * sigma_px**2 / (rows * cols)
    along_x = np.exp(-2 * (np.pi * sigma_px * fx) ** 2 - 2j * np.pi * fx * (x_px + MARGIN_PX))
    along_y = np.exp(-2 * (np.pi * sigma_px * fy) ** 2 - 2j * np.pi * fy * (y_px + MARGIN_PX))
    return np.asarray(volume * along_x * along_y)
