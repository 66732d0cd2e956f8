"""What the pixels of one straight edge tell about its width: Fisher information, before any frame.

The edge is the one that ``calibration.edges`` fits: two levels, a Gaussian rise, an offset, a
turn and a curvature, in a band of pixels on either side. The pixels of a slanted edge lie at all
distances from it, so that sums over pixels are integrals over the band; what varies along the edge
is a power of the place, whose means are known. For white noise and a wide band the error has a
closed form.
"""

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
from scipy.special import ndtr

from calibration.edges import band_half_width
from calibration.noise import LevelNoise
from simulation.arrays import FloatArray

_STEPS = 801
_OFFSET, _CURVATURE, _LOG_SIGMA, _LOW, _HIGH = range(5)
_SQUARE, _FOURTH = 1 / 3, 1 / 5
"""Means of the second and fourth power of the place along the edge, from -1 to 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeLevels:
    """Mean levels on both sides of an edge, and the noise of one frame.

    Parameters
    ----------
    low_dn, high_dn
        Dark and bright level.
    frame_noise
        Variance of a pixel of a single frame by its level.
    """

    low_dn: float
    high_dn: float
    frame_noise: LevelNoise

    def __post_init__(self) -> None:
        if not self.low_dn < self.high_dn:
            raise ValueError(f"levels must rise, got {self.low_dn:g} and {self.high_dn:g} DN")

    @property
    def contrast_dn(self) -> float:
        """Step between the levels."""
        return self.high_dn - self.low_dn

    def noise_dn(self, frames: int) -> float:
        """Standard deviation of a pixel of the mean of ``frames``, half-way up the edge."""
        middle = np.array([0.5 * (self.low_dn + self.high_dn)])
        return sqrt(float(self.frame_noise.variance_dn2(middle)[0]) / frames)


def sigma_err_px(sigma_px: float, length_px: float, levels: EdgeLevels, frames: int) -> float:
    """Return the least standard error of the total width of one edge (Cramer and Rao).

    Parameters
    ----------
    sigma_px
        Total width across the edge.
    length_px
        Its length.
    levels
        Both levels and the noise of one frame.
    frames
        Number of frames whose mean is fitted.
    """
    covariance = np.linalg.inv(edge_information(sigma_px, levels))
    return sigma_px * sqrt(float(covariance[_LOG_SIGMA, _LOG_SIGMA]) / (length_px * frames))


def edge_information(sigma_px: float, levels: EdgeLevels) -> FloatArray:
    """Return the Fisher information of one px of edge in one frame.

    Returns
    -------
    ndarray of float64, shape (5, 5)
        Of offset, curvature (px at the ends), logarithm of sigma, low and high level. The turn is
        independent of them: its derivative is odd along the edge.
    """
    half_width_px = band_half_width(sigma_px)
    distance_px, step_px = np.linspace(-half_width_px, half_width_px, _STEPS, retstep=True)
    x = distance_px / sigma_px
    rise = ndtr(x)
    density = np.exp(-0.5 * x * x) / sqrt(2 * pi)
    weight = step_px / levels.frame_noise.variance_dn2(
        levels.low_dn + levels.contrast_dn * np.asarray(rise)
    )
    slopes = np.stack(
        [
            levels.contrast_dn * density / sigma_px,
            levels.contrast_dn * density / sigma_px,
            levels.contrast_dn * x * density,
            1 - rise,
            rise,
        ]
    )
    information = (slopes * weight) @ slopes.T
    information[_CURVATURE] *= _SQUARE
    information[:, _CURVATURE] *= _SQUARE
    information[_CURVATURE, _CURVATURE] *= _FOURTH / _SQUARE**2
    return np.asarray(information)


def white_noise_sigma_err_px(sigma_px: float, length_px: float, snr: float) -> float:
    """Return the error of a width in white noise where the levels are known: a closed form.

    The information about log sigma is ``length snr^2 sigma`` times the integral of ``x^2
    phi(x)^2``, which is ``1 / (4 sqrt(pi))``. With levels to be found in a finite band it is a
    bound from below.

    Parameters
    ----------
    sigma_px, length_px
        Total width and length of the edge.
    snr
        Contrast over the noise of a pixel.
    """
    return 2 * sqrt(sqrt(pi) * sigma_px / length_px) / snr
