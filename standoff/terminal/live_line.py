"""One line on stderr that follows what a camera sees."""

from collections.abc import Callable
from types import TracebackType
from typing import Self

from rich.live import Live
from rich.text import Text

from acquisition.printable import on_one_line
from standoff.terminal.output import ERRORS

_INTERVAL_S = 0.1
_PLAIN_INTERVAL_S = 1.0


class LiveLine:
    """Shows texts on stderr: in place on a terminal, else as one plain line per second.

    Parameters
    ----------
    clock
        Seconds; texts that come faster than the eye can follow are not drawn.
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

    def show(self, text: str, style: str = "") -> None:
        """Draw a text, unless one was drawn a moment ago."""
        text = on_one_line(text)
        now_s = self._clock()
        interval_s = _PLAIN_INTERVAL_S if self._live is None else _INTERVAL_S
        if self._shown_s is not None and now_s - self._shown_s < interval_s:
            return
        self._shown_s = now_s
        if self._live is None:
            ERRORS.print(text, markup=False)
        else:
            self._live.update(Text(text, style=style), refresh=True)
