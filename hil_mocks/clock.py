"""Time on the simulated bench: it passes when a device uses it, and nobody sleeps."""

__all__ = ["SimulatedClock"]

NS_PER_S = 1_000_000_000


class SimulatedClock:
    """A clock that camera and stage share and move on."""

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
            raise ValueError(f"time does not run backwards, got {duration_s} s")
        self._now_ns += round(duration_s * NS_PER_S)
