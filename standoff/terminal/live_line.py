"""One line on stderr that follows what a camera sees: the focus value, and verdicts on its pose."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from rich.live import Live
from rich.text import Text

from acquisition.focus import FocusReading
from acquisition.printable import on_one_line
from analysis.pose import PoseVerdict
from standoff.terminal.output import ERRORS, say

_INTERVAL_S = 0.1
_PLAIN_INTERVAL_S = 1.0
_BAR_CELLS = 30
_ARROWS = {"rising": "↑ rising ", "steady": "→ steady ", "falling": "↓ falling"}


class LiveLine(ExitStack):
    """Shows texts on stderr: in place on a terminal, else as one plain line per second."""

    def __init__(self) -> None:
        super().__init__()
        self._shown_s: float | None = None
        self._live = Live(console=ERRORS, auto_refresh=False) if ERRORS.is_terminal else None

    def show(self, text: str, style: str = "", *, now_s: float) -> None:
        """Draw a text, unless one was drawn a moment before: faster than the eye can follow."""
        text = on_one_line(text)
        interval_s = _PLAIN_INTERVAL_S if self._live is None else _INTERVAL_S
        if self._shown_s is not None and now_s - self._shown_s < interval_s:
            return
        if self._live is not None and self._shown_s is None:
            self.enter_context(self._live)
        self._shown_s = now_s
        if self._live is None:
            ERRORS.print(text, markup=False)
        else:
            self._live.update(Text(text, style=style), refresh=True)


@contextmanager
def focus_display() -> Iterator[Callable[[FocusReading, float], None]]:
    """Yield a callback that shows a reading of the focus aid, given that and its time in s."""
    with LiveLine() as line:
        yield lambda reading, now_s: line.show(
            _reading_text(reading), "yellow" if reading.is_past_peak else "", now_s=now_s
        )


def _reading_text(reading: FocusReading) -> str:
    """Value, bar, trend, share of the peak and the peak, as one line of text."""
    if not reading.has_detail:
        return f"focus {'–':>10} nothing to focus on"
    share = reading.percent_of_peak
    filled = round(_BAR_CELLS * min(max(share, 0.0), 100.0) / 100.0)
    bar = "█" * filled + "·" * (_BAR_CELLS - filled)
    hint = "   past the peak: go back" if reading.is_past_peak else ""
    return (
        f"focus {reading.value:10.5g} {bar} {share:5.1f} % of peak {reading.peak:.5g}  "
        f"{_ARROWS[reading.trend]}{hint}"
    )


_VERDICT_STYLES = {"go": "bold green", "no go": "bold red", "unsure": "bold yellow"}


def verdict_line(name: str, verdict: PoseVerdict) -> str:
    """One line for the operator: verdict, margin and reason."""
    word = "accept" if verdict.accepted else "reject" if verdict.dprime is not None else "lost"
    if verdict.verdict == "unsure":
        word = "unsure"
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
        with LiveLine() as line:
            yield lambda name, verdict: line.show(
                verdict_line(name, verdict),
                _VERDICT_STYLES[verdict.verdict],
                now_s=time.monotonic(),
            )
    elif is_silent:
        yield lambda name, verdict: None
    else:
        yield lambda name, verdict: say(verdict_line(name, verdict))
