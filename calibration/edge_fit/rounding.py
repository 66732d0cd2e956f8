"""What rounding adds to the levels of an edge where the noise is too small to make it random."""

from math import exp, pi, sin
from typing import NamedTuple

import numpy as np

from calibration.edge_fit.level_steps import LevelSteps
from simulation.arrays import FloatArray
from simulation.compiled import compiled, compiled_part

_TERMS = 8
_LEAST_NOISE = 0.095  # of a step: below, the error jumps at levels that no fit places so well


class Rounding(NamedTuple):
    """Steps of the stored levels and noise before rounding, in DN, of either side of an edge.

    All are 0 where rounding errors are random, or there are none.
    """

    dark_step_dn: float
    bright_step_dn: float
    dark_noise_dn: float
    bright_noise_dn: float

    @property
    def error_dn(self) -> float:
        """Standard deviation of the rounding errors over all phases of the level."""
        return float(0.5 * (self.dark_step_dn + self.bright_step_dn) / np.sqrt(12.0))


@compiled_part()
def rounding_of(steps: LevelSteps, edges: FloatArray, noise_dn: tuple[float, float]) -> Rounding:
    """Return the mean steps on either half of an edge; the noise is that before rounding."""
    count, total = np.zeros(2), np.zeros(2)
    for i in range(len(edges)):
        side = int(edges[i] >= 0.5)
        count[side] += 1
        total[side] += steps.upper[i] - steps.lower[i]
    return Rounding(total[0] / count[0], total[1] / count[1], noise_dn[0], noise_dn[1])


@compiled()
def rounding_bias(
    levels_dn: FloatArray, expected_dn: FloatArray, edges: FloatArray, rounding: Rounding
) -> FloatArray:
    """Mean rounding error of each pixel at the level that a fitted edge has there.

    It is 0 where the noise is below 0.1 of a step: what is lost there is not known.

    Parameters
    ----------
    levels_dn
        What is stored, shape ``(n,)``; of its steps the phase is taken.
    expected_dn
        Level before rounding and noise.
    edges
        The unit edge at each pixel.
    rounding
        Steps and noise.

    References
    ----------
    B. Widrow and I. Kollar, Quantization Noise (2008), chapter 5: the Fourier series of the mean
    error against the level, each term damped by the noise's characteristic function.
    """
    bias = np.zeros(len(levels_dn))
    if rounding.dark_step_dn <= 0 or rounding.bright_step_dn <= 0:
        return bias
    for i in range(len(bias)):
        e = min(max(edges[i], 0.0), 1.0)
        step = (1 - e) * rounding.dark_step_dn + e * rounding.bright_step_dn
        noise = ((1 - e) * rounding.dark_noise_dn + e * rounding.bright_noise_dn) / step
        if noise < _LEAST_NOISE:
            continue
        phase = 2 * pi * (expected_dn[i] - levels_dn[i]) / step
        sign = -1.0
        for k in range(1, _TERMS + 1):
            damping = exp(-2 * (pi * k * noise) ** 2)
            bias[i] += sign * step / (pi * k) * damping * sin(k * phase)
            sign = -sign
    return bias
