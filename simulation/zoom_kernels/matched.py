"""The kernels of model ``matched``: from pixels to the spline through the far camera's image.

In the band that the pixels hold, the far image is the near one times ``H(z f) / H(f)``. Sampled as
a quintic spline, whose coefficients these kernels give.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil

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
    largest_variance,
    shortened,
    taps_needed,
)

_NEAR_ZERO = 3e-3
"""Where ``|H|`` is below, as at the zeros of a lens out of focus, noise would be amplified."""

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
    zoom_y, zoom_x = max(grid.zoom_y, 1.0), max(grid.zoom_x, 1.0)
    zero: FloatArray = np.zeros(1)
    covariance_y = ImageCovariance.seen_through(lambda freq: psf.otf(zero, freq))
    covariance_x = ImageCovariance.seen_through(lambda freq: psf.otf(freq, zero))
    terms = []
    kernels = spline_prefilter(psf, zoom_y, zoom_x)
    for kernel in kernels:
        y = _AxisSampling.of(kernel.along_y, covariance_y)
        x = _AxisSampling.of(kernel.along_x, covariance_x)
        terms.append(
            (
                y.at(grid.rows_px, shape[0], len(kernels) * x.variance),
                x.at(grid.cols_px, shape[1], len(kernels) * y.variance),
            )
        )
    return tuple(terms)


@dataclass(frozen=True, slots=True, eq=False)
class _AxisSampling:
    """Sampling of the spline along one axis, and what it leaves of an image's variance."""

    kernel: FloatArray
    covariance: ImageCovariance
    inside: BandedMatrix
    phases_px: FloatArray
    variance: float

    @classmethod
    def of(cls, kernel: FloatArray, covariance: ImageCovariance) -> "_AxisSampling":
        phases_px: FloatArray = np.arange(8) / 8 + len(kernel)
        inside = spline_sampling(phases_px, kernel, 2 * len(kernel) + 2)
        return cls(kernel, covariance, inside, phases_px, largest_variance(inside, covariance))

    def at(self, positions_px: FloatArray, size: int, share: float) -> BandedMatrix:
        """Sample at positions in an image; ``share`` of its error counts."""
        # The number of weights does not depend on the image or the grid: crops equal the whole.
        taps = taps_needed(self.inside, self.phases_px, self.covariance, share)
        matrix = spline_sampling(positions_px, self.kernel, size)
        return shortened(matrix, positions_px, min(taps, size), self.covariance)
