"""A running capture session: the runner in a job, the plan as a table, pause and retake."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event, Lock
from typing import Literal

from pydantic import ValidationError

from acquisition.bench import BenchConfig, BenchDevices, CameraConfig
from acquisition.capture import CaptureProgress, Placement, RunOperator, run_plan
from acquisition.devices import Camera
from acquisition.errors import DeviceError, OperatorStopError, SessionError, StreamInterruptedError
from acquisition.exposure_control import ExposureControl
from acquisition.plan import CapturePlan, PlanEntry, plan_entries
from acquisition.session import MANIFEST_NAME, CaptureRecord, Session
from standoff.console.camera_service import CameraService
from standoff.console.devices import BenchDrivers
from standoff.console.jobs import Job, PromptQueue, what_is_placed
from standoff.console.stage_service import StageService
from standoff.errors import ApplicationError

Target = tuple[str, str, float]
"""Kind, name and orientation, as in `PlanEntry.placement`."""


class PlacementMemory:
    """Remembers what the operator placed for a session, and how sure that still is.

    The operator's word in this process is taken until somebody stops the run, retakes a capture or
    says that the target was moved: losing a camera or a stage moves no target. What only the
    journal tells, after a restart, is asked for once more, as is anything after a stop.
    """

    def __init__(
        self,
        ask: Callable[[PlanEntry], Placement],
        confirm: Callable[[PlanEntry], Placement],
    ) -> None:
        self._ask = ask
        self._confirm = confirm
        self._lock = Lock()
        self._session: Path | None = None
        self._placed: Target | None = None
        self._is_sure = False

    @property
    def placed(self) -> Target | None:
        """What is in place, as far as anybody said; None if nobody did."""
        return self._placed

    def begin(self, session: Path) -> None:
        """Note which session runs; of another one than before, its journal is asked."""
        if session == self._session:
            return
        captures = Session(session).captures if (session / MANIFEST_NAME).is_file() else ()
        record = captures[-1].record if captures else None
        with self._lock:
            self._session, self._is_sure = session, False
            self._placed = (
                None if record is None else (record.kind, record.target, record.orientation_deg)
            )

    def place(self, entry: PlanEntry) -> tuple[Placement, bool]:
        """Have a target placed; return the answer, and whether anybody was asked."""
        if entry.placement == self._placed and self._is_sure:
            return "ready", False
        asked = self._confirm if entry.placement == self._placed else self._ask
        placement = asked(entry)
        with self._lock:
            is_ready = placement == "ready"
            self._placed, self._is_sure = (entry.placement, True) if is_ready else (None, False)
        return placement, True

    def doubt(self) -> None:
        """Ask before the next capture whether the target is still in place."""
        self._is_sure = False

    def forget(self) -> None:
        """Ask to place the target before the next capture: it was moved."""
        with self._lock:
            self._placed, self._is_sure = None, False


RunState = Literal["idle", "running", "paused", "finished", "stopped", "failed"]
RowState = Literal["pending", "next", "done", "failed"]

PAUSE_CHECK_S = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanRow:
    """One entry of the plan and its result; ``note`` says what was found wrong."""

    entry: PlanEntry
    state: RowState = "pending"
    height_mm: float | None = None
    focus_value: float | None = None
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunView:
    """The running session, or the last one.

    ``revision`` increases whenever a row changes. ``placed`` names the target that is taken to be
    in place, if it was not asked for again.
    """

    session: str = ""
    plan: str = ""
    state: RunState = "idle"
    message: str = ""
    placed: str = ""
    seconds_left: float | None = None
    rows: tuple[PlanRow, ...] = ()
    revision: int = 0

    @property
    def captured(self) -> int:
        """Entries that are done."""
        return sum(row.state == "done" for row in self.rows)


def rows_of(path: Path, plan: CapturePlan) -> tuple[PlanRow, ...]:
    """The plan as a table, with the captures that the session at ``path`` already has."""
    done = {}
    if (path / MANIFEST_NAME).is_file():
        session = Session(path)
        done = {c.record.index: c.record for c in session.captures if not c.is_superseded}
    rows = []
    for entry in plan_entries(plan):
        record = done.get(entry.index)
        rows.append(
            PlanRow(entry=entry)
            if record is None
            else PlanRow(
                entry=entry,
                state="done",
                height_mm=record.height_mm,
                focus_value=record.focus_value,
            )
        )
    return tuple(rows)


def session_bench(path: Path, bench: BenchConfig, camera: Camera) -> BenchConfig:
    """The bench that a session runs with: its initial exposure and gain, or the current ones.

    Everything else comes from the bench file, and the session refuses differences.
    """
    exposure_us, gain_db = camera.settings.exposure_us, camera.settings.gain_db
    if gain_db is None:  # it is in counts, which only the bench file sets
        gain_db = bench.camera.gain_db
    if (path / MANIFEST_NAME).is_file():
        begun = Session(path).bench.get("camera", {})
        exposure_us = begun.get("exposure_us", exposure_us)
        gain_db = begun.get("gain_db", gain_db)
    settings = bench.camera.model_dump() | {"exposure_us": exposure_us, "gain_db": gain_db}
    try:
        settled = CameraConfig.model_validate(settings)
    except ValidationError as error:
        fault = error.errors()[0]
        key = ".".join(("bench", "camera", *(str(part) for part in fault["loc"])))
        raise SessionError(
            f"{path / MANIFEST_NAME}: {key}: {fault['msg']}; restore it from a copy",
            fault="damaged",
            path=path / MANIFEST_NAME,
            keys=(key,),
        ) from error
    return bench.model_copy(update={"camera": settled})


class SessionRun:
    """Runs one session at a time; `view` shows its progress."""

    def __init__(
        self,
        bench: BenchConfig,
        camera: CameraService,
        stage: StageService,
        prompts: PromptQueue,
        *,
        drivers: BenchDrivers,
    ) -> None:
        self._bench = bench
        self._camera = camera
        self._stage = stage
        self._prompts = prompts
        self._placement = PlacementMemory(prompts.place, prompts.confirm)
        self._is_target_moved = Event()
        self._laid = drivers.laid
        self._clock = drivers.clock
        self._sleep = drivers.sleep
        self._lock = Lock()
        self.view = RunView()
        self._may_go_on = Event()
        self._may_go_on.set()
        self._retakes: list[int] = []
        self._compared: Callable[[CaptureRecord], str | None] = lambda _: None

    def prepare(
        self,
        path: Path,
        plan: CapturePlan,
        compared: Callable[[CaptureRecord], str | None] = lambda _: None,
    ) -> None:
        """Show the table of the session that is about to run.

        ``compared`` says how each capture compares with an earlier photograph, if there is one.
        """
        rows = rows_of(path, plan)
        self._compared = compared
        self._may_go_on.set()
        self._taken_retakes()
        self._show(
            session=path.name,
            plan=plan.name,
            state="running",
            message="",
            placed="",
            seconds_left=None,
            rows=_with_next(rows),
        )

    def pause(self) -> None:
        """Wait before the next capture, with the stage at rest."""
        self._may_go_on.clear()

    def go_on(self) -> None:
        """End the pause."""
        self._may_go_on.set()

    @property
    def is_pause_wanted(self) -> bool:
        """Whether it is paused, or will be before the next capture."""
        return not self._may_go_on.is_set()

    @property
    def is_under_way(self) -> bool:
        """Whether it runs or is paused."""
        return self.view.state in ("running", "paused")

    def retake(self, index: int) -> None:
        """Retake a capture; the current run restarts with it."""
        with self._lock:
            if index not in {row.entry.index for row in self.view.rows if row.state == "done"}:
                raise ApplicationError(f"Capture {index} has not been taken yet.")
            self._retakes.append(index)

    def target_moved(self) -> None:
        """Ask to place the target again before the next capture, now or when it is resumed."""
        self._placement.forget()
        self._show(placed="")
        if self.is_under_way:
            self._is_target_moved.set()

    def work(
        self, job: Job, path: Path, plan: CapturePlan, operator: str, retake: Sequence[int] = ()
    ) -> None:
        """Capture what is missing, until the plan is complete or somebody stops it."""
        wanted = list(retake)
        self._is_target_moved.clear()
        try:
            self._placement.begin(path)
            if wanted:
                self._placement.doubt()
            while True:
                self._void(wanted)
                try:
                    skipped = self._run(job, path, plan, operator, wanted)
                except OperatorStopError:
                    self._placement.doubt()
                    wanted = self._taken_retakes()
                    if job.is_stopping or not (wanted or self._is_target_moved.is_set()):
                        raise
                    self._is_target_moved.clear()
                else:
                    break
        except OperatorStopError:
            text = "Stopped. The captures so far are kept; resume to go on."
            self._show(state="stopped", message=text, placed="", seconds_left=None)
            raise
        except (DeviceError, SessionError) as error:
            self._fail(str(error))
            raise
        text = f"{skipped} captures were skipped; resume to take them." if skipped else ""
        self._placement.doubt()
        self._show(state="finished", message=text, placed="", seconds_left=None)

    def _run(
        self, job: Job, path: Path, plan: CapturePlan, operator: str, retake: Sequence[int]
    ) -> int:
        """Run the plan once; return how many captures were skipped."""
        with self._camera.lent(job.check) as camera:
            stage = self._stage.lent(job.check)
            bench = session_bench(path, self._bench, camera)
            # The live picture may have changed it a moment ago. The first capture reopens a camera
            # that does not answer, and says so.
            with suppress(StreamInterruptedError):
                ExposureControl(camera, None, self._clock).settle(bench.camera.exposure_us)
            if camera.settings.gain_db not in (None, bench.camera.gain_db):
                camera.set_gain_db(bench.camera.gain_db)
            try:
                summary = run_plan(
                    path,
                    plan,
                    BenchDevices(
                        config=bench,
                        camera=camera,
                        stage=stage,
                        clock=self._clock,
                        sleep=self._sleep,
                    ),
                    RunOperator(
                        name=operator,
                        place=self._place,
                        progress=self._captured,
                        review=self._prompts.review,
                        before_capture=lambda: self._wait(job),
                    ),
                    retake=retake,
                )
            except (DeviceError, SessionError) as error:
                try:
                    _set_exposure_back(camera, bench)
                except DeviceError as left:
                    error.add_note(f"the exposure could not be restored: {left}")
                raise
            _set_exposure_back(camera, bench)
        return summary.skipped

    def _place(self, entry: PlanEntry) -> Placement:
        placement, is_asked = self._placement.place(entry)
        self._show(placed="" if is_asked else what_is_placed(entry))
        if is_asked and placement == "ready" and self._laid is not None:
            return self._laid(entry)
        return placement

    def _wait(self, job: Job) -> None:
        job.check()
        while not self._may_go_on.wait(PAUSE_CHECK_S):
            if self.view.state != "paused":
                self._show(state="paused")
            job.check()
            self._break_off()
        self._break_off()
        if self.view.state != "running":
            self._show(state="running")

    def _break_off(self) -> None:
        if self._retakes:
            raise OperatorStopError("interrupted to retake captures")
        if self._is_target_moved.is_set():
            raise OperatorStopError("interrupted because the target was moved")

    def _taken_retakes(self) -> list[int]:
        with self._lock:
            taken = list(dict.fromkeys(self._retakes))
            self._retakes.clear()
        return taken

    def _captured(self, progress: CaptureProgress) -> None:
        record, index = progress.record, progress.entry.index
        notes = [f"{finding.problem}: {finding.text}" for finding in progress.findings]
        compared = self._compared(record)
        done = PlanRow(
            entry=progress.entry,
            state="done",
            height_mm=record.height_mm,
            focus_value=record.focus_value,
            note="; ".join((*notes, *progress.remarks, *([compared] if compared else []))),
        )
        rows = tuple(done if row.entry.index == index else row for row in self.view.rows)
        self._show(rows=_with_next(rows), seconds_left=progress.seconds_left)

    def _void(self, indices: Sequence[int]) -> None:
        if indices:
            rows = tuple(
                PlanRow(entry=row.entry) if row.entry.index in indices else row
                for row in self.view.rows
            )
            self._show(rows=_with_next(rows), state="running")

    def _fail(self, message: str) -> None:
        rows = tuple(
            replace(row, state="failed", note=message) if row.state == "next" else row
            for row in self.view.rows
        )
        self._show(state="failed", message=message, rows=rows, seconds_left=None)

    def _show(self, **changes: object) -> None:
        with self._lock:
            grown = self.view.revision + 1
            self.view = replace(self.view, **changes, revision=grown)  # type: ignore[arg-type]  # names and types are RunView's


def _set_exposure_back(camera: Camera, bench: BenchConfig) -> None:
    """Restore the live picture's exposure, with which the next session begins."""
    if camera.settings.exposure_us != bench.camera.exposure_us:
        camera.set_exposure_us(bench.camera.exposure_us)


def _with_next(rows: Sequence[PlanRow]) -> tuple[PlanRow, ...]:
    """Mark the first entry that is not done as the next."""
    marked: list[PlanRow] = []
    is_found = False
    for row in rows:
        if row.state == "done":
            marked.append(row)
        else:
            marked.append(replace(row, state="pending" if is_found else "next", note=""))
            is_found = True
    return tuple(marked)
