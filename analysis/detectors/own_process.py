"""A program in a session of its own, which is ended together with what it started."""

import os
import signal
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from threading import Lock, Thread, Timer
from types import TracebackType
from typing import Self

from analysis.detectors.answers import short_line

_TAIL_BYTES = 4096
_CHUNK_BYTES = 1 << 16
_HEARS_S = 1.0
"""For the rest of what an ended program said, if something else holds its pipe."""

_FIRST_LOOK_S, _LATER_LOOK_S = 0.0005, 0.02


class OwnProcess:
    """A program that was started here, alone in its session.

    Ctrl-C in a terminal reaches us, not it; so whoever starts one ends it. As long as it has not
    been waited for, its number is that of no other process and no other group.

    Parameters
    ----------
    words
        Program and arguments.
    stdin, stdout
        File descriptors; without them it reads nothing, and its output is heard as its errors are.
    folder
        Working folder.

    Raises
    ------
    OSError
        If it cannot be started.
    """

    def __init__(
        self,
        words: Sequence[str],
        *,
        stdin: int | None = None,
        stdout: int | None = None,
        folder: str | None = None,
    ) -> None:
        heard, said = os.pipe()
        try:
            self._process = subprocess.Popen(  # noqa: S603 - what the user named, without a shell
                list(words),
                stdin=subprocess.DEVNULL if stdin is None else stdin,
                stdout=said if stdout is None else stdout,
                stderr=said,
                cwd=folder,
                start_new_session=True,
            )
        except BaseException:
            os.close(heard)
            raise
        finally:
            os.close(said)
        self._tail = b""
        self._lock = Lock()
        self._hearing = Thread(target=self._hear, args=(heard,), name="detector", daemon=True)
        self._hearing.start()

    def _hear(self, heard: int) -> None:
        try:
            while chunk := os.read(heard, _CHUNK_BYTES):
                self._tail = (self._tail + chunk)[-_TAIL_BYTES:]
        finally:
            os.close(heard)

    def has_ended(self) -> bool:
        """Whether it has, without waiting for it in the system's sense."""
        if self._process.returncode is not None:
            return True
        if not hasattr(os, "waitid"):  # as on macOS before Python 3.13
            return self._process.poll() is not None
        how = os.WEXITED | os.WNOHANG | os.WNOWAIT
        return os.waitid(os.P_PID, self._process.pid, how) is not None

    def wait(self, timeout_s: float) -> bool:
        """Wait for its end; return whether it ended in time."""
        until_s, look_s = time.monotonic() + timeout_s, _FIRST_LOOK_S
        while not self.has_ended():
            left_s = until_s - time.monotonic()
            if left_s <= 0:
                return False
            time.sleep(min(look_s, left_s))
            look_s = min(2 * look_s, _LATER_LOOK_S)
        return True

    def kill(self) -> None:
        """Kill it and its group; nothing if it has been waited for. For any thread."""
        with self._lock:
            if self._process.returncode is None:
                with suppress(ProcessLookupError, PermissionError):
                    os.killpg(self._process.pid, signal.SIGKILL)

    def end(self) -> int:
        """Kill what is left of its group, and return its exit status; below 0 for a signal."""
        self.kill()
        with self._lock:
            status = self._process.wait()
        self._hearing.join(_HEARS_S)
        return status

    @property
    def last_line(self) -> str:
        """The last line that it said; empty if it said nothing."""
        lines = self._tail.decode(errors="replace").strip().splitlines()
        return short_line(lines[-1]) if lines else ""


def how_it_ended(status: int) -> str:
    """Return an exit status in words."""
    if status >= 0:
        return f"it ended with status {status}"
    with suppress(ValueError):
        return f"it was killed by {signal.Signals(-status).name}"
    return f"it was killed by signal {-status}"


def which_said(line: str) -> str:
    """Return the end of a message about a program that last said ``line``."""
    return f"; it last said: {line}" if line else ""


class Deadline:
    """Kills a process that is not done by a time: whoever waits for its pipes then gets on."""

    def __init__(self, process: OwnProcess, timeout_s: float) -> None:
        self.is_hung = False
        """Whether the time was over and the process still running."""
        self._process = process
        self._timer = Timer(timeout_s, self._over)
        self._timer.daemon = True

    def _over(self) -> None:
        self.is_hung = not self._process.has_ended()
        self._process.kill()

    def __enter__(self) -> Self:
        self._timer.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._timer.cancel()
        self._timer.join()
