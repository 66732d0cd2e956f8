"""The command at work: its command line for the provenance, and remarks for its end."""

import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

from acquisition.printable import on_one_line
from standoff.library import called_as
from standoff.terminal.output import NOTED, note


@dataclass(frozen=True, slots=True)
class _Invocation:
    arguments: tuple[str, ...] = ()
    remarks: list[str] = field(default_factory=list)


_SHARED_OUT = {"--workers", "--scheduler", "--shard"}
_TOLD = {"--json", "--strict", "--force"}

_CURRENT: ContextVar[_Invocation | None] = ContextVar("_CURRENT", default=None)


@contextmanager
def invocation(arguments: Sequence[str]) -> Iterator[None]:
    """Remember a command while it runs; its remarks are printed unless it ends with an error."""
    current = _Invocation(tuple(arguments))
    token, noted = _CURRENT.set(current), NOTED.set([])
    try:
        with called_as(command_line()):
            yield
    finally:
        _CURRENT.reset(token)
        NOTED.reset(noted)
    for remark in current.remarks:
        note(remark)


def command_line() -> str:
    """Return the command that runs, quoted for a POSIX shell."""
    current = _CURRENT.get()
    return shlex.join(("standoff", *(current.arguments if current else ())))


def is_same_command(line: str) -> bool:
    """Whether a command line of before asks for what the command that runs does.

    How the work is shared out and told does not count.
    """
    return _asked(line) == _asked(command_line())


def _asked(line: str) -> list[str]:
    asked, words = [], iter(shlex.split(line))
    for word in words:
        if word in _SHARED_OUT:
            next(words, None)
        elif word not in _TOLD and word.partition("=")[0] not in _SHARED_OUT:
            asked.append(word)
    return asked


def note_at_end(text: str) -> None:
    """Print a remark on stderr once the command is done: an error remains the only line."""
    current = _CURRENT.get()
    if current is None:
        note(text)
    else:
        current.remarks.append(text)


def remarks_so_far() -> tuple[str, ...]:
    """Return what the command has noted, and what it will note at its end, once each."""
    current = _CURRENT.get()
    at_end = [] if current is None else [on_one_line(text) for text in current.remarks]
    return tuple(dict.fromkeys([*(NOTED.get() or []), *at_end]))
