"""A ``standoff`` command in a process of its own: its progress, its result, and its end."""

import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from threading import Thread
from typing import IO, Any

from acquisition.errors import OperatorStopError
from acquisition.printable import on_one_line
from acquisition.untrusted import parse_json
from standoff.errors import ApplicationError
from standoff.terminal import PROGRESS_VARIABLE

NICENESS = 10
"""Below the console's own: the live picture and STOP come first."""

CHECK_S = 0.1
INTERRUPTED_S, TERMINATED_S = 5.0, 2.0
"""How long a process may take to end after SIGINT, and after SIGTERM."""

MAX_JSON_BYTES = 50 * 10**6
REMARKS = 20
_PROGRESS = re.compile(r"(?P<what>.+): (?P<done>\d+) of (?P<total>\d+) after \d+ s")
_ERROR = "standoff: "


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandProgress:
    """What a command is doing; ``total`` is 0 while it does not say how much there is to do."""

    text: str
    done: int = 0
    total: int = 0


@dataclass(slots=True)
class _Said:
    """What a command wrote on stderr: its remarks, and why it failed."""

    tell: Callable[[CommandProgress], None]
    remarks: list[str] = field(default_factory=list)
    fault: str = ""

    def hear(self, lines: IO[str]) -> None:
        for line in lines:
            text = on_one_line(line.strip())
            found = _PROGRESS.fullmatch(text)
            if found is not None:
                done, total = int(found["done"]), int(found["total"])
                self.tell(CommandProgress(text=found["what"], done=done, total=total))
            elif text.startswith(_ERROR):
                self.fault = text.removeprefix(_ERROR)
            elif text.startswith("note: compiling"):
                self.tell(CommandProgress(text=text.removeprefix("note: ")))
            elif text.startswith("note: ") and len(self.remarks) < REMARKS:
                self.remarks.append(text.removeprefix("note: "))
            elif text:
                self.fault = self.fault or text


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandResult:
    """The JSON document that a command printed, and its remarks."""

    document: Any
    remarks: tuple[str, ...]


def run_command(
    words: Sequence[str],
    *,
    check: Callable[[], None],
    tell: Callable[[CommandProgress], None] = lambda _: None,
) -> CommandResult:
    """Run ``standoff`` with these words and ``--json``, at low priority, until it ends.

    Parameters
    ----------
    words
        Name of the command and its arguments, without ``--json``.
    check
        Called ten times a second; what it raises ends the process, as Ctrl-C does.
    tell
        Called with the command's progress, in another thread.

    Raises
    ------
    ApplicationError
        If the command fails, with its own reason in one line.
    OperatorStopError
        If it was interrupted; and whatever ``check`` raises.
    """
    said = _Said(tell)
    with tempfile.TemporaryFile() as out:
        process = subprocess.Popen(  # noqa: S603 - our own command, without a shell
            [sys.executable, "-m", "standoff", words[0], "--json", *words[1:]],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            env=os.environ | {PROGRESS_VARIABLE: "1", "NO_COLOR": "1"},
            start_new_session=True,  # Ctrl-C in the console's terminal ends the console in order
        )
        with suppress(OSError):  # it has ended already
            os.setpriority(os.PRIO_PROCESS, process.pid, NICENESS)
        assert process.stderr is not None
        hearing = Thread(target=said.hear, args=(process.stderr,), name="stderr", daemon=True)
        hearing.start()
        try:
            status = _waited(process, check)
        finally:
            _end(process)
            hearing.join(TERMINATED_S)  # what it started may still hold the pipe
            process.stderr.close()
        if status in (130, -signal.SIGINT):
            raise OperatorStopError("interrupted")
        if status != 0:
            raise ApplicationError(said.fault or f"standoff {words[0]} ended with status {status}")
        out.seek(0)
        return CommandResult(document=_document(out), remarks=tuple(said.remarks))


def _waited(process: subprocess.Popen[str], check: Callable[[], None]) -> int:
    while True:
        check()
        with suppress(subprocess.TimeoutExpired):
            return process.wait(CHECK_S)


def _end(process: subprocess.Popen[str]) -> None:
    """End a process that still runs, and whatever it started."""
    for number, patience_s in ((signal.SIGINT, INTERRUPTED_S), (signal.SIGTERM, TERMINATED_S)):
        if process.poll() is not None:
            return
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with suppress(subprocess.TimeoutExpired):
            process.wait(patience_s)
    if process.poll() is None:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _document(out: IO[bytes]) -> object:
    data = out.read(MAX_JSON_BYTES + 1)
    if len(data) > MAX_JSON_BYTES:
        return None
    try:
        return parse_json(data)
    except ValueError:
        return None
