"""Whether there is anything in a picture to focus on, or noise alone."""

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from acquisition.focus.measures import Levels

_BLOCK_PX = 4
_FEWEST_BLOCKS = 4  # a third difference takes four
_SIGMAS = 5.0
_OVERLAP = 4.62  # 2 (1 + 2 (15^2 + 6^2 + 1) / 20^2): differences of neighbours share levels
_LEAST_DN = 0.3  # steps of 1 DN of a smooth light scatter by 1 / sqrt(12)


def has_detail(image_dn: Levels) -> bool:
    """Whether levels differ by more than noise that differs from pixel to pixel.

    Means over 4 x 4 pixels of independent noise scatter by a quarter of what the pixels do; what
    a lens draws is wider than a pixel and scatters more. Third differences, along rows
    and along columns, take out light that falls off. The focus value of what has no detail is that
    of its noise.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``, of one colour.

    Returns
    -------
    bool
        False also where the picture is too small to tell: less than 16 px either way.
    """
    levels_dn = np.asarray(image_dn, dtype=np.float64)
    return _is_drawn(levels_dn) or _is_drawn(levels_dn.T)


def _is_drawn(levels_dn: NDArray[np.float64]) -> bool:
    rows, cols = (length // _BLOCK_PX for length in levels_dn.shape)
    if rows < 1 or cols < _FEWEST_BLOCKS:
        return False
    pixels = levels_dn[: rows * _BLOCK_PX, : cols * _BLOCK_PX]
    blocks = pixels.reshape(rows, _BLOCK_PX, cols, _BLOCK_PX).mean(axis=(1, 3))
    per_block = _scatter_dn2(blocks)
    of_noise = _scatter_dn2(pixels) / _BLOCK_PX**2
    unsure = _SIGMAS * sqrt(_OVERLAP / (rows * (cols - 3))) * of_noise
    return per_block - of_noise > max(unsure, _LEAST_DN**2)


def _scatter_dn2(levels: NDArray[np.float64]) -> float:
    """Variance of independent levels, from their third differences along the rows."""
    bend = np.diff(levels, n=3, axis=1)
    return float(np.mean(bend * bend)) / 20.0
