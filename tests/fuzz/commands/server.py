"""Commands in a process each, within limits, without loading the libraries each time.

``python -m tests.fuzz.commands.server`` reads a request in JSON from each line and answers with
one. It forks for every command, so that one that hangs, eats memory or crashes harms nothing.
"""

import gc
import json
import os
import re
import resource
import signal
import subprocess
import sys
import traceback
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from tempfile import TemporaryFile
from typing import Any
from unittest.mock import patch

MOST_CPU_S = 60
"""Processor time at which a command is killed that never ends."""

HANGS_AFTER_S = 600
"""Clock time at which one is killed that waits; a busy machine stretches what takes seconds."""

ROOT = Path(__file__).parents[3]
ADDRESS_SPACE_BYTES = 6 << 30
CRASHED = 70
"""Exit status of a command that ended in a traceback."""


_NOT_LOADED = {"console", "aravis", "__main__", "kernelgan", "worker_process", "hil_mocks"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    """How a command ended: its status (negative: a signal), both streams, and what it took.

    ``peak_bytes`` is the memory beyond what the process that it is forked from holds without files.
    """

    status: int
    out: str
    err: str
    cpu_s: float
    peak_bytes: int


class CommandServer:
    """The process that runs commands, seen from outside."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1", "COLUMNS": "200"},
        )

    def run(self, arguments: list[str], folder: Path) -> Ended:
        """Run a command in a folder."""
        return Ended(**self._ask({"run": arguments, "folder": str(folder)}))

    def rehearse(self, arguments: list[str], folder: Path) -> None:
        """Run a sound command in the process that forks.

        What is loaded or compiled when it is first needed is then there for all that follow.
        """
        status = self._ask({"rehearse": arguments, "folder": str(folder)})
        if status != 0:
            raise RuntimeError(f"{arguments} ended with status {status}")

    def _ask(self, request: dict[str, Any]) -> Any:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        return json.loads(self._process.stdout.readline())

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


def serve() -> None:
    """Answer requests until there are no more."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    _load_everything()
    for line in sys.stdin:
        request = json.loads(line)
        if "rehearse" in request:
            answer: object = _in_this_process(request["rehearse"], request["folder"])
        else:
            answer = asdict(_in_a_child(request["run"], request["folder"]))
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def load_modules(others: tuple[str, ...] = ()) -> None:
    """Import every module of ours, and with them the libraries, but not what serves or drives.

    ``others`` are packages, or parts of names, that are loaded as well.
    """
    packages = ("acquisition", "calibration", "simulation", "analysis", "standoff", "hil_mocks")
    left_out = _NOT_LOADED.difference(others)
    for package in packages:
        for module in walk_packages([package], f"{package}."):
            if not any(part in left_out for part in module.name.split(".")):
                import_module(module.name)


def _load_everything() -> None:
    load_modules()
    # Most of the time that figures take goes into their pixels, which nobody looks at here.
    patch("analysis.reports._page._PNG_DPI", 20).start()
    gc.collect()
    gc.freeze()


def _in_this_process(arguments: list[str], folder: str) -> int:
    streams, silence = (os.dup(1), os.dup(2)), os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    os.chdir(folder)
    try:
        return _status_of(arguments)
    finally:
        os.chdir(ROOT)
        for number, stream in enumerate(streams, start=1):
            os.dup2(stream, number)
            os.close(stream)
        os.close(silence)
        gc.collect()
        gc.freeze()


def _in_a_child(arguments: list[str], folder: str) -> Ended:
    with TemporaryFile() as out, TemporaryFile() as err:
        held_bytes = _own_bytes()
        child = os.fork()
        if child == 0:
            os.chdir(folder)
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            os.dup2(out.fileno(), 1)
            os.dup2(err.fileno(), 2)
            resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE_BYTES, ADDRESS_SPACE_BYTES))
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            resource.setrlimit(resource.RLIMIT_CPU, (MOST_CPU_S, MOST_CPU_S))
            signal.setitimer(signal.ITIMER_REAL, HANGS_AFTER_S)
            status = _status_of(arguments)
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
        _, ended, used = os.wait4(child, 0)
        texts = [_text(stream.fileno()) for stream in (out, err)]
    return Ended(
        status=os.waitstatus_to_exitcode(ended),
        out=texts[0],
        err=texts[1],
        cpu_s=used.ru_utime + used.ru_stime,
        peak_bytes=(used.ru_maxrss << 10) - held_bytes,
    )


def _own_bytes() -> int:
    """Memory of this process without files, which one that it forks begins with."""
    status = Path("/proc/self/status").read_text("utf-8")
    [kibibytes] = re.findall(r"^RssAnon:\s+(\d+) kB$", status, re.MULTILINE)
    return int(kibibytes) << 10


def _text(descriptor: int) -> str:
    os.lseek(descriptor, 0, os.SEEK_SET)
    with os.fdopen(os.dup(descriptor), "rb") as stream:
        return stream.read().decode("utf-8", "replace")


def _status_of(arguments: list[str]) -> int:
    from standoff.cli import run

    try:
        return run(arguments)
    except BaseException:  # noqa: BLE001 - whatever it is, it is what was searched for
        traceback.print_exc()
        return CRASHED


if __name__ == "__main__":
    serve()
