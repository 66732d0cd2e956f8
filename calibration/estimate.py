"""A measured value with its standard error and its 95 % interval, and how both are written."""

from dataclasses import dataclass, replace
from math import floor, hypot, inf, isnan, log10, nan
from typing import Final, Self

NORMAL_95: Final = 1.959963984540054
"""Half width of a 95 % interval in standard errors."""

_DIGITS_MOST = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A value, its standard error and its 95 % interval: a normal one if none is given."""

    value: float
    err: float
    interval_95: tuple[float, float] = (nan, nan)

    def __post_init__(self) -> None:
        if isnan(self.interval_95[0]):
            reach = NORMAL_95 * self.err
            object.__setattr__(self, "interval_95", (self.value - reach, self.value + reach))

    @property
    def low(self) -> float:
        """Lower end of the interval."""
        return self.interval_95[0]

    @property
    def high(self) -> float:
        """Upper end of the interval."""
        return self.interval_95[1]

    @property
    def half_width(self) -> float:
        """Half of the interval."""
        return 0.5 * (self.high - self.low)

    def scaled(self, factor: float) -> Self:
        """Return the estimate in another unit."""
        low, high = sorted((factor * self.low, factor * self.high))
        value, err = factor * self.value, abs(factor) * self.err
        return replace(self, value=value, err=err, interval_95=(low, high))

    def with_relative(self, error: float) -> Self:
        """Return the estimate with a further, independent relative error."""
        if error == 0:
            return self
        more = error * self.value
        below = hypot(self.value - self.low, NORMAL_95 * more)
        above = hypot(self.high - self.value, NORMAL_95 * more)
        interval = (self.value - below, self.value + above)
        return replace(self, err=hypot(self.err, more), interval_95=interval)

    def text(self, digits: int, unit: str = "") -> str:
        """Format the value with half its interval, as `with_reach` does, and a unit."""
        return f"{with_reach(self.value, self.half_width, digits)} {unit}".rstrip()

    def __str__(self) -> str:
        return f"{self.value:.4f} ± {self.err:.4f}"


def with_reach(value: float, reach_95: float | None, digits: int) -> str:
    """Format a value with half its 95 % interval, in so many digits that the half is not 0."""
    if reach_95 is None:
        return f"{value:.{digits}f}"
    if 0 < reach_95 < 10.0**-digits:
        digits = min(-floor(log10(reach_95)), _DIGITS_MOST)
    return f"{value:.{digits}f} ± {reach_95:.{digits}f}"


def signed_with_reach(value: float, reach_95: float) -> str:
    """Format a value with its sign and half its 95 % interval, both to the half's second digit."""
    if not 10.0 ** (1 - _DIGITS_MOST) <= reach_95 < inf:
        return f"{value:+.3g} ± {reach_95:.2g}"
    # Rounded first: 0.0996 has its second digit where 0.10 has it.
    digits = max(1 - floor(log10(float(f"{reach_95:.1e}"))), 0)
    return f"{value:+z.{digits}f} ± {reach_95:.{digits}f}"
