"""Whether there is anything in a picture to focus on, or noise alone."""

from math import sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.focus.measures import Levels

_BLOCK_PX = 4
_FEWEST_BLOCKS = 4  # a third difference takes four
_SIGMAS = 5.0
_OVERLAP = 4.62  # 2 (1 + 2 (15^2 + 6^2 + 1) / 20^2): differences of neighbours share levels
_LEAST_PX = 32  # either way; less than half of it may be of one colour
_PIXELS = 2**17
_COARSE, _COARSE_PX = 4, 195
"""An edge far out of focus is seen in means over 4 px, or of at most 195 to a picture's side."""

_SHADING = 2e-3  # of the level: a highlight on paper leaves half of that in such means
_SPARSEST = 8  # a row of blocks every 32 px
_LEAST_DN = 0.3  # steps of 1 DN of a smooth light scatter by 1 / sqrt(12)


def shows_nothing(image_dn: Levels) -> bool:
    """Whether there is nothing in a picture to focus on: a lens cap, plain paper.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``, of one colour or a mosaic.

    Returns
    -------
    bool
        False where the picture is too small to tell: less than 32 px either way.
    """
    if min(image_dn.shape) < _LEAST_PX:
        return False
    # Every second pixel of a mosaic has one colour.
    if has_detail(image_dn) or has_detail(image_dn[::2, ::2]):
        return False
    rows, cols = image_dn.shape
    factor = max(_COARSE, max(rows, cols) // _COARSE_PX)
    size = cols // factor, rows // factor
    coarse_dn = cv2.resize(image_dn.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return not has_detail(coarse_dn, least_dn=max(_LEAST_DN, _SHADING * float(coarse_dn.mean())))


def has_detail(image_dn: Levels, *, least_dn: float = _LEAST_DN) -> bool:
    """Whether levels differ by more than noise that differs from pixel to pixel.

    Means over 4 x 4 pixels of independent noise scatter by a quarter of what the pixels do; what
    a lens draws is wider than a pixel and scatters more. Third differences, along rows
    and along columns, take out light that falls off. The focus value of what has no detail is that
    of its noise.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``, of one colour.
    least_dn
        What light that is not even may leave of itself.

    Returns
    -------
    bool
        False also where the picture is too small to tell: less than 16 px either way.
    """
    return _is_drawn(image_dn, least_dn) or _is_drawn(image_dn.T, least_dn)


def _is_drawn(levels_dn: Levels, least_dn: float) -> bool:
    rows, cols = (length // _BLOCK_PX for length in levels_dn.shape)
    if rows < 1 or cols < _FEWEST_BLOCKS:
        return False
    cut = levels_dn[: rows * _BLOCK_PX, : cols * _BLOCK_PX]
    # Of a large picture some rows of blocks are enough.
    step = min(max(cut.size // _PIXELS, 1), _SPARSEST)
    strips = cut.reshape(rows, _BLOCK_PX, cols * _BLOCK_PX)[::step].astype(np.float64)
    rows = len(strips)
    pixels = strips.reshape(rows * _BLOCK_PX, cols * _BLOCK_PX)
    blocks = pixels.reshape(rows, _BLOCK_PX, cols, _BLOCK_PX).mean(axis=(1, 3))
    per_block = _scatter_dn2(blocks)
    of_noise = _scatter_dn2(pixels) / _BLOCK_PX**2
    unsure = _SIGMAS * sqrt(_OVERLAP / (rows * (cols - 3))) * of_noise
    return per_block - of_noise > max(unsure, least_dn**2)


def _scatter_dn2(levels: NDArray[np.float64]) -> float:
    """Variance of independent levels, from their third differences along the rows."""
    bend = np.diff(levels, n=3, axis=1)
    return float(np.mean(bend * bend)) / 20.0
