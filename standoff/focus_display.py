"""What the operator sees of the live focus aid: one line that follows the value."""

from collections.abc import Callable
from types import TracebackType
from typing import Self

from rich.live import Live
from rich.text import Text

from acquisition.focus_trace import FocusReading
from standoff.output import ERRORS

__all__ = ["FocusDisplay", "focus_line"]

_BAR_CELLS = 30
_ARROWS = {"rising": "↑ rising ", "steady": "→ steady ", "falling": "↓ falling"}
_INTERVAL_S = 0.1
_PLAIN_INTERVAL_S = 1.0


def focus_line(reading: FocusReading) -> str:
    """Value, bar, trend, share of the peak and the peak, as one line of text."""
    share = reading.percent_of_peak
    filled = round(_BAR_CELLS * min(max(share, 0.0), 100.0) / 100.0)
    bar = "█" * filled + "·" * (_BAR_CELLS - filled)
    hint = "   past the peak: go back" if reading.is_past_peak else ""
    return (
        f"focus {reading.value:10.5g} {bar} {share:5.1f} % of peak {reading.peak:.5g}  "
        f"{_ARROWS[reading.trend]}{hint}"
    )


class FocusDisplay:
    """Shows readings on stderr: in place on a terminal, else a plain line a second.

    Parameters
    ----------
    clock
        Seconds; readings that come faster than the eye are not drawn.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._shown_s: float | None = None
        self._live = Live(console=ERRORS, auto_refresh=False) if ERRORS.is_terminal else None

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._live is not None:
            self._live.__exit__(kind, error, trace)

    def show(self, reading: FocusReading) -> None:
        """Draw a reading, unless one was drawn a moment ago."""
        now_s = self._clock()
        interval_s = _PLAIN_INTERVAL_S if self._live is None else _INTERVAL_S
        if self._shown_s is not None and now_s - self._shown_s < interval_s:
            return
        self._shown_s = now_s
        text = focus_line(reading)
        if self._live is None:
            ERRORS.print(text, markup=False)
        else:
            style = "yellow" if reading.is_past_peak else ""
            self._live.update(Text(text, style=style), refresh=True)
