"""A function or a network in a process of its own: the parent's side."""

import fcntl
import json
import os
import sys
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from analysis.detectors.own_process import Deadline, OwnProcess, how_it_ended, which_said
from analysis.detectors.spec import DetectorSpec
from analysis.errors import DetectorError
from simulation.arrays import Float32Array, FloatArray

WORKER = Path(__file__).with_name("child_worker.py")

STARTS_WITHIN_S = 120.0
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
            self._exchange([json.dumps(told).encode()], None, STARTS_WITHIN_S)
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
        deadline = Deadline(child.process, timeout_s)
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
                    how_it_ended(status) + which_said(child.process.last_line), reason="crashed"
                ) from error
        except BaseException:
            self.renew()
            raise
        self.renew()
        failed = "was not loaded" if shape is None else "gave no answer"
        raise DetectorError(
            f"it {failed} within {timeout_s:g} s" + which_said(child.process.last_line),
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
            self.process = OwnProcess(
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
    return "its map has {} values and the follow-up {} px; return one a pixel".format(*texts)


def _bytes_of(image: Float32Array) -> memoryview:
    return np.ascontiguousarray(image).data.cast("B")
