"""The spectrum of a finely sampled image, from which blurred images at the pixels are made."""

import numpy as np
import scipy.fft
from numba import njit
from numpy.typing import NDArray

NEGLIGIBLE = 1e-12
"""Part of the largest factor of a transfer below which frequencies are left out. Numbers so small
that they are denormal take a hundred times as long to multiply."""


class FoldedSpectrum:
    """A finely sampled image, ready to be blurred and read at the pixel centres.

    Parameters
    ----------
    samples
        ``per_px`` samples a pixel along both axes; sample 0 is at a pixel's centre.
    per_px
        A whole number of them.
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

    Parameters
    ----------
    half
        Half spectrum of the samples, shape ``(n rows, n cols // 2 + 1)``.
    along_x, along_y
        Factors of the transfer, real and together even.
    skew
        A third one, ``skew[y] ** x``; empty where it is 1.
    shape
        ``(rows, cols)`` of the image.
    columns
        Number of columns of ``half`` that count. Rows whose ``along_y`` is 0 do not count either.

    Returns
    -------
    ndarray, shape (rows, cols // 2 + 1)
        Each column is a sum over the frequencies that the image cannot tell from its own. Those
        below zero are the conjugates of their opposites.
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
