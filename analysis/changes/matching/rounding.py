"""The variance that rounding to the levels of a file adds, where those still show."""

import numpy as np
from scipy.ndimage import median_filter

from simulation.arrays import Float32Array

_LEAST_LEVELS, _MOST_LEVELS = 32, 1024
"""Distinct levels of a photograph that was stored in 8 bits or so; a chart without noise has fewer,
one from colours or means of frames more."""

_NEIGHBOURS = 5
"""Steps between levels of which the median counts: one of two that no pixel has does not matter."""

_SAMPLE_PX = 250_000


def rounding_variance(image_dn: Float32Array) -> Float32Array | None:
    """Twelfth of the squared step between the levels around each pixel's; None if it is unknown.

    Decoded from a tone curve, the steps of a file's integers differ from level to level.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``.
    """
    stride = max(round((image_dn.size / _SAMPLE_PX) ** 0.5), 1)
    levels = np.unique(image_dn[::stride, ::stride])
    if not _LEAST_LEVELS <= len(levels) <= _MOST_LEVELS:
        return None
    steps = median_filter(np.diff(levels), _NEIGHBOURS, mode="nearest")
    middles = (levels[1:] + levels[:-1]) / 2
    # A table, since interpolation in levels of uneven steps is slow for every pixel.
    table = np.linspace(float(levels[0]), float(levels[-1]), 8 * _MOST_LEVELS)
    variance = (np.interp(table, middles, steps) ** 2 / 12).astype(np.float32)
    scale = np.float32((len(table) - 1) / (table[-1] - table[0]))
    index = np.clip((image_dn - np.float32(table[0])) * scale, 0, len(table) - 1)
    return np.asarray(variance[np.rint(index).astype(np.int32)])
