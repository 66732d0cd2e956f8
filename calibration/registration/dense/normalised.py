"""Local normalisation: levels less their local mean, over their local contrast."""

import cv2
import numpy as np

from simulation.arrays import BoolArray, Float32Array

_CONTRAST_FLOOR = 0.1
"""Of the whole image's, below which local contrast is not raised."""


def locally_normalised(levels: Float32Array, counted: BoolArray, window_px: int) -> Float32Array:
    """Normalise over a window; 0 where pixels do not count."""
    weight = counted.astype(np.float32)
    share = np.asarray(np.maximum(_mean(weight, window_px), 1e-3), dtype=np.float32)
    middle = _mean(levels * weight, window_px) / share
    deviation = np.asarray((levels - middle) * weight, dtype=np.float32)
    variance = _mean(deviation**2, window_px) / share
    floor = _CONTRAST_FLOOR**2 * float(variance[counted].mean()) if counted.any() else 0.0
    return np.asarray(deviation / np.sqrt(variance + (floor or 1.0)), dtype=np.float32)


def _mean(values: Float32Array, window_px: int) -> Float32Array:
    """Twice over a square: nearly a Gaussian."""
    size = (window_px, window_px)
    once = cv2.blur(values, size, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(cv2.blur(once, size, borderType=cv2.BORDER_CONSTANT), dtype=np.float32)
