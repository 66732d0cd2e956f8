"""Ends a move that makes no progress, long before its time limit."""

from collections.abc import Callable

from acquisition.bench import StageConfig
from acquisition.errors import StageStalledError
from acquisition.stages.axis import AxisTraits

NO_PROGRESS_S = 2.0
"""Longer than a ramp, a late report or the start of a move takes; a time limit is minutes."""

SHARE_OF_FEED = 0.25
"""Part of the feed below which a move counts as blocked: ramps are short beside `NO_PROGRESS_S`."""


def smallest_progress_mm(config: StageConfig, traits: AxisTraits) -> float:
    """Travel that is progress: more than a reading repeats to, less than a slow feed covers."""
    covered_mm = config.feed_mm_per_min / 60 * NO_PROGRESS_S
    return min(traits.repeat_mm, SHARE_OF_FEED * covered_mm)


class ProgressWatch:
    """Watches a distance that has to shrink.

    Parameters
    ----------
    clock
        Time in seconds.
    least_mm
        A decrease counts if it is larger than this.
    readings
        Readings without a decrease after which it is too late at the earliest.
    """

    def __init__(self, *, clock: Callable[[], float], least_mm: float, readings: int = 2) -> None:
        self._clock = clock
        self._least_mm = least_mm
        self._readings = readings
        self._best_mm = float("inf")
        self._since_s = clock()
        self._idle_readings = 0

    def see(self, distance_mm: float, *, state: str, height_mm: float) -> None:
        """Take note of a reading.

        Raises
        ------
        StageStalledError
            If the distance has not shrunk for `NO_PROGRESS_S`; the stage may be moving.
        """
        if distance_mm < self._best_mm - self._least_mm:
            self._best_mm, self._since_s, self._idle_readings = distance_mm, self._clock(), 0
            return
        self._idle_readings += 1
        if self._clock() - self._since_s >= NO_PROGRESS_S and self._idle_readings >= self._readings:
            raise StageStalledError(
                f"no progress for {NO_PROGRESS_S:g} s: the controller reports {state} "
                f"at {height_mm:.3f} mm",
                timeout_s=NO_PROGRESS_S,
                state=state,
                height_mm=height_mm,
            )
