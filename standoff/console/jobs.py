"""One job at a time at the bench: its questions to the operator, and the STOP that ends it."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from threading import Condition, Event, Lock, Thread
from typing import Literal

from acquisition.capture import Placement, QualityFinding, Verdict
from acquisition.errors import DeviceError, OperatorStopError
from acquisition.plan import PlanEntry
from standoff.console.stage_service import StageService
from standoff.errors import REPORTED_ERRORS, ApplicationError
from standoff.terminal import what_to_place

STOP_CHECK_S = 0.1
STOP_AGAIN_S = 0.3
STOP_TRIES = 100
"""A stop is repeated until the job has ended, because it may come between two moves."""

AT_REST_WITHIN_S = 2.0
"""Time after which a stage that nobody has seen at rest counts as not stopped."""


class BusyError(ApplicationError):
    """Another job is running on the bench; ``job`` is its name."""

    def __init__(self, job: str, text: str = "") -> None:
        super().__init__(text or f"Busy: {job} is still running. Wait, or stop it.")
        self.job = job


class Job:
    """One job: its name, whether it has been told to stop, and whether it has ended."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.ended = Event()
        self._is_stop_wanted = Event()

    @property
    def is_stopping(self) -> bool:
        """Whether it has been told to stop."""
        return self._is_stop_wanted.is_set()

    def ask_stop(self) -> None:
        """Make the next `check` raise."""
        self._is_stop_wanted.set()

    def check(self) -> None:
        """Raise if the job has been told to stop."""
        if self._is_stop_wanted.is_set():
            raise OperatorStopError("stopped by the operator")


class JobRunner:
    """Runs each job in its own thread, never two at once; tells in a line when one fails."""

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report = report
        self._lock = Lock()
        self._job: Job | None = None

    @property
    def current(self) -> Job | None:
        """The job that is running, if any."""
        job = self._job
        return None if job is None or job.ended.is_set() else job

    def begin(self, name: str, work: Callable[[Job], None]) -> Job:
        """Start a job."""
        with self._lock:
            busy = self.current
            if busy is not None:
                raise BusyError(busy.name)
            job = Job(name)
            self._job = job
        Thread(target=self._run, args=(job, work), name=name, daemon=True).start()
        return job

    def _run(self, job: Job, work: Callable[[Job], None]) -> None:
        try:
            work(job)
        except OperatorStopError:
            self._report(f"Stopped: {job.name}.")
        except REPORTED_ERRORS as error:
            self._report(f"{job.name[:1].upper()}{job.name[1:]} failed: {error}")
        except BaseException:
            self._report(f"{job.name[:1].upper()}{job.name[1:]} crashed; see the terminal.")
            raise
        finally:
            job.ended.set()


@dataclass(frozen=True, slots=True, kw_only=True)
class Prompt:
    """A question with its buttons, answers and labels; ``wants_text`` asks for a line besides."""

    number: int
    text: str
    choices: Mapping[str, str]
    wants_text: bool = False


def what_is_placed(entry: PlanEntry) -> str:
    """Name what an entry's placement is, for a question or a line about it."""
    if entry.kind == "dark":
        return "Lens cap"
    if entry.kind == "flat":
        return f"White surface {entry.target!r}"
    return f"{entry.kind.capitalize()} {entry.target!r} at {entry.orientation_deg:g} degrees"


class PromptQueue:
    """Shows one question at a time, in ``current``; the asking thread waits.

    ``check`` is called while it waits, and may raise to end the wait.
    """

    def __init__(self, check: Callable[[], None]) -> None:
        self._check = check
        self._changed = Condition()
        self.current: Prompt | None = None
        self._answer: tuple[str, str] | None = None
        self._asked = 0

    def answer(self, number: int, choice: str, text: str = "") -> bool:
        """Answer a question; False if it is not the one waiting, or has no such choice."""
        with self._changed:
            prompt = self.current
            if prompt is None or prompt.number != number or choice not in prompt.choices:
                return False
            self._answer = (choice, text)
            self._changed.notify_all()
        return True

    def place(self, entry: PlanEntry) -> Placement:
        """Ask the operator to place a target."""
        return self._placement(what_to_place(entry))

    def confirm(self, entry: PlanEntry) -> Placement:
        """Ask the operator whether a target is still in place."""
        return self._placement(f"{what_is_placed(entry)}: still in place? If not, place it again.")

    def review(self, entry: PlanEntry, findings: tuple[QualityFinding, ...]) -> Verdict:
        """Ask whether to retake a bad capture."""
        found = "; ".join(f"{finding.problem}: {finding.text}" for finding in findings)
        question = f"Capture {entry.index} of {entry.target!r}: {found}."
        choice, _ = self._ask(question, {"retake": "Retake it", "keep": "Keep it"})
        return "retake" if choice == "retake" else "keep"

    def ask(self, question: str) -> str:
        """Ask a question that is answered by a line of text; an empty one confirms."""
        _, text = self._ask(question, {"ok": "Confirm"}, wants_text=True)
        return text

    def _placement(self, text: str) -> Placement:
        choice, _ = self._ask(text, {"ready": "It is in place", "skip": "Skip it"})
        return "skip" if choice == "skip" else "ready"

    def _ask(
        self, text: str, choices: Mapping[str, str], *, wants_text: bool = False
    ) -> tuple[str, str]:
        with self._changed:
            self._asked += 1
            self._answer = None
            self.current = Prompt(
                number=self._asked, text=text, choices=choices, wants_text=wants_text
            )
            try:
                while self._answer is None:
                    self._check()
                    self._changed.wait(STOP_CHECK_S)
                return self._answer
            finally:
                self.current = None


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
    """Stops the stage from any thread, whoever moves it; reports if it cannot be told."""

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
