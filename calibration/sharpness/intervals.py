"""Figures with 95 % intervals, and those of the smallest, the largest and the median of many."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi, sqrt
from typing import Literal, Self

import numpy as np
from scipy.special import ndtri

from calibration.robust import robust_sigma

_RISK = 0.05
_MEDIAN_ERR = sqrt(pi / 2)  # standard error of a median over that of a mean, Gaussian scatter
_FEWEST_FOR_SCATTER = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """A value, its standard error, its 95 % interval, and what or where it is of."""

    value: float
    err: float
    low: float
    high: float
    where: str

    @classmethod
    def normal(cls, value: float, err: float, where: str = "") -> Self:
        """Return a figure with the interval of a normal distribution."""
        reach = _reach(1) * err
        return cls(value=value, err=err, low=value - reach, high=value + reach, where=where)

    def scaled(self, factor: float) -> "Figure":
        """Return the figure in another unit."""
        return replace(
            self,
            value=factor * self.value,
            err=factor * self.err,
            low=factor * self.low,
            high=factor * self.high,
        )

    def modulus(self) -> "Figure":
        """Return the figure without its sign."""
        low, high = sorted((abs(self.low), abs(self.high)))
        has_zero = self.low <= 0 <= self.high
        return replace(self, value=abs(self.value), low=0.0 if has_zero else low, high=high)


def smallest(figures: Sequence[Figure]) -> Figure:
    """Return the smallest of several true values, with a simultaneous 95 % interval.

    Each of n figures gets the interval of 1 - 0.05 / n (Bonferroni): where all n hold, the smallest
    true value lies between the smallest of the lower and the smallest of the upper ends.

    Raises
    ------
    ValueError
        If there is none.
    """
    return _extreme("smallest", figures)


def largest(figures: Sequence[Figure]) -> Figure:
    """Return the largest of several true values, with a simultaneous 95 % interval.

    Raises
    ------
    ValueError
        If there is none.
    """
    return _extreme("largest", figures)


def _extreme(which: Literal["smallest", "largest"], figures: Sequence[Figure]) -> Figure:
    if not figures:
        raise ValueError(f"the {which} of no figures")
    choose = min if which == "smallest" else max
    reach = _reach(len(figures))
    found = choose(figures, key=lambda figure: figure.value)
    return replace(
        found,
        low=choose(_least(figure, reach) for figure in figures),
        high=choose(figure.value + reach * figure.err for figure in figures),
    )


def _least(figure: Figure, reach: float) -> float:
    """Lower end of an interval; what cannot be negative does not become so."""
    end = figure.value - reach * figure.err
    return max(end, 0.0) if figure.value >= 0 else end


def median_of(figures: Sequence[Figure], where: str) -> Figure:
    """Return the median, with an error from the scatter or their own errors if those are more.

    The scatter of fewer than four is no measure: their own errors count alone.

    Raises
    ------
    ValueError
        If there is none.
    """
    if not figures:
        raise ValueError("the median of no figures")
    values = np.array([figure.value for figure in figures])
    errs = np.array([figure.err for figure in figures])
    count = values.size
    share = 1.0 if count < 3 else _MEDIAN_ERR  # a median of two is their mean
    err = share * sqrt(float(np.mean(errs**2)) / count)
    middle = float(np.median(values))
    if count >= _FEWEST_FOR_SCATTER:
        err = max(err, _MEDIAN_ERR * robust_sigma(values - middle) / sqrt(count))
    return Figure.normal(middle, err, f"{where} ({count} edge{'s' * (count > 1)})")


def ratio(above: Figure, below: Figure) -> Figure:
    """Return the ratio of two positive figures; its interval holds if both of theirs do.

    The ends are the extreme quotients, so 95 % becomes at least 90 % for the pair; each interval
    is therefore widened to 97.5 % (Bonferroni).
    """
    widen = _reach(2) / _reach(1)
    low_above = max(above.value - widen * (above.value - above.low), 0.0)
    high_above = above.value + widen * (above.high - above.value)
    low_below = max(below.value - widen * (below.value - below.low), 1e-12)
    high_below = below.value + widen * (below.high - below.value)
    value = above.value / below.value
    return Figure(
        value=value,
        err=value * sqrt((above.err / above.value) ** 2 + (below.err / below.value) ** 2),
        low=low_above / high_below,
        high=high_above / low_below,
        where=f"{above.where} over {below.where}",
    )


def _reach(count: int) -> float:
    """Half width in standard errors of intervals that hold all together in 95 % of cases."""
    return float(ndtri(1 - _RISK / (2 * count)))
