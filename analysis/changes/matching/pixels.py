"""Masks and samples of pixels."""

import cv2
import numpy as np

from simulation.arrays import BoolArray, IntArray

_SEED = 20
"""The same pixels every time: a comparison has the same result whenever it is made."""


def away_from(mask: BoolArray, distance_px: float) -> BoolArray:
    """Pixels further than this from all of a mask."""
    if not mask.any():
        return np.ones(mask.shape, dtype=np.bool_)
    apart = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    return np.asarray(apart > distance_px)


def sampled(mask: BoolArray, count: int) -> tuple[IntArray, IntArray]:
    """Rows and columns of a mask's pixels: of all, or of about so many at random."""
    total = int(np.count_nonzero(mask))
    if total <= count:
        rows, cols = np.nonzero(mask)
        return rows, cols
    rng = np.random.default_rng(_SEED)
    drawn = rng.integers(0, mask.size, round(count * mask.size / total))
    drawn = drawn[mask.ravel()[drawn]]
    rows, cols = np.divmod(drawn, mask.shape[1])
    return rows, cols
