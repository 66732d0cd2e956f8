"""Modulation transfer of a Gaussian PSF, with and without the pixel square."""

from math import cos, exp, log, pi, sin, sqrt

import numpy as np
from scipy.optimize import brentq

__all__ = ["gaussian_mtf50", "pixel_mtf50"]


def gaussian_mtf50(sigma_px: float) -> float:
    """Frequency in cy/px at which a Gaussian of this width transfers half the contrast."""
    return sqrt(log(2) / 2) / (pi * sigma_px)


def pixel_mtf50(optical_sigma_px: float, normal_rad: float) -> float:
    """Frequency in cy/px along an edge normal at which half the contrast is left.

    The transfer is ``exp(-2 pi^2 sigma^2 f^2) sinc(f cos) sinc(f sin)``: the optical Gaussian
    and the pixel square (ISO 12233:2023, annex D, system MTF as a product).
    """

    def above_half(frequency: float) -> float:
        gauss = exp(-2 * (pi * optical_sigma_px * frequency) ** 2)
        square = np.sinc(frequency * cos(normal_rad)) * np.sinc(frequency * sin(normal_rad))
        return float(gauss * square) - 0.5

    # The square alone has its first zero at 1 cy/px or beyond and falls below a half before.
    return float(brentq(above_half, 0.0, 1.0, xtol=1e-12))
