"""The command line at work, as the provenance of its results states it."""

import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

_ARGUMENTS: ContextVar[tuple[str, ...]] = ContextVar("_ARGUMENTS", default=())


@contextmanager
def remembered(arguments: Sequence[str]) -> Iterator[None]:
    """Remember the arguments of a command while it runs."""
    token = _ARGUMENTS.set(tuple(arguments))
    try:
        yield
    finally:
        _ARGUMENTS.reset(token)


def command_line() -> str:
    """Return the command that runs, quoted for a POSIX shell."""
    return shlex.join(("standoff", *_ARGUMENTS.get()))
