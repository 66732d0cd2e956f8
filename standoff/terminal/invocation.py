"""The command at work: its command line, for the provenance and to know it again."""

import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

from standoff.library import called_as
from standoff.terminal.output import NOTED

_SHARED_OUT = {"--workers", "--scheduler", "--shard"}
_TOLD = {"--json", "--strict", "--force"}

_ARGUMENTS: ContextVar[tuple[str, ...]] = ContextVar("_ARGUMENTS", default=())


@contextmanager
def invocation(arguments: Sequence[str]) -> Iterator[None]:
    """Remember a command, and what it has noted, while it runs."""
    token, noted = _ARGUMENTS.set(tuple(arguments)), NOTED.set([])
    try:
        with called_as(_command_line()):
            yield
    finally:
        _ARGUMENTS.reset(token)
        NOTED.reset(noted)


def _command_line() -> str:
    """Return the command that runs, quoted for a POSIX shell."""
    return shlex.join(("standoff", *_ARGUMENTS.get()))


def is_same_command(line: str | None) -> bool:
    """Whether a command line of before, if there is one, asks for what the command that runs does.

    How the work is shared out and told does not count.
    """
    return line is not None and _asked(line) == _asked(_command_line())


def _asked(line: str) -> list[str]:
    asked, words = [], iter(shlex.split(line))
    for word in words:
        if word in _SHARED_OUT:
            next(words, None)
        elif word not in _TOLD and word.partition("=")[0] not in _SHARED_OUT:
            asked.append(word)
    return asked
