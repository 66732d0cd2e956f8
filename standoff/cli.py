"""Entry point of the command line, kept light so that Ctrl-C works from the start.

The application and the libraries of its command are imported when it runs; that takes seconds.
"""

import gc
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from standoff.shadowing import HiddenPackageError, refuse_hidden_packages
from standoff.terminal import drop_stale_code, when_compiling

EXIT_REPORTED = 1
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143

# The imports alone make hundreds of thousands of objects that stay; looking for cycles among them
# at every 700th, as is the default, takes a tenth of the time of a calibration.
_OBJECTS_A_COLLECTION = 10_000


def main() -> None:
    """Run the command line and exit."""
    gc.set_threshold(_OBJECTS_A_COLLECTION)
    # Read when NumPy is imported. Sums of several threads differ in their last bits from those of
    # one, which workers have: without this, results would depend on the number of cores.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(_interrupted_by_termination(lambda: _imported_and_run(sys.argv[1:])))


def _imported_and_run(arguments: list[str]) -> int:
    try:
        with _no_interrupt_lost():
            refuse_hidden_packages()
            drop_stale_code()
            when_compiling(_note_once())
            from standoff.terminal import application, run_application

            app = application(arguments)
        return run_application(app, arguments)
    except HiddenPackageError as error:
        sys.stderr.write(f"standoff: {error}\n")
        return EXIT_REPORTED
    except KeyboardInterrupt:
        sys.stderr.write("standoff: interrupted; run the same command again\n")
        return EXIT_INTERRUPTED


def _note_once() -> Callable[[str], None]:
    """Says in one line, at the first function of many, why nothing happens for a while."""
    is_said = False

    def say(_function: str) -> None:
        nonlocal is_said
        if not is_said:
            is_said = True
            from standoff.terminal import note_in_passing

            note_in_passing("compiling the numerical code, once: a minute or two")

    return say


def _interrupted_by_termination(work: Callable[[], int]) -> int:
    """Do the work; SIGTERM ends it like Ctrl-C: the stage stops and files stay whole.

    A second SIGTERM ends the process at once.
    """
    came = False

    def interrupt(number: int, _frame: FrameType | None) -> None:
        nonlocal came
        came = True
        signal.signal(number, signal.SIG_DFL)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        status = work()
    finally:
        signal.signal(signal.SIGTERM, before)
    return EXIT_TERMINATED if came and status == EXIT_INTERRUPTED else status


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit status; errors are one line on stderr."""
    from standoff.terminal import application, run_application

    return run_application(application(arguments), arguments)


@contextmanager
def _no_interrupt_lost() -> Iterator[None]:
    """Raise at the end a Ctrl-C that the block swallowed, as imports may.

    If Ctrl-C is ignored, as in a background job of a shell, it stays ignored.
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
