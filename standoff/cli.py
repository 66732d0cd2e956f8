"""Entry point of the command line, kept light so that Ctrl-C works from the start.

The application and the libraries of its command are imported when it runs; that takes seconds.
"""

import gc
import os
import sys
from pathlib import Path

from standoff.compile_notice import announce_compiling
from standoff.compiled_cache import drop_stale_code, provide_folder, user_cache
from standoff.interrupts import interruption
from standoff.shadowing import HiddenPackageError, refuse_hidden_packages
from standoff.streams import flush_output, open_streams

EXIT_REPORTED = 1
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143

# The imports alone make hundreds of thousands of objects that stay; looking for cycles among them
# at every 700th, as is the default, takes a tenth of the time of a calibration.
_OBJECTS_A_COLLECTION = 10_000


def main() -> None:
    """Run the command line and exit."""
    open_streams()
    with interruption() as interrupted:
        status = _imported_and_run(sys.argv[1:])
        fault = flush_output()
    if fault is not None:
        sys.stderr.write(f"standoff: {fault}\n" if fault else "")
        status = status or EXIT_REPORTED
    # What is left is freed by the system at once, not object by object for a third of a second.
    gc.freeze()
    ended = interrupted.terminated and status == EXIT_INTERRUPTED
    sys.exit(EXIT_TERMINATED if ended else status)


def _imported_and_run(arguments: list[str]) -> int:
    try:
        gc.set_threshold(_OBJECTS_A_COLLECTION)
        # Read when NumPy is imported. Sums of several threads differ in their last bits from those
        # of one, which workers have: without this, results would depend on the number of cores.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        # Pydantic would look through all installed packages for plugins, of which we have none.
        os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "true")
        refuse_hidden_packages()
        drop_stale_code()
        provide_folder(Path(__file__).parents[1] / "calibration" / "edges", user_cache())
        announce_compiling(_tell_of_compiling)
        return run(arguments)
    except HiddenPackageError as error:
        sys.stderr.write(f"standoff: {error}\n")
        return EXIT_REPORTED
    except KeyboardInterrupt:
        sys.stderr.write("standoff: interrupted; run the same command again\n")
        return EXIT_INTERRUPTED


def _tell_of_compiling(sentence: str) -> None:
    from standoff.terminal import note_in_passing

    note_in_passing(sentence)


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit status; errors are one line on stderr."""
    from standoff.terminal import application, run_application

    return run_application(application(arguments), arguments)
