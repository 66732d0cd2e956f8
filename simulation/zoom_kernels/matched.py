"""The kernels of model ``matched``: from pixels to the spline through the far camera's image.

In the band that the pixels hold, the far image is the near one times ``H(z f) / H(f)``. Sampled as
a quintic spline, whose coefficients these kernels give.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import ceil

import numpy as np
from scipy.interpolate import CubicSpline

from simulation.arrays import FloatArray
from simulation.kept_kernels import kept
from simulation.psf import GaussianPsf, Psf
from simulation.resampling import (
    BandedMatrix,
    BlurCovariance,
    SamplingGrid,
    SeparableTerm,
    matched_terms,
    mirrored_rows,
    spline_sampling,
    spline_transfer,
)
from simulation.zoom_kernels.kernel_table import KernelTable
from simulation.zoom_kernels.short_band import (
    ImageCovariance,
    largest_variance,
    shortest,
)

_NEAR_ZERO = 3e-3
"""Where ``|H|`` is below, as at the zeros of a lens out of focus, noise would be amplified."""

_POSITIONS_PX: FloatArray = np.arange(-2, 19) / 16
"""Positions from the pixel before, of rows that a cubic spline is laid through: right to 2e-5."""

_SIZE_MIN, _SIZE_ZOOMS = 128, 32
"""Period of the kernels in px, and least in far pixels."""


@lru_cache(maxsize=32)
def spline_prefilter(psf: Psf, zoom_y: float, zoom_x: float) -> tuple[SeparableTerm, ...]:
    """Kernels from pixels to coefficients, whose products sum to the prefilter.

    One product for a Gaussian without correlation, a few for a round lens.
    """
    if isinstance(psf, GaussianPsf):
        (xx, xy), (_, yy) = psf.covariance_px2.tolist()
        return matched_terms(
            BlurCovariance(
                yy_px2=yy * (zoom_y**2 - 1),
                xx_px2=xx * (zoom_x**2 - 1),
                xy_px2=xy * (zoom_y * zoom_x - 1),
            )
        )
    size = max(_SIZE_MIN, _SIZE_ZOOMS * ceil(max(zoom_y, zoom_x)))
    freq: FloatArray = np.fft.fftfreq(size).astype(np.float64)
    fy, fx = freq[:, None], freq[None, :]
    near, far = psf.otf(fx, fy), psf.otf(zoom_x * fx, zoom_y * fy)
    transfer = far * near / (near**2 + _NEAR_ZERO**2) * (1 + _NEAR_ZERO**2)
    # A pixel grid cannot distinguish +1/2 and -1/2 cycles/px: the real part is their mean.
    kernel = np.fft.ifft2(transfer / (spline_transfer(fy) * spline_transfer(fx))).real
    # All of the period, so that the sum of the tails beyond it lies at its ends.
    radius = size // 2
    kernel = np.roll(kernel, (radius, radius), (0, 1))
    kernel = np.pad(kernel, ((0, 1), (0, 1)), mode="wrap")
    kernel[[0, -1], :] *= 0.5
    kernel[:, [0, -1]] *= 0.5
    middle: FloatArray = np.zeros(1)
    table = KernelTable.of((kernel / kernel.sum())[None, None], middle, middle)
    return tuple(
        SeparableTerm(along_y[0], along_x[0])
        for along_y, along_x in zip(table.along_y.weights, table.along_x.weights, strict=True)
    )


def spline_terms(
    shape: tuple[int, int], grid: SamplingGrid, psf: Psf
) -> tuple[tuple[BandedMatrix, BandedMatrix], ...]:
    """Pairs ``(Wy, Wx)`` whose ``Wy image Wx^T`` sum to the follow-up of model ``matched``."""
    rows = _short_rows(psf, max(grid.zoom_y, 1.0), max(grid.zoom_x, 1.0))
    return tuple((y.at(grid.rows_px, shape[0]), x.at(grid.cols_px, shape[1])) for y, x in rows)


@dataclass(frozen=True, slots=True, eq=False)
class _ShortRows:
    """Weights that sample the spline along one axis, by the position between the pixels.

    ``weights`` has shape ``(len(_POSITIONS_PX), taps)``, with an even number of taps.
    """

    weights: FloatArray

    def at(self, positions_px: FloatArray, size: int) -> BandedMatrix:
        """Sample at positions in an image, which is mirrored at its edges."""
        taps = self.weights.shape[1]
        starts = np.floor(positions_px).astype(np.int64) + 1 - taps // 2
        between, which = np.unique(
            np.round(positions_px - np.floor(positions_px), 9), return_inverse=True
        )
        weights = CubicSpline(_POSITIONS_PX, self.weights)(between)
        return mirrored_rows(starts, weights[which], size)


@lru_cache(maxsize=64)
def _short_rows(
    psf: Psf, zoom_y: float, zoom_x: float
) -> tuple[tuple[_ShortRows, _ShortRows], ...]:
    """Terms along y and x, the same for all images and grids: crops equal the whole."""
    rows = [
        _ShortRows(weights)
        for weights in kept(
            "rows", (psf, zoom_y, zoom_x), lambda: tuple(_row_weights(psf, zoom_y, zoom_x))
        )
    ]
    return tuple(zip(rows[::2], rows[1::2], strict=True))


def _row_weights(psf: Psf, zoom_y: float, zoom_x: float) -> Iterator[FloatArray]:
    """Weights of the first term along y and along x, then those of the others."""
    zero: FloatArray = np.zeros(1)
    kernels = spline_prefilter(psf, zoom_y, zoom_x)
    count = len(kernels)
    widest = max(len(taps) for kernel in kernels for taps in (kernel.along_y, kernel.along_x))
    lags = 2 * _reach_px(widest)
    covariance_y = ImageCovariance.seen_through(lambda freq: psf.otf(zero, freq), lags)
    covariance_x = ImageCovariance.seen_through(lambda freq: psf.otf(freq, zero), lags)
    for kernel in kernels:
        y = _LongRows.of(kernel.along_y, covariance_y)
        x = _LongRows.of(kernel.along_x, covariance_x)
        yield y.shortened(count * x.variance)
        yield x.shortened(count * y.variance)


@dataclass(frozen=True, slots=True, eq=False)
class _LongRows:
    """Sampling of the spline along one axis, and what it leaves of an image's variance."""

    weights: FloatArray
    covariance: ImageCovariance
    variance: float

    @classmethod
    def of(cls, kernel: FloatArray, covariance: ImageCovariance) -> "_LongRows":
        reach = _reach_px(len(kernel))
        weights = spline_sampling(reach - 1 + _POSITIONS_PX, kernel, 2 * reach).dense()
        return cls(weights, covariance, largest_variance(weights, covariance))

    def shortened(self, share: float) -> FloatArray:
        """Fit rows as short as possible; ``share`` of the error counts."""
        return shortest(self.weights, self.covariance, share)


def _reach_px(taps: int) -> int:
    """Pixels on either side that a spline through the pixels blurred by ``taps`` reads."""
    return taps // 2 + 4
