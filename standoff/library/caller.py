"""Who calls the library, as provenance names it: a command line, or the function itself."""

import getpass
import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_COMMAND_LINE: ContextVar[str | None] = ContextVar("_COMMAND_LINE", default=None)


@contextmanager
def called_as(command_line: str) -> Iterator[None]:
    """Name a command line in the provenance of what the block makes."""
    token = _COMMAND_LINE.set(command_line)
    try:
        yield
    finally:
        _COMMAND_LINE.reset(token)


def caller(function: str) -> str:
    """Return the command line that runs; for a script, the name of the public function."""
    return _COMMAND_LINE.get() or f"standoff.{function}"


def login_name() -> str:
    """The login name of the user, or the user's number if the system knows no name for it."""
    try:
        return getpass.getuser()
    except (ImportError, KeyError, OSError):
        return f"user {os.getuid()}" if hasattr(os, "getuid") else "unknown"
