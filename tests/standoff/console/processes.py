"""Commands of standoff as processes of their own."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

STANDOFF = [sys.executable, "-c", "from standoff.cli import main; main()"]


@contextmanager
def standoff_process(*arguments: object, cwd: Path) -> Iterator[subprocess.Popen[str]]:
    """Run a command until the block ends; what it says on stderr goes to a file."""
    errors = cwd / f"{arguments[0]}.err"
    with (
        errors.open("w") as stderr,
        subprocess.Popen(
            [*STANDOFF, *(str(argument) for argument in arguments)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
            cwd=cwd,
            env=os.environ | {"PYTHONUNBUFFERED": "1"},
        ) as process,
    ):
        try:
            yield process
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(120)
            except subprocess.TimeoutExpired:
                process.kill()


def first_line(process: subprocess.Popen[str]) -> dict[str, str]:
    """The JSON line that a process prints when it is ready."""
    return dict(json.loads(pipe(process.stdout).readline()))


def pipe(stream: IO[str] | None) -> IO[str]:
    assert stream is not None
    return stream
