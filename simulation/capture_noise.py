"""Noise of simulated follow-ups: what remains of the reference's noise, and what to add.

A zoom-out averages reference pixels, so a simulated follow-up is less noisy than a captured one.
Its own variance is the sum of squared weights times the reference's variances; the difference
from the camera's variance at that level is added as fresh noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulation.arguments import check_fields
from simulation.arrays import FloatArray, FloatImage

if TYPE_CHECKING:
    from simulation.zoom import SeparableSum, ZoomOperator


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureNoise:
    """Temporal noise of a capture: shot noise and read noise of a mean of frames.

    Parameters
    ----------
    gain_e_per_dn
        Gain in electrons per DN; 1/K of EMVA 1288.
    read_noise_e
        Read noise: standard deviation of the dark noise of one frame, in electrons.
    black_level_dn
        Level without light, in DN.
    frames_averaged
        Number of frames in the mean.

    Raises
    ------
    ArgumentError
        If a value is not finite, the gain is not positive, the read noise is negative, or the
        number of frames is below 1.

    References
    ----------
    EMVA Standard 1288, release 4.0, section 2.4, equation (14).
    """

    gain_e_per_dn: float
    read_noise_e: float
    black_level_dn: float
    frames_averaged: int = 1

    def __post_init__(self) -> None:
        check_fields(self)

    def variance_dn2(self, level_dn: NDArray[np.floating]) -> FloatArray:
        """Variance of a pixel of the mean at each level, in DN^2."""
        light_dn = np.maximum(np.asarray(level_dn, dtype=np.float64) - self.black_level_dn, 0.0)
        read_dn = self.read_noise_e / self.gain_e_per_dn
        return np.asarray((light_dn / self.gain_e_per_dn + read_dn**2) / self.frames_averaged)


def propagated_variance(operator: ZoomOperator, variance_dn2: NDArray[np.floating]) -> FloatArray:
    """Variance of a simulated image of a reference whose pixels have independent noise, exactly."""
    variance = np.asarray(variance_dn2, dtype=np.float64)
    if not (np.all(np.isfinite(variance)) and np.all(variance >= 0)):
        raise ValueError("variances must be finite and not negative")
    squared = _squared_weights(operator)
    # Rounding in terms of either sign may leave values slightly below zero.
    return np.maximum(np.asarray(squared.apply(variance), dtype=np.float64), 0.0)


def with_capture_noise(
    followup_dn: FloatImage,
    own_variance_dn2: FloatArray,
    noise: CaptureNoise,
    rng: np.random.Generator,
) -> FloatImage:
    """Follow-up with the noise of a captured one, in its dtype.

    ``own_variance_dn2`` is what the reference's noise left in it; a noisier image gets no more.
    """
    if own_variance_dn2.shape != followup_dn.shape:
        raise ValueError(
            f"variances of shape {own_variance_dn2.shape} do not match an image of shape "
            f"{followup_dn.shape}"
        )
    missing = np.maximum(noise.variance_dn2(followup_dn) - own_variance_dn2, 0.0)
    noisy = followup_dn + np.sqrt(missing) * rng.standard_normal(followup_dn.shape)
    return noisy.astype(followup_dn.dtype)


def _squared_weights(operator: ZoomOperator) -> SeparableSum:
    """Operator whose weights are the squares of the composed operator's.

    The square of a sum of products is the sum over all pairs of terms of the products of
    their factors, so it stays separable.
    """
    from simulation.zoom import SeparableSum  # whoever has an operator has loaded it

    composed = operator.stages[0].terms
    for stage in operator.stages[1:]:
        composed = tuple(
            (later_y @ y, later_x @ x) for later_y, later_x in stage.terms for y, x in composed
        )
    pairs = []
    for i, (y, x) in enumerate(composed):
        for j in range(i + 1):
            other_y, other_x = composed[j]
            # A pair of different terms occurs twice in the square.
            product_y = y.elementwise(other_y, factor=1.0 if i == j else 2.0)
            pairs.append((product_y, x.elementwise(other_x)))
    return SeparableSum(tuple(pairs))
