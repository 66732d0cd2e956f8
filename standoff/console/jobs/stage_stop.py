"""STOP: told to the stage until the job has ended, and watched until the stage is seen at rest."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock, Thread
from typing import Literal

from acquisition.errors import DeviceError
from standoff.console.devices import StageService
from standoff.console.jobs.job_runner import Job

STOP_AGAIN_S = 0.3
STOP_TRIES = 100
"""A stop is repeated until the job has ended, because it may come between two moves."""

AT_REST_WITHIN_S = 2.0
"""Time after which a stage that nobody has seen at rest counts as not stopped."""

StopOutcome = Literal["none", "waiting", "stopped", "failed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StopView:
    """What became of the last STOP; ``number`` counts them, 0 before the first.

    ``outcome`` is ``stopped`` once the stage was read at rest after the STOP, and ``failed``, with
    the ``fault``, if it could not be told, or is not seen at rest in time.
    """

    number: int = 0
    outcome: StopOutcome = "none"
    fault: str = ""


class StageStop:
    """Stops the stage from any thread, whoever moves it.

    Parameters
    ----------
    stage
        The stage.
    report
        Called with one line when it cannot be told to stop.
    """

    def __init__(self, stage: StageService, report: Callable[[str], None]) -> None:
        self._stage = stage
        self._report = report
        self._lock = Lock()
        self._number = 0
        self._asked_s = float("-inf")
        self._fault = ""

    @property
    def view(self) -> StopView:
        """What became of the last STOP, by what the stage is seen to do."""
        with self._lock:
            number, asked_s, fault = self._number, self._asked_s, self._fault
        if number == 0:
            return StopView()
        seen = self._stage.view
        is_seen = seen.status.is_ready and seen.read_s is not None and seen.read_s > asked_s
        if is_seen and seen.state not in ("moving", "homing", "unknown"):
            return StopView(number=number, outcome="stopped")
        if not fault and time.monotonic() - asked_s > AT_REST_WITHIN_S:
            fault = f"the stage was not seen at rest within {AT_REST_WITHIN_S:g} s"
        return StopView(number=number, outcome="failed" if fault else "waiting", fault=fault)

    def order(self, job: Job | None) -> int:
        """Stop the stage, again and again until the job has ended; return the number at once."""
        with self._lock:
            self._number += 1
            self._asked_s, self._fault = time.monotonic(), ""
            number = self._number
        Thread(target=self._tell_stage, args=(job,), name="stop", daemon=True).start()
        return number

    def _tell_stage(self, job: Job | None) -> None:
        told: str | None = None
        for _ in range(STOP_TRIES):
            try:
                self._stage.stop()
            except DeviceError as error:
                self._fault = str(error)
                if str(error) != told:
                    told = str(error)
                    self._report(f"STOP: {error}")
            else:
                self._fault = ""
            if job is None or job.ended.wait(STOP_AGAIN_S):
                return
