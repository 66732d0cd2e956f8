"""The quintic B-spline after a Gaussian blur: a table over the blur and the subpixel position.

Sampling a spline that is blurred differently at every position takes its weights from here. Both
interpolations keep the sum of the weights and their centre of mass: a constant stays a constant
and a ramp a ramp. ``docs/theory-pose.md`` holds the errors.
"""

from functools import lru_cache
from math import ceil, expm1, log1p
from typing import NamedTuple

import numpy as np

from simulation.arrays import Float32Array, IntArray

PHASES = 128
"""Positions per pixel; linear between them, an error of max|w''| / 8 / PHASES^2 = 8e-6."""

LEVELS_PER_LOG = 64
"""Levels per unit of log(1 + sigma), linear in the variance between them: errors up to 2e-5."""

SIGMA_MAX_PX = 32.0
"""Widest blur with a table, which is then 35 MB."""

_TAIL = 2e-5
"""Sum of the weights that are cut off on one side."""

_SPLINE_RADIUS_PX = 4


class SplineGaussianTable(NamedTuple):
    """Weights of the spline coefficients around a position.

    Parameters
    ----------
    weights
        Shape ``(levels, PHASES + 1, 2 R)``, float32. Level k blurs by
        ``exp(k / LEVELS_PER_LOG) - 1`` px, phase j is ``j / PHASES`` px after a pixel i, and
        element m is the weight of coefficient ``i - R + 1 + m``.
    radii
        Shape ``(levels,)``: half the number of weights that a level needs; even.
    """

    weights: Float32Array
    radii: IntArray


def spline_gaussian(sigma_px: float) -> SplineGaussianTable:
    """Table for blurs up to ``sigma_px``.

    Raises
    ------
    ValueError
        If it is wider than ``SIGMA_MAX_PX``.
    """
    if not 0 <= sigma_px <= SIGMA_MAX_PX:
        raise ValueError(f"a local blur of {sigma_px:.3g} px is wider than {SIGMA_MAX_PX:g} px")
    # In steps of half a unit of the logarithm, so that similar frames share a table.
    halves = ceil(2 * log1p(sigma_px) + 1e-9)
    return _table(halves * LEVELS_PER_LOG // 2 + 2)


@lru_cache(maxsize=8)
def _table(levels: int) -> SplineGaussianTable:
    sigmas_px = [expm1(level / LEVELS_PER_LOG) for level in range(levels)]
    reach = _SPLINE_RADIUS_PX + ceil(4.5 * sigmas_px[-1])
    reach += reach % 2
    period = 2 * reach + 8
    freq = np.fft.rfftfreq(period * PHASES, 1 / PHASES)
    offset = np.arange(-reach + 1, reach + 1)
    # Position of every weight: phase - offset, in samples, wrapped around.
    sample = (np.arange(PHASES + 1)[:, None] - offset[None, :] * PHASES) % (period * PHASES)
    weights = np.zeros((levels, PHASES + 1, 2 * reach), dtype=np.float32)
    radii = np.empty(levels, dtype=np.int64)
    for level, sigma_px in enumerate(sigmas_px):
        transfer = np.sinc(freq) ** 6 * np.exp(-2 * (np.pi * sigma_px * freq) ** 2)
        profile = np.fft.irfft(transfer, period * PHASES) * PHASES
        rows = profile[sample]
        outer = np.cumsum(np.abs(rows).max(axis=0)[:reach])
        radius = reach - int(np.searchsorted(outer, _TAIL))
        radius = min(max(radius + radius % 2, _SPLINE_RADIUS_PX), reach)
        rows[:, : reach - radius] = 0.0
        rows[:, reach + radius :] = 0.0
        weights[level] = rows / rows.sum(axis=1, keepdims=True)
        radii[level] = radius
    weights.setflags(write=False)
    radii.setflags(write=False)
    return SplineGaussianTable(weights, radii)
