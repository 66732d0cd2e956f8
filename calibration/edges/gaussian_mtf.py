"""Contrast by frequency of a Gaussian edge, alone and behind the square pixel, in closed form."""

from math import cos, exp, log, pi, sin, sqrt

import numpy as np

from simulation.compiled import compiled, compiled_part

_STEPS = 60  # of bisection and secant together: 12 are usual
_EXACT = 1e-13


def gaussian_mtf50(sigma_px: float) -> float:
    """Frequency in cy/px at which a Gaussian of this width transfers half the contrast."""
    return sqrt(log(2) / 2) / (pi * sigma_px)


def pixel_mtf50(optical_sigma_px: float, normal_rad: float) -> float:
    """Frequency in cy/px along an edge normal at which half the contrast is left.

    The transfer is ``exp(-2 pi^2 sigma^2 f^2) sinc(f cos) sinc(f sin)``: the optical Gaussian
    and the pixel square (ISO 12233:2023, annex D, system MTF as a product).
    """
    return float(_half_contrast(optical_sigma_px, cos(normal_rad), sin(normal_rad)))


@compiled_part()
def pixel_transfer(freq_cy_per_px: float, sigma_px: float, cosine: float, sine: float) -> float:
    """Contrast that a Gaussian behind the unit square passes; without cosine and sine, alone."""
    contrast = exp(-2.0 * (pi * sigma_px * freq_cy_per_px) ** 2)
    return contrast * np.sinc(freq_cy_per_px * cosine) * np.sinc(freq_cy_per_px * sine)


@compiled()
def _half_contrast(sigma_px: float, cosine: float, sine: float) -> float:
    # The square alone has its first zero at 1 cy/px or beyond and falls below a half before.
    low, high = 0.0, 1.0
    at_low, at_high = 0.5, pixel_transfer(1.0, sigma_px, cosine, sine) - 0.5
    for _ in range(_STEPS):
        # The secant of Illinois: an end that stays counts half.
        middle = high - at_high * (high - low) / (at_high - at_low)
        here = pixel_transfer(middle, sigma_px, cosine, sine) - 0.5
        if abs(here) < _EXACT:
            return middle
        if here > 0:
            low, at_low = middle, here
            at_high *= 0.5
        else:
            high, at_high = middle, here
            at_low *= 0.5
    return 0.5 * (low + high)
