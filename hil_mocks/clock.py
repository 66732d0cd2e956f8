"""Time on the simulated bench: it passes when a device uses it, or in real time."""

import time
from collections.abc import Callable

NS_PER_S = 1_000_000_000


class SimulatedClock:
    """A clock that camera and stage share and advance.

    Attributes
    ----------
    slice_s
        Longest time by which a move advances the clock at once.
    """

    slice_s = float("inf")

    def __init__(self) -> None:
        self._now_ns = 0

    @property
    def now_ns(self) -> int:
        """Time since the bench was switched on, in ns."""
        return self._now_ns

    @property
    def now_s(self) -> float:
        """Time since the bench was switched on, in s."""
        return self._now_ns / NS_PER_S

    def advance(self, duration_s: float) -> None:
        """Let time pass.

        Raises
        ------
        ValueError
            If the duration is negative.
        """
        if not duration_s >= 0:
            raise ValueError(f"a duration must not be negative, got {duration_s} s")
        self._now_ns += round(duration_s * NS_PER_S)


class RealTimeClock(SimulatedClock):
    """A clock in real time: advancing it takes that long, and moves can be stopped.

    Parameters
    ----------
    clock, sleep
        Monotonic time in seconds, and a function that waits.
    """

    slice_s = 0.05

    def __init__(
        self,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        super().__init__()
        self._clock = clock
        self._sleep = sleep
        self._start_s = clock()

    @property
    def now_ns(self) -> int:
        """See `SimulatedClock.now_ns`."""
        return round((self._clock() - self._start_s) * NS_PER_S)

    @property
    def now_s(self) -> float:
        """See `SimulatedClock.now_s`."""
        return self._clock() - self._start_s

    def advance(self, duration_s: float) -> None:
        """Wait.

        Raises
        ------
        ValueError
            If the duration is negative.
        """
        if not duration_s >= 0:
            raise ValueError(f"a duration must not be negative, got {duration_s} s")
        self._sleep(duration_s)
