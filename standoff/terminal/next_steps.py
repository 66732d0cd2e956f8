"""What to try next: command lines that work as they are printed."""

import shlex
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from standoff.terminal.output import say


def print_next_steps(steps: Sequence[tuple[str, str]]) -> None:
    """Print what each command is for, and the command that a POSIX shell takes from here."""
    say("", "What to try next, as it stands:")
    for purpose, command in steps:
        say("", f"  # {purpose}", f"  {command}")


def command_line(*words: str | int | Path) -> str:
    """Return a command of standoff as this shell starts it: by its name where the PATH has it."""
    return shlex.join((*_program(), *map(str, words)))


def _program() -> tuple[str, ...]:
    started = Path(sys.argv[0])
    if started.name != "standoff":  # python -m standoff
        return (sys.executable, "-m", "standoff")
    on_path = shutil.which("standoff")
    if on_path is not None and Path(on_path).resolve() == started.resolve():
        return ("standoff",)
    return (str(started),)
