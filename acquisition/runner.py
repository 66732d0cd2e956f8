"""Run a capture plan: place, move, average, store; the same call resumes what was broken off."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Literal

from acquisition.averaging import AveragedFrames, average_frames
from acquisition.bench import BenchConfig
from acquisition.device_snapshot import camera_snapshot, stage_snapshot
from acquisition.devices import Camera, FrameImage, Stage
from acquisition.errors import DeviceError, SessionError, StageLimitError, StreamInterruptedError
from acquisition.focus import focus_value
from acquisition.journal import new_uid, utc_now
from acquisition.plan import CapturePlan, PlanEntry, plan_entries
from acquisition.record import CaptureRecord
from acquisition.session_writer import SessionWriter
from acquisition.stage_travel import home_timeout_s, move_timeout_s

__all__ = ["CaptureProgress", "Placement", "RunSummary", "run_plan"]

Placement = Literal["ready", "skip"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureProgress:
    """After a capture was stored: ``captured`` of ``planned`` entries are done."""

    captured: int
    planned: int
    entry: PlanEntry
    record: CaptureRecord


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSummary:
    """What one run did: captures made now, found from earlier runs, and skipped by the operator."""

    captured: int
    already_captured: int
    skipped: int


def run_plan(
    path: Path,
    *,
    plan: CapturePlan,
    bench: BenchConfig,
    camera: Camera,
    stage: Stage,
    operator: str,
    place: Callable[[PlanEntry], Placement],
    progress: Callable[[CaptureProgress], None] = lambda _: None,
    clock: Callable[[], float] = time.monotonic,
    utc_now: Callable[[], datetime] = utc_now,
    new_uid: Callable[[], str] = new_uid,
) -> RunSummary:
    """Capture every entry of the plan that the session at ``path`` does not have whole.

    Parameters
    ----------
    path
        New or empty directory, or the session to resume.
    camera, stage
        Opened and configured after ``bench``; the stage is homed where it is not.
    place
        Is asked when target or orientation changes, and at the first capture of a run; it
        returns once the operator has set it up, or ``"skip"`` to leave that target and
        orientation for another run.
    progress
        Is told after each capture.
    clock
        Monotonic time in seconds.

    Raises
    ------
    StageLimitError
        Before anything moves or is written, if the plan goes beyond the travel.
    SessionError
        If the session is in use, was made otherwise, or the disk is full.
    DeviceError
        If a device fails. What was captured until then is kept, and the error is journaled;
        so is a stop by the keyboard. A capture whose stream broke off is begun once more, from
        its first frame; the journal has an ``error`` of that, too.
    """
    _refuse_beyond_travel(plan, stage)
    with SessionWriter(
        path,
        plan=plan,
        bench=bench,
        devices={"camera": camera_snapshot(camera), "stage": stage_snapshot(stage)},
        operator=operator,
        utc_now=utc_now,
        new_uid=new_uid,
    ) as session:
        run = _Run(session, plan, bench, camera, stage, clock, utc_now)
        try:
            return run.capture_all(place, progress)
        except (KeyboardInterrupt, SystemExit) as interrupt:
            try:
                stage.stop()
            except DeviceError as error:
                interrupt.add_note(f"stopping the stage failed: {error}")
            _journal_or_note(session, "stop", {"index": run.index}, interrupt)
            raise
        except Exception as error:
            facts = {"index": run.index, "error": type(error).__name__, "message": str(error)}
            _journal_or_note(session, "error", facts, error)
            raise


@dataclass(frozen=True, slots=True)
class _Exposed:
    """One average, and when it was made."""

    averaged: AveragedFrames
    raw_frames: list[FrameImage]
    started: datetime
    finished: datetime


class _Run:
    """One run of a plan; ``index`` is the entry at work."""

    def __init__(
        self,
        session: SessionWriter,
        plan: CapturePlan,
        bench: BenchConfig,
        camera: Camera,
        stage: Stage,
        clock: Callable[[], float],
        utc_now: Callable[[], datetime],
    ) -> None:
        self.index: int | None = None
        self._session = session
        self._frames_asked = plan.frames_per_capture or bench.capture.frames_per_capture
        self._keep_frames = plan.keep_frames
        self._bench = bench
        self._camera = camera
        self._stage = stage
        self._clock = clock
        self._utc_now = utc_now
        self._approached_mm: float | None = None

    def capture_all(
        self,
        place: Callable[[PlanEntry], Placement],
        progress: Callable[[CaptureProgress], None],
    ) -> RunSummary:
        pending = self._session.pending_entries()
        planned = len(self._session.entries)
        captured = skipped = 0
        if pending:
            self._require_space(len(pending))
        placed: tuple[str, str, float] | None = None
        placement: Placement = "ready"
        for entry in pending:
            self.index = entry.index
            if entry.placement != placed:
                placement = place(entry)
                placed = entry.placement
                self._approached_mm = None
            if placement == "skip":
                self._session.journal("skip", {"index": entry.index})
                skipped += 1
                continue
            record = self._capture(entry)
            captured += 1
            progress(
                CaptureProgress(
                    captured=planned - len(pending) + captured,
                    planned=planned,
                    entry=entry,
                    record=record,
                )
            )
        return RunSummary(
            captured=captured, already_captured=planned - len(pending), skipped=skipped
        )

    def _require_space(self, captures: int) -> None:
        settings = self._camera.settings
        pages = 2 * 4 + (2 * self._frames_asked if self._keep_frames else 0)
        pixels = settings.width_px * settings.height_px
        self._session.require_space(captures * pages * pixels)

    def _capture(self, entry: PlanEntry) -> CaptureRecord:
        self._approach(entry.height_mm)
        self._require_still()
        try:
            exposed = self._expose()
        except StreamInterruptedError as error:
            # Starting again opens the camera anew; what was averaged until then is gone.
            self._session.journal(
                "error",
                {
                    "index": entry.index,
                    "error": type(error).__name__,
                    "message": f"{error}; the capture is begun once more",
                },
            )
            exposed = self._expose()
        averaged = exposed.averaged
        # Asked after the exposure: a stage that moved or crept away spoils the capture.
        self._require_still()
        height_mm = self._checked(entry.height_mm, self._stage.position_mm())
        settings = self._camera.settings
        focus = None
        if entry.kind not in ("flat", "dark"):
            focus = focus_value(
                averaged.mean_dn,
                black_level_dn=settings.black_level_dn,
                noise_variance_dn2=float(averaged.variance_dn2.mean()) / averaged.frames_used,
            )
        return self._session.add_capture(
            entry,
            averaged,
            settings=settings,
            height_mm=height_mm,
            focus_value=focus,
            started=exposed.started,
            finished=exposed.finished,
            raw_frames=exposed.raw_frames,
        )

    def _expose(self) -> "_Exposed":
        raw_frames: list[FrameImage] = []
        started = self._utc_now()
        averaged = average_frames(
            self._camera,
            self._frames_asked,
            keep_frame=raw_frames.append if self._keep_frames else None,
            clock=self._clock,
        )
        return _Exposed(averaged, raw_frames, started, self._utc_now())

    def _approach(self, height_mm: float) -> None:
        if self._approached_mm == height_mm:
            return
        if not self._stage.is_homed:
            self._stage.home(home_timeout_s(self._bench.stage))
        self._approached_mm = None
        self._checked(height_mm, self._stage.move_to(height_mm, move_timeout_s(self._bench.stage)))
        self._approached_mm = height_mm

    def _require_still(self) -> None:
        """Refuse a capture that overlaps a move, whoever moves the stage."""
        state = self._stage.state
        if state != "idle":
            raise DeviceError(
                f"the stage is not at rest but {state} during a capture; nothing of it is kept. "
                "Stop whatever moves it and run again"
            )

    def _checked(self, asked_mm: float, read_back_mm: float) -> float:
        """Give the height read back, if it is where the stage was sent."""
        tolerance_mm = self._bench.stage.tolerance_mm
        # The negation also refuses NaN. A nanometre forgives decimal fractions, not stages.
        if not abs(read_back_mm - asked_mm) <= tolerance_mm + 1e-6:
            raise DeviceError(
                f"the stage stands at {read_back_mm:.3f} mm, not at {asked_mm:.3f} mm "
                f"(tolerance {tolerance_mm:g} mm); home it and run again"
            )
        return read_back_mm


def _refuse_beyond_travel(plan: CapturePlan, stage: Stage) -> None:
    low_mm, high_mm = stage.limits_mm
    for entry in plan_entries(plan):
        if not low_mm <= entry.height_mm <= high_mm:
            raise StageLimitError(
                f"the plan asks for a height of {entry.height_mm:g} mm (capture {entry.index}), "
                f"the stage goes from {low_mm:g} to {high_mm:g} mm; nothing moved"
            )


def _journal_or_note(
    session: SessionWriter,
    kind: Literal["stop", "error"],
    facts: Mapping[str, object],
    error: BaseException,
) -> None:
    """Journal why the run ends; where even that fails, say so on the error that ends it."""
    try:
        session.journal(kind, facts)
    except SessionError as second:
        error.add_note(f"journaling this failed too: {second}")
