"""Exposures that one waits for: how long the present one still takes, and breaking it off."""

from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

LONG_S = 2.0
"""Longer exposures are asked about first, counted down, and can be broken off."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposing:
    """A long exposure; ``left_s`` is 0 once its frame is due.

    ``is_dropped`` says that it was broken off, and that the camera finishes it all the same.
    """

    seconds: float
    left_s: float
    is_dropped: bool = False


class ExposureClock:
    """Follows the exposures of one camera; its thread tells when each begins.

    A long exposure that is broken off ends with the stream. A camera that cannot abort finishes
    it: until then nothing else comes from it, and what does is dropped.

    Parameters
    ----------
    clock
        Monotonic time in seconds.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._lock = Lock()
        self._seconds = self._began_s = 0.0
        self._dropped: tuple[float, float] | None = None
        self.shorter_us = 1e6 * LONG_S
        """The last exposure that was not long."""

    @property
    def view(self) -> Exposing | None:
        """The long exposure that is waited for; None if there is none."""
        with self._lock:
            # The exposure that follows it is told of, if that is long as well.
            is_dropped = self._dropped is not None and self._seconds <= LONG_S
            now = self._began_s, self._seconds
            began_s, seconds = (self._dropped or now) if is_dropped else now
        if seconds <= LONG_S:
            return None
        left_s = max(0.0, began_s + seconds - self._clock())
        if is_dropped and left_s == 0:
            return None
        return Exposing(seconds=seconds, left_s=left_s, is_dropped=is_dropped)

    @property
    def is_broken_off(self) -> bool:
        """Whether the camera may still be busy with an exposure that nobody waits for."""
        dropped = self._dropped
        return dropped is not None and self._clock() < sum(dropped) + LONG_S

    def began(self, exposure_us: float) -> None:
        """Note that a frame is being exposed from now on."""
        with self._lock:
            self._seconds, self._began_s = 1e-6 * exposure_us, self._clock()
            if self._seconds <= LONG_S:
                self.shorter_us = exposure_us

    def ended(self) -> None:
        """Note that nothing is exposed any more."""
        with self._lock:
            self._seconds, self._dropped = 0.0, None

    def break_off(self) -> bool:
        """Give the present exposure up if it is long; returns whether it was."""
        with self._lock:
            if self._seconds <= LONG_S:
                return False
            self._dropped = self._began_s, self._seconds
            return True

    def is_dropped(self) -> bool:
        """Whether the frame that came is the one of an exposure given up; only one is."""
        with self._lock:
            was, self._dropped = self._dropped, None
            is_early = self._clock() < self._began_s + self._seconds
            return was is not None and (is_early or self._seconds <= LONG_S)
