"""Run a capture plan: place, move, average, store; the same call resumes an interrupted run."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

from acquisition.bench import BenchConfig, BenchDevices
from acquisition.capture._quality import (
    QualityFinding,
    bracket_remarks,
    check_capture,
    drift_between,
)
from acquisition.capture._step import CaptureStep, flicker_fraction, without_flicker
from acquisition.dataframe import dataframe
from acquisition.devices import Stage
from acquisition.errors import (
    DeviceError,
    OperatorStopError,
    SessionError,
    StageLimitError,
    StreamInterruptedError,
)
from acquisition.plan import (
    CapturePlan,
    PlanEntry,
    PlanEstimate,
    bytes_per_pixel,
    estimate_plan,
    plan_entries,
)
from acquisition.session import (
    MANIFEST_NAME,
    SYSTEM_STAMPS,
    CaptureImages,
    CaptureRecord,
    SessionWriter,
    Stamps,
    camera_snapshot,
    read_capture,
    stage_snapshot,
)

if TYPE_CHECKING:
    from pandas import DataFrame


_FLICKER_LIMIT = 0.01
"""Fraction of the flicker left in a capture, above which it is worth a warning."""


_PLANNED = ("index", "kind", "target", "orientation_deg", "height_mm", "exposure_us")


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class PlanPreview:
    """The captures that a plan asks for, in order, and an estimate of their time and disk space."""

    entries: tuple[PlanEntry, ...]
    estimate: PlanEstimate
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        bytes_ = self.estimate.bytes_
        size = "" if bytes_ is None else f", {bytes_ / 1e6:.0f} MB"
        return (
            f"<PlanPreview: {len(self.entries)} captures, {self.estimate.placements} placements, "
            f"{self.estimate.seconds:.0f} s{size}>"
        )

    def _repr_html_(self) -> str:
        head = "".join(f"<th>{escape(name)}</th>" for name in _PLANNED)
        table = f"<caption>{escape(repr(self)[1:-1])}</caption><tr>{head}</tr>"
        for one in self.entries:
            cells = (escape(str(getattr(one, name))) for name in _PLANNED)
            table += f"<tr>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
        return f"<table>{table}</table>"

    def to_dataframe(self) -> "DataFrame":
        """Return the captures as a pandas table, one row per capture.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return dataframe(self.to_json()["captures"])

    def to_json(self) -> dict[str, Any]:
        """Return the captures as ``standoff capture --dry-run --json`` prints them."""
        captures = [
            {
                **{name: getattr(entry, name) for name in _PLANNED},
                "bracket": None if entry.bracket is None else entry.bracket.model_dump(),
            }
            for entry in self.entries
        ]
        return {
            "captures": captures,
            "placements": self.estimate.placements,
            "seconds": round(self.estimate.seconds, 1),
            "bytes": self.estimate.bytes_,
        }

    @classmethod
    def of(cls, plan: CapturePlan, bench: BenchConfig, out: Path | None = None) -> Self:
        """Preview a plan on a bench; if ``out`` already holds a session, a note says so.

        Raises
        ------
        PlanError
            If the plan names no capture.
        """
        entries = plan_entries(plan)
        notes = [*flicker_warnings(plan, entries, bench)]
        if out is not None and (out / MANIFEST_NAME).is_file():
            notes.append(
                f"{out} already contains a session: with the same bench and plan it resumes where "
                "it stopped; with any others it is refused"
            )
        return cls(
            entries=entries,
            estimate=estimate_plan(plan, entries, bench, bench.frame_shape),
            notes=tuple(notes),
        )


def flicker_warnings(
    plan: CapturePlan, entries: Sequence[PlanEntry], bench: BenchConfig
) -> Iterator[str]:
    """Warn of exposures that are not a multiple of the light's period, on a real bench."""
    mains_hz = bench.capture.mains_hz
    if bench.camera.driver == "simulated":
        return
    found_later = plan.auto_exposure
    asked_us = {
        # Longer exposures of a bracket are shortened to whole periods.
        entry.exposure_us or bench.camera.exposure_us
        for entry in entries
        if entry.kind != "dark" and (entry.exposure_us is not None or not found_later)
    }
    for exposure_us in sorted(asked_us):
        left = flicker_fraction(exposure_us, mains_hz)
        if left > _FLICKER_LIMIT:
            better_us = max(without_flicker(exposure_us, mains_hz), 0.5e6 / mains_hz)
            yield (
                f"an exposure of {exposure_us:g} us is not a multiple of the "
                f"{0.5e3 / mains_hz:.3g} ms flicker period of lamps on {mains_hz} Hz mains, "
                f"and leaves {100 * left:.0f} % of the flicker; use {better_us:.0f} us, "
                "or capture.mains_hz = 0 for steady light"
            )


Placement = Literal["ready", "skip"]
Verdict = Literal["keep", "retake"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureProgress:
    """Progress after a stored capture: ``captured`` of ``planned`` entries are done.

    ``findings`` are the problems with this capture, ``remarks`` further sentences on it.
    ``seconds_left`` does not include the time that the operator needs.
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
    """Counts of one run: captures made now, made by earlier runs, and skipped by the operator."""

    captured: int
    already_captured: int
    skipped: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RunOperator:
    """The operator of a run, by name, and the callbacks that ask and inform them.

    ``place`` is called when target or orientation changes and returns once it is set up, or
    ``"skip"`` to leave it for another run. ``review`` is called for a capture bad enough to retake.
    ``before_capture`` is called with the stage at rest; it may wait.
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

    ``path`` is a new or empty directory, or the session to resume; the captures of ``retake`` are
    voided and taken again. The stage is homed if necessary.

    A plan beyond the travel is refused before anything moves or is written. If a device fails, the
    captures made so far are kept, and the error is recorded in the journal. So is a stop by the
    keyboard or by an `OperatorStopError`, which any callback or device may raise. A capture whose
    stream was interrupted is restarted from its first frame, for up to
    ``camera.reconnect_timeout_s``; each interruption is recorded in the journal as an ``error``.
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
