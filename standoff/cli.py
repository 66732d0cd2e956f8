"""The command line's entry: light, so that Ctrl-C is answered from the first moment on.

The application itself, with all its libraries, is imported when it runs; that takes seconds.
"""

import sys

from standoff.compiled_cache import drop_stale_code

__all__ = ["main", "run"]

EXIT_INTERRUPTED = 130


def main() -> None:
    """Run the command line and exit."""
    try:
        drop_stale_code()
        status = run(sys.argv[1:])
    except KeyboardInterrupt:
        sys.stderr.write("standoff: interrupted; run the same command again\n")
        status = EXIT_INTERRUPTED
    sys.exit(status)


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit status; errors are one line on stderr."""
    from standoff.application import run as run_application

    return run_application(arguments)
