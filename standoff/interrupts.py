"""Ctrl-C and SIGTERM end a command; one that comes in an import waits for its end, 2 s at most.

What is raised inside an import may be swallowed there, or come out as another error: a class that
is being made turns it into a RuntimeError. So it is raised as soon as the import has ended.
"""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

WAITS_AT_MOST_S = 2.0
"""After this time it is raised inside the import, where it may be lost: whoever pressed Ctrl-C
wants to get on, and can press it again."""

_LOOKS_EVERY_S = 0.02
_IMPORTING = "<frozen importlib._bootstrap"


class Interruption:
    """Raises KeyboardInterrupt for a signal, outside of imports."""

    def __init__(self) -> None:
        self.terminated = False
        """Whether SIGTERM was the cause."""
        self._since_s: float | None = None
        self._waiting = signal.SIGINT

    def note(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal; from the second SIGTERM on it ends the process at once."""
        if _importing(frame) and not self._waited_enough():
            self._waiting = signal.Signals(number)
            signal.setitimer(signal.ITIMER_REAL, _LOOKS_EVERY_S)
            return
        self._since_s = None
        if number == signal.SIGTERM:
            self.terminated = True
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
        raise KeyboardInterrupt

    def note_again(self, _number: int, _frame: FrameType | None) -> None:
        """Give the signal that waits to whatever handles it by now."""
        signal.raise_signal(self._waiting)

    def _waited_enough(self) -> bool:
        now_s = time.monotonic()
        if self._since_s is None:
            self._since_s = now_s
        return now_s - self._since_s > WAITS_AT_MOST_S


@contextmanager
def interruption() -> Iterator[Interruption]:
    """Raise KeyboardInterrupt in the block for Ctrl-C and SIGTERM; for the main thread.

    If Ctrl-C is ignored, as in a background job of a shell, it stays ignored.
    """
    handled = Interruption()
    kept = {signal.SIGALRM: signal.signal(signal.SIGALRM, handled.note_again)}
    kept[signal.SIGTERM] = signal.signal(signal.SIGTERM, handled.note)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        kept[signal.SIGINT] = signal.signal(signal.SIGINT, handled.note)
    try:
        yield handled
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in kept.items():
            signal.signal(number, handler)


def _importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith(_IMPORTING):
            return True
        frame = frame.f_back
    return False
