"""Gradient of an image: its ridges, and its noise in dark and in bright areas."""

from dataclasses import dataclass
from math import sqrt
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from simulation.arrays import Float32Array, FloatArray

SMOOTHING_PX = 1.0
_RAYLEIGH_MEDIAN = 1.1774100225154747  # median of |gradient| over its sigma, in pure noise
_NOISE_HIGH = 5.0
_NOISE_LOW = 2.5
_NOISE_RANGES, _NOISE_PIXELS, _NOISE_SPREAD = 4, 100, 5.0
_SAMPLED_PX = 100_000  # of which the noise is taken
_LEAST_OF_STRONGEST = 0.04
_CANNY_LARGEST = 26_000.0  # cv2.Canny takes 79109 times this in 32 bits: 27 145 would overflow


@dataclass(frozen=True, slots=True, eq=False)
class Gradient:
    """Gradient of the smoothed image, whose levels are scaled to 0 to 1.

    ``ridge`` is not 0 where the gradient is largest across itself; all of shape ``(rows, cols)``.
    Bright areas can be noisier than dark ones: ``noise`` is the gradient's noise in each range
    of levels of the image, and ``levels_dn`` what separates the ranges.
    """

    x: Float32Array
    y: Float32Array
    ridge: NDArray[np.uint8]
    levels_dn: FloatArray
    noise: FloatArray

    @classmethod
    def of(cls, image_dn: FloatArray) -> "Gradient":
        """Smooth the image, and find its ridges with Canny's suppression and hysteresis."""
        # Two work images are used over and over: new memory costs more than the filters do.
        first, second = np.empty((2, *image_dn.shape), np.float32)
        low_dn = float(image_dn.min())
        np.multiply(image_dn - low_dn, 1 / (float(image_dn.max()) - low_dn), out=first)
        # The median takes hot pixels away and leaves edges where they are; fits see the raw image.
        cv2.medianBlur(first, 3, dst=second)
        border = cv2.BORDER_REPLICATE
        cv2.GaussianBlur(second, (0, 0), SMOOTHING_PX, dst=first, borderType=border)
        gx, gy = np.empty((2, *image_dn.shape), np.float32)
        cv2.Scharr(first, cv2.CV_32F, 1, 0, dst=gx, scale=1 / 32, borderType=border)
        cv2.Scharr(first, cv2.CV_32F, 0, 1, dst=gy, scale=1 / 32, borderType=border)
        magnitude = cv2.magnitude(gx, gy, second)
        step = max(int(sqrt(magnitude.size / _SAMPLED_PX)), 1)
        sampled = magnitude[::step, ::step]
        noise = float(np.median(sampled)) / _RAYLEIGH_MEDIAN
        levels_dn, noise_by_level = _noise_by_level(image_dn[::step, ::step], sampled, noise)
        strongest = float(magnitude.max())
        high = max(_NOISE_HIGH * noise, _LEAST_OF_STRONGEST * strongest)
        low = max(_NOISE_LOW * noise, 0.4 * high)
        to_int16 = _CANNY_LARGEST / strongest
        ridge = cv2.Canny(
            np.multiply(gx, to_int16, out=first).astype(np.int16),
            np.multiply(gy, to_int16, out=second).astype(np.int16),
            low * to_int16,
            high * to_int16,
            L2gradient=True,
        )
        return cls(gx, gy, cast("NDArray[np.uint8]", ridge), levels_dn, noise_by_level)


def _noise_by_level(
    levels_dn: FloatArray, magnitude: Float32Array, overall: float
) -> tuple[FloatArray, FloatArray]:
    """Noise of the gradient in ranges of equally many levels, and what separates them."""
    separators = np.quantile(levels_dn, np.arange(1, _NOISE_RANGES) / _NOISE_RANGES)
    level_range = np.searchsorted(separators, levels_dn, side="right")
    noise = np.full(_NOISE_RANGES, overall)
    for k in range(_NOISE_RANGES):
        chosen = magnitude[level_range == k]
        if chosen.size >= _NOISE_PIXELS:
            noise[k] = float(np.median(chosen)) / _RAYLEIGH_MEDIAN
    # A range that holds edges and little else says nothing about the noise.
    return separators, np.clip(noise, overall, _NOISE_SPREAD * overall)
