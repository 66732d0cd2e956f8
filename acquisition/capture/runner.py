"""Run a capture plan: place, move, average, store; the same call resumes an interrupted run."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from acquisition.bench import BenchDevices
from acquisition.capture.quality import (
    QualityFinding,
    bracket_remarks,
    check_capture,
    drift_between,
)
from acquisition.capture.step import CaptureStep
from acquisition.devices import Stage
from acquisition.errors import (
    DeviceError,
    OperatorStopError,
    SessionError,
    StageLimitError,
    StreamInterruptedError,
)
from acquisition.plan import CapturePlan, PlanEntry, bytes_per_pixel, plan_entries
from acquisition.session import (
    SYSTEM_STAMPS,
    CaptureImages,
    CaptureRecord,
    SessionWriter,
    Stamps,
    camera_snapshot,
    read_capture,
    stage_snapshot,
)

Placement = Literal["ready", "skip"]
Verdict = Literal["keep", "retake"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureProgress:
    """Progress after a stored capture: ``captured`` of ``planned`` entries are done.

    ``findings`` are the problems with it, ``remarks`` what else is worth knowing;
    ``seconds_left`` excludes the operator's own time.
    """

    captured: int
    planned: int
    entry: PlanEntry
    record: CaptureRecord
    findings: tuple[QualityFinding, ...] = ()
    remarks: tuple[str, ...] = ()
    seconds_left: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSummary:
    """What one run did: captures made now, found from earlier runs, and skipped by the operator."""

    captured: int
    already_captured: int
    skipped: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOperator:
    """The operator of a run, and the callbacks that ask and inform them.

    Parameters
    ----------
    name
        Name in the session and its journal.
    place
        Called when target or orientation changes, and at the first capture of a run; it
        returns once the operator has set up the target, or ``"skip"`` to leave that target and
        orientation for another run.
    progress
        Called after each capture.
    review
        Called for a capture that a quality check found bad enough to retake; if kept, it is
        stored with the finding as a note in the journal, as all findings are.
    before_capture
        Called before each capture, with the stage at rest; it may wait.
    """

    name: str
    place: Callable[[PlanEntry], Placement]
    progress: Callable[[CaptureProgress], None] = lambda _: None
    review: Callable[[PlanEntry, tuple[QualityFinding, ...]], Verdict] = lambda *_: "keep"
    before_capture: Callable[[], None] = lambda: None


def run_plan(
    path: Path,
    plan: CapturePlan,
    devices: BenchDevices,
    operator: RunOperator,
    *,
    retake: Sequence[int] = (),
    stamps: Stamps = SYSTEM_STAMPS,
) -> RunSummary:
    """Capture every entry of the plan that the session at ``path`` does not hold intact.

    Parameters
    ----------
    path
        New or empty directory, or the session to resume.
    devices
        The stage is homed if necessary.
    retake
        Indices of captures to void and take again.

    Raises
    ------
    StageLimitError
        Before anything moves or is written, if the plan goes beyond the travel.
    SessionError
        If the session is in use, was made with other settings, or the disk is full.
    DeviceError
        If a device fails. What was captured until then is kept, and the error is journaled;
        so is a stop by the keyboard or by `OperatorStopError`, which any of the callbacks and
        devices may raise. A capture whose stream was interrupted is restarted from its first
        frame, for ``camera.reconnect_timeout_s`` if need be; each is journaled as an ``error``.
    """
    stage = devices.stage
    _refuse_beyond_travel(plan, stage)
    with SessionWriter(
        path,
        plan=plan,
        bench=devices.config,
        devices={"camera": camera_snapshot(devices.camera), "stage": stage_snapshot(stage)},
        operator=operator.name,
        stamps=stamps,
    ) as session:
        for index in retake:
            session.retake(index, "requested by the operator", operator.name)
        run = _Run(session, plan, devices, operator, stamps)
        try:
            return run.capture_all()
        except (KeyboardInterrupt, SystemExit, OperatorStopError) as interrupt:
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


@dataclass(frozen=True, slots=True, kw_only=True)
class _Taken:
    """A stored capture with its findings and remarks."""

    record: CaptureRecord
    findings: tuple[QualityFinding, ...]
    remarks: tuple[str, ...]


class _Run:
    """One run of a plan; ``index`` is that of the current entry."""

    def __init__(
        self,
        session: SessionWriter,
        plan: CapturePlan,
        devices: BenchDevices,
        operator: RunOperator,
        stamps: Stamps,
    ) -> None:
        self.index: int | None = None
        self._session = session
        self._plan = plan
        self._bench = devices.config
        self._camera = devices.camera
        self._operator = operator
        self._clock = devices.clock
        self._step = CaptureStep(
            plan, devices, interrupted=self._journal_interruption, utc_now=stamps.utc_now
        )
        self._records = [c.record for c in session.captures if not c.is_superseded]
        self._locked_us = self._exposures_found()

    def capture_all(self) -> RunSummary:
        """Capture what is pending, then park the stage if the bench file says where."""
        pending = self._session.pending_entries()
        planned = len(self._session.entries)
        captured = skipped = 0
        worked_s = 0.0
        self._require_space(pending)
        placed: tuple[str, str, float] | None = None
        placement: Placement = "ready"
        for entry in pending:
            self.index = entry.index
            if entry.placement != placed:
                placement = self._operator.place(entry)
                placed = entry.placement
                self._step.forget_approach()
            if placement == "skip":
                self._session.journal("skip", {"index": entry.index})
                skipped += 1
                continue
            self._operator.before_capture()
            began_s = self._clock()
            taken = self._take(entry)
            worked_s += self._clock() - began_s
            while (
                any(f.asks_retake for f in taken.findings)
                and self._operator.review(entry, taken.findings) == "retake"
            ):
                self._session.retake(entry.index, taken.findings[0].text, self._operator.name)
                self._records.remove(taken.record)
                taken = self._take(entry)
            captured += 1
            self._operator.progress(
                CaptureProgress(
                    captured=planned - len(pending) + captured,
                    planned=planned,
                    entry=entry,
                    record=taken.record,
                    findings=taken.findings,
                    remarks=taken.remarks,
                    seconds_left=worked_s / captured * (len(pending) - skipped - captured),
                )
            )
        self.index = None
        if captured and self._bench.stage.park_mm is not None:
            self._step.park(self._bench.stage.park_mm)
        return RunSummary(
            captured=captured, already_captured=planned - len(pending), skipped=skipped
        )

    def _journal_interruption(self, entry: PlanEntry, error: StreamInterruptedError) -> None:
        """Journal that a stream was interrupted and its capture is restarted."""
        self._session.journal(
            "error",
            {
                "index": entry.index,
                "error": type(error).__name__,
                "message": f"{error}; the capture is restarted",
            },
        )

    def _require_space(self, pending: Sequence[PlanEntry]) -> None:
        if not pending:
            return
        settings, frames = self._camera.settings, self._step.frames_asked
        per_pixel = sum(
            bytes_per_pixel(entry, frames, keep_frames=self._plan.keep_frames) for entry in pending
        )
        self._session.require_space(per_pixel * settings.width_px * settings.height_px)

    def _take(self, entry: PlanEntry) -> _Taken:
        """Capture an entry, store it, and journal its findings and remarks."""
        take = self._step.capture(entry, self._exposure_us(entry))
        record = self._session.add_capture(entry, take)
        if entry.exposure_us is None:
            self._locked_us.setdefault((entry.kind, entry.target), take.settings.exposure_us)
        images = CaptureImages(
            mean_dn=take.averaged.mean_dn,
            variance_dn2=take.averaged.variance_dn2,
            exposures_used=None if take.bracket is None else take.bracket.exposures_used,
            record=record,
        )
        findings = check_capture(images, self._records)
        remarks = (*bracket_remarks(record), *self._drift_remarks(entry, images))
        for text in (*(f"{f.problem}: {f.text}" for f in findings), *remarks):
            facts = {"index": entry.index, "capture": record.uid, "operator": self._operator.name}
            self._session.journal("note", {"text": text, **facts})
        self._records.append(record)
        return _Taken(record=record, findings=findings, remarks=remarks)

    def _exposure_us(self, entry: PlanEntry) -> float | None:
        """Exposure of an entry; None if it has yet to be found."""
        if entry.exposure_us is not None:
            return entry.exposure_us
        if self._plan.auto_exposure and entry.kind != "dark":
            return self._locked_us.get((entry.kind, entry.target))
        return self._bench.camera.exposure_us

    def _exposures_found(self) -> dict[tuple[str, str], float]:
        """Exposure of each target as an earlier run found it."""
        entries = {entry.index: entry for entry in self._session.entries}
        found: dict[tuple[str, str], float] = {}
        for capture in self._session.captures:
            record = capture.record
            if record.exposure_us is not None and entries[record.index].exposure_us is None:
                found.setdefault((record.kind, record.target), record.exposure_us)
        return found

    def _drift_remarks(self, entry: PlanEntry, images: CaptureImages) -> tuple[str, ...]:
        """Compare the last capture of an orientation with its first, where the plan asks."""
        if not self._plan.drift_check or entry.repeat != self._plan.repeats:
            return ()
        first = [
            record
            for record in self._records
            if (record.kind, record.target, record.orientation_deg) == entry.placement
            and record.height_asked_mm == entry.height_mm
            and record.exposure_us == images.record.exposure_us
            and record.index < entry.index
        ]
        if not first:
            return ()
        drift = drift_between(
            read_capture(self._session.path / first[0].file).mean_dn,
            images.mean_dn,
            black_level_dn=images.record.black_level_dn,
        )
        return (f"drift: {drift.text}",)


def _refuse_beyond_travel(plan: CapturePlan, stage: Stage) -> None:
    low_mm, high_mm = stage.limits_mm
    for entry in plan_entries(plan):
        if not low_mm <= entry.height_mm <= high_mm:
            raise StageLimitError(
                f"the plan asks for a height of {entry.height_mm:g} mm (capture {entry.index}), "
                f"but the stage travels from {low_mm:g} to {high_mm:g} mm; nothing moved",
                height_mm=entry.height_mm,
                limits_mm=stage.limits_mm,
            )


def _journal_or_note(
    session: SessionWriter,
    kind: Literal["stop", "error"],
    facts: Mapping[str, object],
    error: BaseException,
) -> None:
    """Journal why the run ends; if that fails too, add a note to the error that ends it."""
    try:
        session.journal(kind, facts)
    except SessionError as second:
        error.add_note(f"this could not be journaled: {second}")
