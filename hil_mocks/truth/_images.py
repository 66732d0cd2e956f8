"""Images that can be blurred exactly and read anywhere: spectra, and cubic B-splines.

The periodic spline is written for speed: ``benchmarks/speed/render.py`` compares with scipy's.
"""

from collections import OrderedDict
from dataclasses import dataclass, field
from math import ceil, floor, hypot

import numpy as np
import scipy.fft
from numba import njit
from numpy.typing import NDArray

NEGLIGIBLE = 1e-12
"""Part of the largest factor of a transfer below which frequencies are left out. Numbers so small
that they are denormal take a hundred times as long to multiply."""


class FoldedSpectrum:
    """A finely sampled image, ready to be blurred and read at the pixel centres.

    ``samples`` has ``per_px`` samples a pixel along both axes; sample 0 is at a pixel's centre.
    """

    def __init__(self, samples: NDArray[np.float32], per_px: int) -> None:
        self._shape = (samples.shape[0] // per_px, samples.shape[1] // per_px)
        self._half = scipy.fft.rfft2(samples) / np.float32(per_px**2)
        self._freq_y = scipy.fft.fftfreq(samples.shape[0], 1 / per_px)
        self._freq_x = scipy.fft.rfftfreq(samples.shape[1], 1 / per_px)

    def image(
        self, covariance_px2: NDArray[np.float64], orders: tuple[int, int]
    ) -> NDArray[np.float32]:
        """Pixels after a Gaussian blur and derivatives of these orders along x and y.

        The orders add up to an even number. The pixel's square is included.
        """
        (xx, xy), (_, yy) = (-2 * np.pi**2 * covariance_px2).tolist()
        # (2 pi i)^n is real, as n is even.
        factor = (-4 * np.pi**2) ** (sum(orders) // 2)
        # A frequency along one axis counts if any along the other leaves something of it.
        share = 1 - xy**2 / (xx * yy) if xy else 1.0
        along_x, columns = _factors(self._freq_x, xx, share, orders[0])
        along_y, _ = _factors(self._freq_y, yy, share, orders[1])
        folded = _folded(
            self._half,
            (factor * along_x).astype(np.float32),
            along_y.astype(np.float32),
            np.exp(2 * xy * self._freq_x[1] * self._freq_y) if xy else np.empty(0),
            self._shape,
            columns,
        )
        return np.asarray(scipy.fft.irfft2(folded, s=self._shape))


def _factors(
    frequency: NDArray[np.float64], exponent: float, share: float, order: int
) -> tuple[NDArray[np.float64], int]:
    """Transfer of the pixel, a blur and a derivative along one axis, and the end of what counts.

    What is negligible is 0. ``share`` is what the best frequency along the other axis leaves of the
    exponent.
    """
    own = np.sinc(frequency) * frequency**order
    most = np.abs(own) * np.exp(share * exponent * frequency**2)
    counts = most > NEGLIGIBLE * most.max()
    factors = np.where(counts, own * np.exp(exponent * frequency**2), 0.0)
    return factors, int(np.flatnonzero(counts)[-1]) + 1


@njit(cache=True, error_model="numpy")
def _folded(
    half: NDArray[np.complex64],
    along_x: NDArray[np.float32],
    along_y: NDArray[np.float32],
    skew: NDArray[np.float64],
    shape: tuple[int, int],
    columns: int,
) -> NDArray[np.complex64]:
    """Half spectrum of the image that keeps every n-th sample, after a product with a transfer.

    ``half``, shape ``(n rows, n cols // 2 + 1)``, is that of the samples; ``along_x`` and
    ``along_y`` are factors of the transfer, real and together even, ``skew[y] ** x`` is a third one
    (empty where it is 1). Only the first ``columns`` count, and rows whose ``along_y`` is not 0.
    Each column of the result, shape ``(rows, cols // 2 + 1)``, sums the frequencies that the image
    of ``shape`` cannot tell from its own; those below zero are the conjugates of their opposites.
    """
    rows, cols = shape
    kept = cols // 2 + 1
    per_px = half.shape[0] // rows
    lowest = min((per_px * cols - 1) // 2, columns - 1)
    folded = np.zeros((rows, kept), dtype=np.complex64)
    for row in range(rows):
        sums = folded[row]
        opposite = rows - row if row else 0
        for part in range(per_px):
            y = part * rows + row
            for first in range(0, columns if along_y[y] else 0, cols):
                power = skew[y] ** first if skew.size else 1.0
                for column in range(min(kept, columns - first)):
                    factor = along_y[y] * along_x[first + column]
                    if skew.size:
                        factor *= np.float32(power)
                        power *= skew[y]
                    sums[column] += half[y, first + column] * factor
            y = part * rows + opposite
            for first in range(cols, lowest + kept if along_y[y] else 0, cols):
                start = max(0, first - lowest)
                power = skew[y] ** (first - start) if skew.size else 1.0
                for column in range(start, kept):
                    factor = along_y[y] * along_x[first - column]
                    if skew.size:
                        factor *= np.float32(power)
                        power /= skew[y]
                    sums[column] += np.conj(half[y, first - column]) * factor
    return folded


WANTED_SIGMA = 2.0
"""Blur, in samples, from which a cubic spline is enough: for the bench's prints its error is
7e-5 of full scale at the worst point, and 2e-4 at any single frequency."""

MAX_OVERSAMPLING = 4
COEFFICIENTS_KEPT = 2


class PeriodicImage:
    """The trigonometric polynomial through one period of samples, the first at the origin.

    Its Gaussian blur is a product in the Fourier domain, so no frequency is lost or aliased. The
    result is read through a cubic B-spline on an oversampled grid. ``own_sigma``, in samples, is a
    blur that is part of the image.
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


FloatArray = NDArray[np.float64]

SAMPLES_PER_PX = 4
"""Coefficients along one pixel of the reference."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SplineScene:
    """A scene whose middle is the middle of the reference; 1 is white, mirrored at its borders.

    ``coefficients`` has `SAMPLES_PER_PX` to a pixel of the reference, whose frame is ``shape``.
    """

    name: str
    shape: tuple[int, int]
    coefficients: FloatArray = field(repr=False)

    def at(self, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        """Light at positions in reference pixels; both of one shape."""
        rows, cols = self.coefficients.shape
        x = (x_px - (self.shape[1] - 1) / 2) * SAMPLES_PER_PX + (cols - 1) / 2
        y = (y_px - (self.shape[0] - 1) / 2) * SAMPLES_PER_PX + (rows - 1) / 2
        return spline_at(self.coefficients, x, y)


def spline_at(
    coefficients: FloatArray | NDArray[np.float32], x: FloatArray, y: FloatArray
) -> FloatArray:
    """Cubic B-spline at positions in units of its coefficients; mirrored at its borders."""
    flat = _spline_at(coefficients, np.ravel(x), np.ravel(y))
    return np.asarray(flat.reshape(np.shape(x)))


@njit(cache=True)
def _spline_at(
    coefficients: FloatArray | NDArray[np.float32], x: FloatArray, y: FloatArray
) -> FloatArray:
    rows, cols = coefficients.shape
    levels = np.empty(len(x))
    across, down = np.empty(4), np.empty(4)
    col, row = np.empty(4, dtype=np.int64), np.empty(4, dtype=np.int64)
    for i in range(len(x)):
        _taps(x[i], cols, across, col)
        _taps(y[i], rows, down, row)
        level = 0.0
        for j in range(4):
            line = 0.0
            for k in range(4):
                line += across[k] * coefficients[row[j], col[k]]
            level += down[j] * line
        levels[i] = level
    return levels


@njit(cache=True)
def _taps(position: float, count: int, weight: FloatArray, index: NDArray[np.int64]) -> None:
    first = int(np.floor(position))
    t = position - first
    weight[0] = (1 - t) ** 3 / 6
    weight[1] = (4 - 6 * t * t + 3 * t**3) / 6
    weight[2] = (1 + 3 * t + 3 * t * t - 3 * t**3) / 6
    weight[3] = t**3 / 6
    if first >= 1 and first + 2 < count:
        for j in range(4):
            index[j] = first - 1 + j
        return
    for j in range(4):
        position_index = (first - 1 + j) % (2 * count)
        mirrored = 2 * count - 1 - position_index
        index[j] = position_index if position_index < count else mirrored
