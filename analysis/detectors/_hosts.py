"""Detectors in processes of their own: functions and ONNX files in children, and commands."""

import fcntl
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Lock, Thread, Timer
from types import TracebackType
from typing import Any, Self

import numpy as np

from acquisition.photographs import tiff_bytes
from acquisition.regular_files import read_regular_file
from acquisition.untrusted import TiffDamageError, parse_json, read_tiff
from analysis.detectors._spec import PLACEHOLDERS, DetectorSpec, command_words
from analysis.detectors.answers import plain_answer, short_line
from analysis.errors import DetectorError
from calibration.files import write_homography
from calibration.registration import Homography
from simulation.arrays import Float32Array, FloatArray

_TAIL_BYTES = 4096
_CHUNK_BYTES = 1 << 16
_HEARS_S = 1.0
"""For the rest of what an ended program said, if something else holds its pipe."""

_FIRST_LOOK_S, _LATER_LOOK_S = 0.0005, 0.02


class _OwnProcess:
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
        self._tail = b""
        self._lock = Lock()
        heard, said = os.pipe()
        self._hearing = Thread(target=self._hear, args=(heard,), name="detector", daemon=True)
        started: subprocess.Popen[bytes] | None = None
        try:
            started = subprocess.Popen(  # noqa: S603 - what the user named, without a shell
                list(words),
                stdin=subprocess.DEVNULL if stdin is None else stdin,
                stdout=said if stdout is None else stdout,
                stderr=said,
                cwd=folder,
                start_new_session=True,
            )
            self._process = started
            self._hearing.start()
        except BaseException:
            # Ctrl-C while the process is up and nobody has it yet: it would go on by itself.
            if started is not None:
                self._process = started
                self.kill()
                started.wait()
            if self._hearing.ident is None:
                os.close(heard)
            raise
        finally:
            os.close(said)

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


def _how_it_ended(status: int) -> str:
    """Return an exit status in words."""
    if status >= 0:
        return f"it ended with status {status}"
    with suppress(ValueError):
        return f"it was killed by {signal.Signals(-status).name}"
    return f"it was killed by signal {-status}"


def _which_said(line: str) -> str:
    """Return the end of a message about a program that last said ``line``."""
    return f"; it last said: {line}" if line else ""


class _Deadline:
    """Kills a process that is not done by a time: whoever waits for its pipes then gets on."""

    def __init__(self, process: _OwnProcess, timeout_s: float) -> None:
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


WORKER = Path(__file__).with_name("_child_worker.py")

_STARTS_WITHIN_S = 120.0
"""For the imports of a detector: PyTorch takes 10 s on a cold disk."""

_ENDS_WITHIN_S = 2.0
_PIPE_BYTES = 1 << 20  # what Linux allows everybody


class ChildHost:
    """Asks a detector in one long-lived process, and in a new one after any failure.

    Parameters
    ----------
    spec
        A function or an ONNX file.
    timeout_s
        For an answer.
    """

    def __init__(self, spec: DetectorSpec, timeout_s: float) -> None:
        self._spec = spec
        self._timeout_s = timeout_s
        self._child: _Child | None = None
        self._takes_colour = False

    @property
    def takes_colour(self) -> bool:
        """Whether the detector said so when it was loaded."""
        return self._takes_colour

    def start(self) -> None:
        """Start the process and load the detector, if it is not there.

        Raises
        ------
        DetectorError
            If it cannot be loaded; the message lacks the detector's name, here and below.
        """
        if self._child is not None:
            return
        self._child = _Child(self._spec.folder)
        told = {
            "sys_path": sys.path,
            "folder": self._spec.folder,
            "kind": self._spec.kind,
            "target": self._spec.text,
        }
        self._takes_colour = bool(
            self._exchange([json.dumps(told).encode()], None, _STARTS_WITHIN_S)
        )

    def answer(
        self, reference: Float32Array, followup: Float32Array, homography: FloatArray
    ) -> float | Float32Array:
        """Return what the detector says.

        Raises
        ------
        DetectorError
            If it fails; the next call finds a new process.
        """
        self.start()
        header = {
            "reference": reference.shape,
            "followup": followup.shape,
            "homography": homography.tolist(),
        }
        parts = [json.dumps(header).encode(), _bytes_of(reference), _bytes_of(followup)]
        return self._exchange(parts, followup.shape[:2], self._timeout_s)

    def renew(self) -> None:
        """End the process; the next call finds a new one."""
        child, self._child = self._child, None
        if child is not None:
            child.kill()

    def close(self) -> None:
        """End the process: by itself if it is idle, so that it can clean up."""
        child, self._child = self._child, None
        if child is not None:
            child.ended()

    def _exchange(
        self, parts: list[Any], shape: tuple[int, ...] | None, timeout_s: float
    ) -> float | Float32Array:
        child = self._child
        assert child is not None
        deadline = _Deadline(child.process, timeout_s)
        try:
            with deadline:
                found = child.asked(parts, shape)
            if not deadline.is_hung:
                return found
        except (EOFError, OSError) as error:
            self._child = None
            # Its pipe is closed before its status is there.
            status = child.ended()
            if not deadline.is_hung:
                raise DetectorError(
                    _how_it_ended(status) + _which_said(child.process.last_line), reason="crashed"
                ) from error
        except BaseException:
            self.renew()
            raise
        self.renew()
        failed = "was not loaded" if shape is None else "gave no answer"
        raise DetectorError(
            f"it {failed} within {timeout_s:g} s" + _which_said(child.process.last_line),
            reason="hung",
        )


class _Child:
    """The process and the pipes to it."""

    def __init__(self, folder: str) -> None:
        read_request, write_request = os.pipe()
        read_answer, write_answer = os.pipe()
        self._requests = Connection(write_request, readable=False)
        self._answers = Connection(read_answer, writable=False)
        try:
            for pipe in (write_request, read_answer):
                # Photographs go through in one piece.
                with suppress(OSError, AttributeError):
                    fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
            # -P: a module here must not hide one of those that the child imports.
            self.process = _OwnProcess(
                [sys.executable, "-P", str(WORKER)],
                stdin=read_request,
                stdout=write_answer,
                folder=folder,
            )
        except BaseException:
            self._hang_up()
            raise
        finally:
            os.close(read_request)
            os.close(write_answer)

    def asked(self, parts: list[Any], shape: tuple[int, ...] | None) -> float | Float32Array:
        """Send a request and return the answer; of one that is loaded whether it takes colours."""
        for part in parts:
            self._requests.send_bytes(part)
        header = json.loads(self._answers.recv_bytes())
        if "fault" in header:
            raise DetectorError(header["line"], reason=header["fault"])
        if "map" not in header:
            return float(header.get("score", header.get("colour", False)))
        found = tuple(header["map"])
        if found != shape:
            raise DetectorError(unlike_the_followup(found, shape or ()), reason="shape")
        answer = np.empty(found, dtype=np.float32)
        self._answers.recv_bytes_into(answer.data.cast("B"))
        return answer

    def ended(self) -> int:
        """Hang up, give it time to end by itself, and return its status."""
        self._hang_up()
        try:
            self.process.wait(_ENDS_WITHIN_S)
        finally:
            status = self.process.end()
        return status

    def kill(self) -> None:
        self._hang_up()
        self.process.end()

    def _hang_up(self) -> None:
        self._requests.close()
        self._answers.close()


def unlike_the_followup(found: tuple[int, ...], shape: tuple[int, ...]) -> str:
    """Return that a map has another shape than the follow-up."""
    texts = (" x ".join(map(str, one)) for one in (found, shape))
    return "its map has {} values and the follow-up {} px; return one per pixel".format(*texts)


def _bytes_of(image: Float32Array) -> memoryview:
    return np.ascontiguousarray(image).data.cast("B")


_PLACEHOLDER = re.compile("|".join(map(re.escape, PLACEHOLDERS)))
_TIFF_MAGIC = (b"II", b"MM")


class CommandHost:
    """Runs a command for every pair, without a shell, in the folder where it was named.

    Its files lie in a temporary folder of their own: both photographs as float32 TIFF, the
    homography as an H.json, and ``{out}``, which ends in ``.tif`` and may also hold a JSON number.

    Parameters
    ----------
    spec
        A command line.
    timeout_s
        For each run; then the command and the processes of its group are killed.
    """

    def __init__(self, spec: DetectorSpec, timeout_s: float) -> None:
        self._words = command_words(spec.text)
        self._folder = spec.folder
        self._timeout_s = timeout_s

    @property
    def takes_colour(self) -> bool:
        """False: nothing says it of a command."""
        return False

    def start(self) -> None:
        """Do nothing: each pair has its own process."""

    def renew(self) -> None:
        """Do nothing, either."""

    def close(self) -> None:
        """Do nothing: everything has ended with its pair."""

    def answer(
        self, reference: Float32Array, followup: Float32Array, homography: FloatArray
    ) -> float | Float32Array:
        """Return what the command says.

        Raises
        ------
        DetectorError
            If it fails; the message lacks the detector's name.
        """
        with tempfile.TemporaryDirectory(
            prefix="standoff-detector-", ignore_cleanup_errors=True
        ) as name:
            folder = Path(name)
            files = {
                "{reference}": folder / "reference.tif",
                "{followup}": folder / "followup.tif",
                "{homography}": folder / "homography.json",
                "{out}": folder / "out.tif",
            }
            for mark, image in (("{reference}", reference), ("{followup}", followup)):
                files[mark].write_bytes(tiff_bytes(image, f"standoff evaluate: {mark[1:-1]}"))
            size = followup.shape[1], followup.shape[0]
            write_homography(files["{homography}"], Homography(matrix=homography, size=size))
            words = [
                _PLACEHOLDER.sub(lambda found: str(files[found[0]]), word) for word in self._words
            ]
            said = self._run(words)
            return _read_answer(files["{out}"], said)

    def _run(self, words: list[str]) -> str:
        """Run the command and return the last line that it said."""
        try:
            process = _OwnProcess(words, folder=self._folder)
        except OSError as error:
            raise DetectorError(
                f"{short_line(words[0])} cannot be run: {error.strerror}; check its path, and that "
                "it is executable",
                reason="missing",
            ) from error
        try:
            is_done = process.wait(self._timeout_s)
        finally:
            status = process.end()
        said = process.last_line
        if not is_done:
            raise DetectorError(
                f"it was not done within {self._timeout_s:g} s" + _which_said(said), reason="hung"
            )
        if status != 0:
            raise DetectorError(_how_it_ended(status) + _which_said(said), reason="crashed")
        return said


def _read_answer(path: Path, said: str) -> float | Float32Array:
    try:
        data = read_regular_file(path)
    except FileNotFoundError as error:
        raise DetectorError(
            "it wrote nothing to {out}" + _which_said(said), reason="output"
        ) from error
    except OSError as error:
        raise DetectorError(
            f"{{out}} cannot be read: {error.strerror}" + _which_said(said), reason="output"
        ) from error
    if data.startswith(_TIFF_MAGIC):
        try:
            return plain_answer(np.asarray(read_tiff(data, first_alone=True).images[0]))
        except TiffDamageError as error:
            raise DetectorError(
                f"the TIFF in {{out}} is damaged: {error}", reason="output"
            ) from error
    try:
        number = parse_json(data)
    except ValueError as error:
        raise DetectorError(
            "{out} holds neither a TIFF nor a JSON number" + _which_said(said), reason="output"
        ) from error
    if isinstance(number, bool) or not isinstance(number, int | float):
        raise DetectorError(
            f"the JSON in {{out}} is a {type(number).__name__}; expected a number", reason="output"
        )
    return plain_answer(number)
