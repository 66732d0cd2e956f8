"""The command line's entry: light, so that Ctrl-C is answered from the first moment on.

The application and the libraries of its command are imported when it runs; that takes seconds.
"""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from standoff.compiled_cache import drop_stale_code

__all__ = ["main", "run"]

EXIT_INTERRUPTED = 130


def main() -> None:
    """Run the command line and exit."""
    arguments = sys.argv[1:]
    try:
        with _no_interrupt_lost():
            drop_stale_code()
            from standoff.application import application, run_application

            app = application(arguments)
        status = run_application(app, arguments)
    except KeyboardInterrupt:
        sys.stderr.write("standoff: interrupted; run the same command again\n")
        status = EXIT_INTERRUPTED
    sys.exit(status)


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit status; errors are one line on stderr."""
    from standoff.application import application, run_application

    return run_application(application(arguments), arguments)


@contextmanager
def _no_interrupt_lost() -> Iterator[None]:
    """Raise a Ctrl-C at the end that something inside has swallowed, as imports may.

    Where Ctrl-C is ignored, as in a shell's background, it stays so.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        yield
        return
    came = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal came
        came = True
        signal.default_int_handler(number, frame)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if came:
        raise KeyboardInterrupt
