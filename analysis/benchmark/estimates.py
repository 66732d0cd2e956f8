"""Estimates over tasks with their 95 % intervals, by resampling scenes.

Tasks of one scene resemble each other, so whole scenes are drawn, with replacement. The draws
follow from the number of scenes alone: programs are judged on the same draws, and the same files
give the same intervals to the last bit.

References
----------
B. Efron, R. J. Tibshirani, "An Introduction to the Bootstrap", 1993, chapters 8 and 13 (clusters,
percentiles).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from math import nan
from typing import Literal

import numpy as np

from analysis.evaluation.roc import share_interval
from simulation.arrays import FloatArray, IntArray

DRAWS = 1000
_SEED = 20240
_TAILS = (0.025, 0.975)

Relation = Literal["=", ">", "<"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A value with its 95 % interval.

    ``relation`` says that the value is only a bound where that is all the tasks say. An end of the
    interval is None where it is not known: of a single scene, or beyond what was tried.
    """

    value: float
    low: float | None
    high: float | None
    relation: Relation = "="


def scene_numbers(scenes: Sequence[str]) -> IntArray:
    """Return the number of each task's scene, by the order of the scenes' names."""
    return np.unique(np.array(scenes, dtype=np.str_), return_inverse=True)[1].astype(np.int64)


@cache
def scene_draws(scenes: int, draws: int = DRAWS) -> IntArray:
    """How often each scene is drawn, shape (draws, scenes); every row's sum is ``scenes``."""
    rng = np.random.default_rng(_SEED)
    return rng.multinomial(scenes, np.full(scenes, 1 / scenes), size=draws)


def percentiles(values: FloatArray) -> tuple[float, float]:
    """Ends of the interval in which 95 % of the draws' values lie.

    Values may be infinite; those that are NaN, of draws that say nothing, are left out.
    """
    ordered = np.sort(values[~np.isnan(values)])
    low, high = (ordered[round(tail * (ordered.size - 1))] for tail in _TAILS)
    return float(low), float(high)


def estimate(
    values: FloatArray, scenes: IntArray, statistic: Callable[[FloatArray], float]
) -> Estimate | None:
    """Estimate a statistic of the tasks' values.

    Parameters
    ----------
    values
        One a task, shape (n,) or (n, k).
    scenes
        The number of each task's scene, shape (n,).
    statistic
        Of any choice of rows of ``values``.

    Returns
    -------
    Estimate or None
        None without tasks.
    """
    if not len(values):
        return None
    value = float(statistic(values))
    numbers = np.unique(scenes, return_inverse=True)[1]
    count = int(numbers.max()) + 1
    if count < 2:
        return Estimate(value=value, low=None, high=None)
    drawn = np.array(
        [statistic(np.repeat(values, draw[numbers], axis=0)) for draw in scene_draws(count)]
    )
    low, high = percentiles(drawn)
    return Estimate(value=value, low=low, high=high)


def share(is_hit: Sequence[bool], scenes: IntArray) -> Estimate | None:
    """Estimate a share of the tasks in percent.

    The interval is symmetric in the logit, with the variance between scenes; where no scene differs
    from another it is Clopper and Pearson's of so many scenes, as resampling would then find none.
    """
    if not len(is_hit):
        return None
    hit = np.asarray(is_hit, np.float64)
    numbers = np.unique(scenes, return_inverse=True)[1]
    count = int(numbers.max()) + 1
    value = float(hit.mean())
    away = np.bincount(numbers, hit - value)
    variance = float(np.sum(away**2)) / hit.size**2 * count / max(count - 1, 1)
    return _share_estimate(value, variance, count)


def share_of_sums(sums: FloatArray, scenes: IntArray) -> Estimate | None:
    """Estimate in percent what share the first column's sum is of the second's, shape (n, 2).

    By resampling; where all is found or nothing, as ``share`` does.
    """
    found, total = (float(column.sum()) for column in sums.T)
    if not total > 0:
        return None
    if found in (0.0, total):
        return certain_share(found / total, scenes[sums[:, 1] > 0])
    return estimate(sums, scenes, _percent)


def certain_share(value: float, scenes: IntArray) -> Estimate:
    """Estimate in percent a share that is 0 or 1 in every scene."""
    return _share_estimate(value, 0.0, np.unique(scenes).size)


def _share_estimate(value: float, variance: float, count: int) -> Estimate:
    interval = share_interval(value, variance, count - 1, count)
    return Estimate(value=100 * value, low=100 * interval.low, high=100 * interval.high)


def _percent(sums: FloatArray) -> float:
    """NaN of nothing."""
    total = float(sums[:, 1].sum())
    return 100 * float(sums[:, 0].sum()) / total if total > 0 else nan
