"""State of the live focus aid: value, peak hold, trend, and whether the peak was passed."""

from collections import deque
from dataclasses import dataclass
from typing import Literal

import numpy as np

Trend = Literal["rising", "steady", "falling"]

_SIGMAS = 5.0
_SIGMA_PER_MAD = 1.4826  # of a Gaussian
_SECOND_DIFFERENCE = 6.0**0.5  # white noise of 1 has second differences of this
_FEWEST = 5
_NOISES = 100
_HELD = 5  # values: detail at the limit of the noise does not come and go
_LEAST_NOISE = 1e-9  # relative; keeps constant values steady


@dataclass(frozen=True, slots=True, kw_only=True)
class FocusReading:
    """What the operator sees after each focus value.

    ``value`` is the smoothed one, ``peak`` the largest of those since the last reset.
    ``is_past_peak`` stays on until the value is back at the peak, so that it does not flicker.
    ``noise`` is the standard deviation of one value, 0 until there are enough values. Without
    ``has_detail`` there is nothing to focus on, and the value is the noise's.
    """

    value: float
    peak: float
    trend: Trend
    is_past_peak: bool
    noise: float
    has_detail: bool = True

    @property
    def percent_of_peak(self) -> float:
        """Value in percent of the peak; 0 if there is no peak, or nothing to focus on."""
        return 100.0 * self.value / self.peak if self.has_detail and self.peak > 0 else 0.0


class FocusTrace:
    """Follows focus values one by one; independent of devices and clocks.

    Parameters
    ----------
    smoothed
        Number of values in the running median that is shown; odd.
    window
        Number of values from which trend and noise are estimated.
    drop
        Relative drop below the peak at which the peak counts as passed, unless the noise
        requires more.
    """

    def __init__(self, *, smoothed: int = 3, window: int = 12, drop: float = 0.03) -> None:
        if smoothed < 1 or smoothed % 2 == 0 or window < 5 or not 0 < drop < 1:
            raise ValueError(
                "smoothed must be odd, window at least 5 and drop in (0, 1); "
                f"got {smoothed}, {window}, {drop}"
            )
        self._smoothed, self._drop = smoothed, drop
        self._raw: deque[float] = deque(maxlen=max(window, smoothed))
        self._noises: deque[float] = deque(maxlen=_NOISES)
        self.reset()

    def reset(self) -> None:
        """Forget the peak, for another target, region or exposure."""
        self._raw.clear()
        self._noises.clear()
        self._peak = -np.inf
        self._has_risen = False
        self._lowest = np.inf
        self._is_past = False
        self._empty = _HELD

    def add(self, value: float, *, has_detail: bool = True) -> FocusReading:
        """Add the next focus value and return the reading.

        Where there is nothing to focus on, the value counts for nothing: what was seen before is
        compared with what comes after.

        Raises
        ------
        ValueError
            If it is not finite.
        """
        if not np.isfinite(value):
            raise ValueError(f"a focus value must be finite, got {value}")
        self._empty = 0 if has_detail else self._empty + 1
        if self._empty and (self._empty >= _HELD or not self._raw):
            return self._nothing(value)
        self._raw.append(value)
        recent = list(self._raw)
        shown = float(np.median(recent[-self._smoothed :]))
        if len(recent) >= _FEWEST:
            self._noises.append(self._noise(recent))
        # Ten differences alone are a poor estimate; the noise changes slowly, so use many windows.
        noise = float(np.median(self._noises)) if self._noises else 0.0
        # Nothing is passed before the noise is known.
        margin = max(self._drop * max(self._peak, 0.0), _SIGMAS * noise if self._noises else np.inf)
        self._lowest = min(self._lowest, shown)
        if shown >= self._peak:
            self._peak = shown
        if self._peak - self._lowest > margin and shown >= self._peak - 0.5 * margin:
            self._has_risen = True
        if self._peak - shown > margin and self._has_risen:
            self._is_past = True
        elif self._peak - shown < 0.5 * margin:
            self._is_past = False
        return FocusReading(
            value=shown,
            peak=float(self._peak),
            trend=self._trend(recent, noise),
            is_past_peak=self._is_past,
            noise=noise,
        )

    def _nothing(self, value: float) -> FocusReading:
        self._raw.clear()
        return FocusReading(
            value=value,
            peak=max(float(self._peak), 0.0),
            trend="steady",
            is_past_peak=False,
            noise=float(np.median(self._noises)) if self._noises else 0.0,
            has_detail=False,
        )

    @staticmethod
    def _noise(recent: list[float]) -> float:
        """Scatter of single values from second differences, which ignore a steady change."""
        bends = np.diff(recent, 2)
        return float(_SIGMA_PER_MAD * np.median(np.abs(bends)) / _SECOND_DIFFERENCE)

    @staticmethod
    def _trend(recent: list[float], noise: float) -> Trend:
        """Slope over the window, if it exceeds the noise."""
        if len(recent) < _FEWEST:
            return "steady"
        steps = np.arange(len(recent)) - 0.5 * (len(recent) - 1)
        slope = float(steps @ np.array(recent) / (steps @ steps))
        level = max(noise, _LEAST_NOISE * max(abs(v) for v in recent), 1e-300)
        if abs(slope) <= _SIGMAS * level / float(np.sqrt(steps @ steps)):
            return "steady"
        return "rising" if slope > 0 else "falling"
