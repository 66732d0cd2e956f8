"""What a camera sees, as lines that follow it: the focus value, and verdicts on its pose."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from acquisition.focus import FocusReading
from analysis.pose import PoseVerdict
from standoff.terminal.live_line import LiveLine
from standoff.terminal.output import say

_BAR_CELLS = 30
_ARROWS = {"rising": "↑ rising ", "steady": "→ steady ", "falling": "↓ falling"}


@contextmanager
def focus_display(clock: Callable[[], float]) -> Iterator[Callable[[FocusReading], None]]:
    """Yield a callback that shows a reading of the focus aid."""
    with LiveLine(clock) as line:
        yield lambda reading: line.show(
            _reading_text(reading), "yellow" if reading.is_past_peak else ""
        )


def _reading_text(reading: FocusReading) -> str:
    """Value, bar, trend, share of the peak and the peak, as one line of text."""
    share = reading.percent_of_peak
    filled = round(_BAR_CELLS * min(max(share, 0.0), 100.0) / 100.0)
    bar = "█" * filled + "·" * (_BAR_CELLS - filled)
    hint = "   past the peak: go back" if reading.is_past_peak else ""
    return (
        f"focus {reading.value:10.5g} {bar} {share:5.1f} % of peak {reading.peak:.5g}  "
        f"{_ARROWS[reading.trend]}{hint}"
    )


def verdict_line(name: str, verdict: PoseVerdict) -> str:
    """One line for the operator: verdict, margin and reason."""
    word = "accept" if verdict.accepted else "reject" if verdict.dprime is not None else "lost"
    margin = "" if verdict.margin is None else f"{100 * verdict.margin:+6.1f} %"
    return f"{name:<12} {word:<6} {margin:>8}  {verdict.reason}"


@contextmanager
def verdict_display(
    *, is_live: bool, is_silent: bool
) -> Iterator[Callable[[str, PoseVerdict], None]]:
    """Yield a callback that shows a verdict of a stream, given the frame's name and the verdict.

    Parameters
    ----------
    is_live
        A camera's verdicts go to stderr, no faster than the eye; a folder's all go to stdout.
    is_silent
        Show nothing on stdout, which is for a JSON document; a camera's still go to stderr.
    """
    if is_live:
        with LiveLine(time.monotonic) as line:
            yield lambda name, verdict: line.show(
                verdict_line(name, verdict), "bold green" if verdict.accepted else "bold red"
            )
    elif is_silent:
        yield lambda name, verdict: None
    else:
        yield lambda name, verdict: say(verdict_line(name, verdict))
