"""Periodic images that can be blurred exactly and read anywhere.

It is written for speed: ``benchmarks/speed/render.py`` compares with scipy's map_coordinates.
"""

from collections import OrderedDict
from math import ceil, floor, hypot

import numpy as np
import scipy.fft
from numba import njit
from numpy.typing import NDArray

WANTED_SIGMA = 2.0
"""Blur, in samples, from which a cubic spline is enough: for the bench's prints its error is
7e-5 of full scale at the worst point, and 2e-4 at any single frequency."""

MAX_OVERSAMPLING = 4
COEFFICIENTS_KEPT = 2


class PeriodicImage:
    """The trigonometric polynomial through one period of samples.

    Its Gaussian blur is a product in the Fourier domain, so no frequency is lost or aliased.
    The result is read through a cubic B-spline on an oversampled grid.

    Parameters
    ----------
    samples
        One period, shape ``(rows, cols)``; sample ``(0, 0)`` is at the origin.
    own_sigma
        Gaussian blur, in samples, that is part of the image: it is applied at once.
    """

    def __init__(self, samples: NDArray[np.float32], own_sigma: float = 0.0) -> None:
        self.shape = samples.shape
        self._own_sigma = own_sigma
        self._spectrum = scipy.fft.rfft2(samples.astype(np.float32))
        self._coefficients: OrderedDict[float, tuple[int, NDArray[np.float32]]] = OrderedDict()

    def blurred(
        self, cols: NDArray[np.float64], rows: NDArray[np.float64], sigma: float
    ) -> NDArray[np.float32]:
        """Values at fractional positions after a Gaussian blur; all lengths in samples."""
        oversampling, coefficients = self._spline(hypot(sigma, self._own_sigma))
        flat = _read_spline(coefficients, cols.ravel() * oversampling, rows.ravel() * oversampling)
        return np.asarray(flat.reshape(cols.shape))

    def _spline(self, sigma: float) -> tuple[int, NDArray[np.float32]]:
        if sigma in self._coefficients:
            self._coefficients.move_to_end(sigma)
            return self._coefficients[sigma]
        oversampling = MAX_OVERSAMPLING
        if sigma > 0:
            oversampling = min(MAX_OVERSAMPLING, max(1, ceil(WANTED_SIGMA / sigma)))
        rows, cols = self.shape
        freq_y = scipy.fft.fftfreq(rows)[:, None]
        freq_x = scipy.fft.rfftfreq(cols)[None, :]
        transfer = np.exp(-2 * np.pi**2 * sigma**2 * (freq_y**2 + freq_x**2))
        transfer /= _spline_transfer(freq_y / oversampling) * _spline_transfer(
            freq_x / oversampling
        )
        spectrum = self._spectrum * transfer.astype(np.float32)
        wide = _zero_padded(spectrum.astype(np.complex64), (rows, cols), oversampling)
        shape = (rows * oversampling, cols * oversampling)
        coefficients = scipy.fft.irfft2(wide, s=shape) * np.float32(oversampling**2)
        self._coefficients[sigma] = (oversampling, np.ascontiguousarray(coefficients))
        while len(self._coefficients) > COEFFICIENTS_KEPT:
            self._coefficients.popitem(last=False)
        return self._coefficients[sigma]


def _spline_transfer(freq: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transfer of the sampled cubic B-spline, at a frequency in cycles per sample."""
    return (2 + np.cos(2 * np.pi * freq)) / 3


def _zero_padded(
    spectrum: NDArray[np.complex64], shape: tuple[int, int], oversampling: int
) -> NDArray[np.complex64]:
    """Half spectrum of the same polynomial sampled ``oversampling`` times as densely."""
    if oversampling == 1:
        return spectrum
    rows, cols = shape
    wide = np.zeros((rows * oversampling, cols * oversampling // 2 + 1), dtype=np.complex64)
    positive, negative = (rows + 1) // 2, rows // 2
    wide[:positive, : spectrum.shape[1]] = spectrum[:positive]
    wide[-negative:, : spectrum.shape[1]] = spectrum[-negative:]
    if cols % 2 == 0:
        # The Nyquist column represented both signs; it now has its own partner.
        wide[:, cols // 2] *= 0.5
    if rows % 2 == 0:
        wide[negative] = wide[-negative] * 0.5
        wide[-negative] *= 0.5
    return wide


@njit(cache=True)
def _cubic_weights(t: np.float32) -> tuple[np.float32, np.float32, np.float32, np.float32]:
    """Weights of the four B-splines that reach a point ``t`` after the second one's middle."""
    one, s = np.float32(1), np.float32(1) - t
    sixth = one / np.float32(6)
    return (
        sixth * s * s * s,
        sixth * (np.float32(4) - np.float32(3) * t * t * (one + s)),
        sixth * (np.float32(4) - np.float32(3) * s * s * (one + t)),
        sixth * t * t * t,
    )


@njit(cache=True, error_model="numpy")
def _read_spline(
    coefficients: NDArray[np.float32], cols: NDArray[np.float64], rows: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Cubic B-spline with periodic coefficients, at fractional positions, shape (n,)."""
    height, width = coefficients.shape
    values = np.empty(cols.size, dtype=np.float32)
    for i in range(cols.size):
        left, top = floor(cols[i]), floor(rows[i])
        t, u = np.float32(cols[i] - left), np.float32(rows[i] - top)
        x0, x1, x2, x3 = _cubic_weights(t)
        c0 = (left - 1) % width
        c1 = c0 + 1 if c0 + 1 < width else 0
        c2 = c1 + 1 if c1 + 1 < width else 0
        c3 = c2 + 1 if c2 + 1 < width else 0
        row = (top - 1) % height
        total = np.float32(0)
        for weight in _cubic_weights(u):
            line = coefficients[row]
            total += weight * (x0 * line[c0] + x1 * line[c1] + x2 * line[c2] + x3 * line[c3])
            row = row + 1 if row + 1 < height else 0
        values[i] = total
    return values
