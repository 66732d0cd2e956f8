"""The kernels of model ``matched``: from pixels to the spline through the far camera's image.

In the band that the pixels hold, the far image is the near one times ``H(z f) / H(f)``. Sampled as
a quintic spline, whose coefficients these kernels give.
"""

from functools import lru_cache

import numpy as np

from simulation.arrays import FloatArray
from simulation.psf import GaussianPsf, Psf
from simulation.resampling import (
    BandedMatrix,
    BlurCovariance,
    SamplingGrid,
    SeparableTerm,
    matched_terms,
    spline_sampling,
    spline_transfer,
)
from simulation.zoom_kernels.kernel_table import KernelTable
from simulation.zoom_kernels.short_band import (
    ImageCovariance,
    shortened,
    taps_needed,
)

_NEAR_ZERO = 3e-3
"""Where ``|H|`` is below, as at the zeros of a lens out of focus, noise would be amplified."""

_SIZE = 256
_RADIUS_MAX_PX = 60
_CUT = 1e-3
"""Largest weight that is cut off, as for a Gaussian."""

_CUT_LEAST_PX = 16


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
    freq: FloatArray = np.fft.fftfreq(_SIZE).astype(np.float64)
    fy, fx = freq[:, None], freq[None, :]
    near, far = psf.otf(fx, fy), psf.otf(zoom_x * fx, zoom_y * fy)
    transfer = far * near / (near**2 + _NEAR_ZERO**2) * (1 + _NEAR_ZERO**2)
    # A pixel grid cannot distinguish +1/2 and -1/2 cycles/px: the real part is their mean.
    kernel = np.fft.ifft2(transfer / (spline_transfer(fy) * spline_transfer(fx))).real
    by_distance = np.maximum(np.abs(kernel).max(axis=0), np.abs(kernel).max(axis=1))
    above = np.flatnonzero(by_distance[: _SIZE // 2] > _CUT * kernel[0, 0])
    radius = int(np.clip(above[-1] + 1, _CUT_LEAST_PX, _RADIUS_MAX_PX))
    kernel = np.roll(kernel, (radius, radius), (0, 1))[: 2 * radius + 1, : 2 * radius + 1]
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
    zoom_y, zoom_x = max(grid.zoom_y, 1.0), max(grid.zoom_x, 1.0)
    zero: FloatArray = np.zeros(1)
    covariance_y = ImageCovariance.seen_through(lambda freq: psf.otf(zero, freq))
    covariance_x = ImageCovariance.seen_through(lambda freq: psf.otf(freq, zero))
    return tuple(
        (
            _short_sampling(grid.rows_px, kernel.along_y, shape[0], covariance_y),
            _short_sampling(grid.cols_px, kernel.along_x, shape[1], covariance_x),
        )
        for kernel in spline_prefilter(psf, zoom_y, zoom_x)
    )


def _short_sampling(
    positions_px: FloatArray, kernel: FloatArray, size: int, covariance: ImageCovariance
) -> BandedMatrix:
    # The number of weights must not depend on the image or the grid: crops equal the whole.
    phases: FloatArray = np.arange(8) / 8 + len(kernel)
    inside = spline_sampling(phases, kernel, 2 * len(kernel) + 2)
    taps = taps_needed(inside, phases, covariance)
    matrix = spline_sampling(positions_px, kernel, size)
    return shortened(matrix, positions_px, min(taps, size), covariance)
