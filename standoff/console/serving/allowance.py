"""How often something may be done: some at once, the others at a steady rate."""

from collections.abc import Callable


class Allowance:
    """A number of turns that fills up again with time.

    Parameters
    ----------
    at_once
        Turns that may be taken in one go after a rest.
    period_s
        Seconds until one more is there.
    clock
        Seconds.
    """

    def __init__(self, *, at_once: int, period_s: float, clock: Callable[[], float]) -> None:
        self._at_once = at_once
        self._period_s = period_s
        self._clock = clock
        self._left = float(at_once)
        self._at_s = clock()

    @property
    def wait_s(self) -> float:
        """Seconds until a turn may be taken; 0 if one may be taken now."""
        return max(0.0, 1.0 - self._filled()) * self._period_s

    @property
    def is_full(self) -> bool:
        """Whether as many turns are there as at the beginning."""
        return self._filled() >= self._at_once

    def take(self) -> float:
        """Take a turn, if need be one of the future; return the seconds until it comes."""
        self._left = self._filled() - 1.0
        self._at_s = self._clock()
        return max(0.0, -self._left) * self._period_s

    def _filled(self) -> float:
        gained = (self._clock() - self._at_s) / self._period_s
        return min(float(self._at_once), self._left + gained)
