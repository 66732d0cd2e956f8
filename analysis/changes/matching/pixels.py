"""Masks and samples of pixels, and the noise that single pixels show."""

import cv2
import numpy as np

from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray

_SEED = 20
"""The same pixels every time: a comparison has the same result whenever it is made."""

_FINEST = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32) / 6
"""Passes the finest detail, along both axes at once, of which a lens leaves little; white noise
keeps its variance.

J. Immerkaer, "Fast noise variance estimation", Computer Vision and Image Understanding 64 (1996).
"""

_STEP = 2
"""Pixels from one to the next of those that the noise is told by."""


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


def pixel_noise_dn(image: Float32Array, counts: BoolArray | None = None) -> float:
    """Standard deviation of the noise that single pixels show, of those that count."""
    finest = finest_detail(image)[::_STEP, ::_STEP]
    if counts is None:
        return robust_sigma(finest)
    kept = counts[::_STEP, ::_STEP]
    return robust_sigma(finest[kept]) if kept.any() else 0.0


def finest_detail(image: Float32Array) -> Float32Array:
    """What both axes show at once of the finest detail; white noise keeps its variance."""
    return np.asarray(cv2.filter2D(image, -1, _FINEST), dtype=np.float32)


def light_at_first(source: FloatArray, target: FloatArray) -> tuple[float, float]:
    """Gain and offset that give levels the quartiles of others, for a robust fit to begin with."""
    (low, middle, high), (own_low, own_middle, own_high) = (
        np.percentile(levels, [25, 50, 75]).tolist() for levels in (source, target)
    )
    gain = (own_high - own_low) / (high - low) if high > low and own_high > own_low else 1.0
    return gain, own_middle - gain * middle
