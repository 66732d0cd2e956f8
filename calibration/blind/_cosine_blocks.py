"""Photographs as the cosines of their blocks of eight pixels, and what JPEG leaves of these.

A file of JPEG gives back every cosine as a multiple of its step, and all that it tells of a cosine
is the interval that was rounded: the likelihood of a prediction is the probability of that
interval. Of the near photograph the mean of each interval is taken, as Laplace's distribution of
its cosines has it, whose scale is that of the highest likelihood for the numbers in the file.

References
----------
ITU-T T.81 (1992), A.3. J. R. Price, M. Rabbani, "Biased reconstruction for JPEG decoding", IEEE
Signal Process. Lett. 6 (1999) 297-299: the means of the intervals. A. Agresti, Analysis of Ordinal
Categorical Data, 2nd ed. (2010), section 5.1: the likelihood of an interval.
"""

from dataclasses import dataclass
from functools import cache
from math import pi, sqrt
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from calibration.edges import JpegCompression
from simulation.arrays import BoolArray, FloatArray

BLOCK = 8
_Pixel = TypeVar("_Pixel", np.float64, np.bool_)
EVEN_CODE = 128.0
_CODES = np.arange(256.0)
_FAR_OFF = 30.0  # standard deviations
_MOST_WIDE = 500.0


@cache
def _transform() -> FloatArray:
    """The orthonormal cosine transform of eight values, by rising frequency."""
    k, n = np.mgrid[:BLOCK, :BLOCK]
    matrix = sqrt(2 / BLOCK) * np.cos(pi * (2 * n + 1) * k / (2 * BLOCK))
    matrix[0] /= sqrt(2)
    return np.asarray(matrix)


def blocks_of(image: NDArray[_Pixel]) -> NDArray[_Pixel]:
    """Blocks of an image of whole blocks, shape ``(down, across, 8, 8)``."""
    rows, cols = image.shape
    return image.reshape(rows // BLOCK, BLOCK, cols // BLOCK, BLOCK).swapaxes(1, 2)


class UsedBlocks:
    """The blocks of an image of which enough pixels are used; the others of them count as 0."""

    def __init__(self, used: BoolArray, least_share: float) -> None:
        blocks = blocks_of(used)
        self._kept = np.mean(blocks, axis=(2, 3)) >= least_share
        masks = blocks[self._kept].reshape(-1, BLOCK * BLOCK)
        self._mask = None if masks.all() else masks.astype(np.float64)
        self._matrix: FloatArray = np.asarray(np.kron(_transform(), _transform()).T)

    @property
    def count(self) -> int:
        """Number of blocks."""
        return int(np.count_nonzero(self._kept))

    def cosines(self, image: FloatArray) -> FloatArray:
        """Their cosines, block by block, rows by vertical frequency, shape ``(64 count,)``."""
        blocks: FloatArray = blocks_of(image)[self._kept].reshape(-1, BLOCK * BLOCK)
        if self._mask is not None:
            blocks = blocks * self._mask
        made: FloatArray = np.matmul(blocks, self._matrix)
        return made.ravel()


def codes_of(level_dn: FloatArray, compression: JpegCompression) -> FloatArray:
    """Codes of levels, between whole ones as well."""
    return np.asarray(np.interp(level_dn, compression.code_levels_dn, _CODES))


def code_slopes(level_dn: FloatArray, compression: JpegCompression) -> FloatArray:
    """Derivative of `codes_of`."""
    levels = compression.code_levels_dn
    return np.interp(level_dn, levels, 1 / np.gradient(levels))


def before_rounding(image_dn: FloatArray, compression: JpegCompression) -> FloatArray:
    """The photograph whose cosines are the means of the intervals that were rounded.

    Incomplete blocks at the border stay as they are.
    """
    codes = codes_of(image_dn, compression)
    top, left = -compression.first_row % BLOCK, -compression.first_col % BLOCK
    rows, cols = ((n - at) // BLOCK * BLOCK for n, at in zip(codes.shape, (top, left), strict=True))
    window = np.s_[top : top + rows, left : left + cols]
    transform, steps = _transform(), compression.steps
    number = np.rint(transform @ (blocks_of(codes[window]) - EVEN_CODE) @ transform.T / steps)
    mean = np.abs(number).mean(axis=(0, 1))
    # The mean magnitude of a rounded Laplacian is t / (1 - t^2), t = exp(-step / (2 scale)).
    root = np.divide(
        np.sqrt(1 + 4 * mean**2) - 1, 2 * mean, out=np.full_like(mean, 1e-12), where=mean > 0
    )
    ratio = -2 * np.log(np.clip(root, 1e-12, 1 - 1e-9))
    inward = steps * (1 / ratio - 1 / np.expm1(np.minimum(ratio, _MOST_WIDE)) - 0.5)
    inward[0, 0] = 0.0  # the mean of a block is no Laplacian
    cosines = number * steps + np.sign(number) * inward
    codes[window] = (
        (transform.T @ cosines @ transform + EVEN_CODE).swapaxes(1, 2).reshape(rows, cols)
    )
    return np.interp(codes, _CODES, compression.code_levels_dn)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WithinInterval:
    """Mean and variance of normal variables within intervals, and the intervals' probability."""

    mean: FloatArray
    variance: FloatArray
    log_probability: FloatArray


def within_interval(
    mean: FloatArray, spread: FloatArray, middle: FloatArray, half_width: FloatArray
) -> WithinInterval:
    """What is known of normal variables that lie within ``half_width`` of ``middle``."""
    # On the side of the smaller tail the digits are kept.
    is_above = middle > mean
    away = np.where(is_above, mean - middle, middle - mean)
    low, high = (away - half_width) / spread, (away + half_width) / spread
    low, high = np.maximum(low, -_FAR_OFF), np.clip(high, 0.1 - _FAR_OFF, _FAR_OFF)
    share = np.maximum(ndtr(high) - ndtr(low), 1e-300)
    at_low, at_high = (np.exp(-0.5 * end * end) / sqrt(2 * pi) for end in (low, high))
    shift = (at_low - at_high) / share
    variance = 1 + (low * at_low - high * at_high) / share - shift**2
    shift = np.where(is_above, -shift, shift)
    return WithinInterval(
        mean=mean + spread * shift,
        variance=spread**2 * np.clip(variance, 1e-6, 1.0),
        log_probability=np.log(share),
    )
