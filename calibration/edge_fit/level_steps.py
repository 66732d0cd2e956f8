"""The steps in which the pixels around an edge are stored, read from their own levels.

A file tells how many bits it has, not in which steps the plane that is measured comes: linear
light from an sRGB file has steps that grow with the level, the mean of N frames has an Nth of a
step, and 12 bits in 16 have sixteen. The distinct levels near an edge show all of these, and where
they show none - the luma of three channels, a resampled image - rounding is fine beside the noise.
"""

from typing import NamedTuple

import numpy as np

from calibration.edge_fit.residuals import between, cut_variance
from simulation.arrays import FloatArray
from simulation.compiled import compiled_part

_FIRST_PIXELS = 64
_FIRST_LEVELS = 44  # more among so many pixels: the noise is far above one step
_MOST_LEVELS = 512  # over the contrast: finer steps do not matter, and chance makes some
_FEWEST_LEVELS = 4
_WHOLE = 0.01  # of a step: how near to whole multiples the distances of an even grid are
_ALIKE = 1.35  # ratio of neighbouring steps: 1.25 in sRGB at code 10, two of an even grid
_SHARE_ALIKE = 0.75
_COARSE = 0.6  # of a step: scatter below which rounding is no independent noise
_COINCIDE = 1e-7  # of the range: levels nearer to each other are one


class LevelSteps(NamedTuple):
    """For each pixel the levels that are stored as its own; ``is_found`` false: no steps seen.

    ``lower`` and ``upper`` have shape ``(n,)``; a level in between was rounded to the pixel's.
    ``step_dn`` is the mean distance between them, 0 where there are none.
    """

    is_found: bool
    lower: FloatArray
    upper: FloatArray
    step_dn: float


@compiled_part()
def level_steps(values: FloatArray) -> LevelSteps:
    """Find the steps of levels of shape ``(n,)``, where all are those of one grid.

    The grid is even, or changes slowly with the level; then few steps may be missing.
    """
    none = LevelSteps(False, values, values, 0.0)
    if len(values) < _FIRST_PIXELS:
        return none
    span = values.max() - values.min()
    near = _COINCIDE * span
    if len(_distinct(values, len(values) // _FIRST_PIXELS, near)) > _FIRST_LEVELS:
        return none
    levels = _distinct(values, 1, near)
    if not _FEWEST_LEVELS <= len(levels) <= _MOST_LEVELS:
        return none
    steps = levels[1:] - levels[:-1]
    least = steps.min()
    if np.abs(steps / least - np.rint(steps / least)).max() < _WHOLE:
        if least * _MOST_LEVELS < span:
            return none
        return LevelSteps(True, values - 0.5 * least, values + 0.5 * least, least)
    alike = 0
    for k in range(1, len(steps)):
        ratio = steps[k] / steps[k - 1]
        alike += int(1 / _ALIKE < ratio < _ALIKE)
    if alike < _SHARE_ALIKE * (len(steps) - 1) or len(steps) < 2 * _FEWEST_LEVELS:
        return none
    found = _between_neighbours(values, levels, steps)
    return found if found.step_dn * _MOST_LEVELS >= span else none


@compiled_part()
def _distinct(values: FloatArray, stride: int, near: float) -> FloatArray:
    """Distinct levels of every ``stride``-th pixel, rising; at most one above ``_MOST_LEVELS``."""
    levels = np.empty(_MOST_LEVELS + 1)
    count = 0
    for i in range(0, len(values), stride):
        value = values[i]
        k = np.searchsorted(levels[:count], value - near)
        if k < count and levels[k] <= value + near:
            continue
        for j in range(count, k, -1):
            levels[j] = levels[j - 1]
        levels[k] = value
        count += 1
        if count > _MOST_LEVELS:
            break
    return levels[:count]


@compiled_part()
def _between_neighbours(values: FloatArray, levels: FloatArray, steps: FloatArray) -> LevelSteps:
    """Half way to either neighbouring level; where that one is missing, half a step near by."""
    last = len(steps) - 1
    half = np.empty(len(steps))
    for k in range(len(steps)):
        near = steps[max(k - 2, 0) : min(k + 2, last) + 1].min()
        half[k] = 0.5 * (steps[k] if steps[k] < _ALIKE * _ALIKE * near else near)
    lower, upper = np.empty_like(values), np.empty_like(values)
    for i in range(len(values)):
        k = min(max(np.searchsorted(levels, values[i] - 0.5 * steps.min()), 0), len(levels) - 1)
        lower[i] = values[i] - half[max(k - 1, 0)]
        upper[i] = values[i] + half[min(k, last)]
    return LevelSteps(True, lower, upper, float(np.mean(upper - lower)))


@compiled_part()
def is_coarse(scatter: FloatArray, edges: FloatArray, steps: LevelSteps) -> bool:
    """Whether the noise of either side is too small for rounding to be noise of its own.

    Rounding error is white and uniform to exp(-2 pi^2 s^2 / step^2) (Widrow and Kollar,
    Quantization Noise, 2008, chapter 5): 0.7 % at half a step, where the scatter with
    rounding is 0.58 of one.
    """
    if not steps.is_found:
        return False
    relative = np.empty(len(scatter))
    for i in range(len(scatter)):
        relative[i] = scatter[i] / (steps.upper[i] - steps.lower[i])
    dark, bright = between(relative, edges, -1.0, 0.5), between(relative, edges, 0.5, 2.0)
    if min(len(dark), len(bright)) == 0:
        return False
    return bool(min(cut_variance(dark), cut_variance(bright)) < _COARSE**2)
