"""The camera as a detector of Bluesky: every trigger is a capture of one of our sessions."""

import math
from datetime import UTC, datetime
from threading import Lock
from typing import Any

import numpy as np

from acquisition.capture import CaptureStep, check_capture
from acquisition.errors import DeviceError, PlanError, SessionError
from acquisition.plan import (
    HEIGHT_DECIMALS,
    CapturePlan,
    PlanEntry,
    bytes_per_pixel,
    plan_entries,
)
from acquisition.session import (
    CaptureImages,
    CaptureRecord,
    SessionWriter,
    camera_snapshot,
    stage_snapshot,
)
from standoff.bluesky.readings import Signal, Value, described, readings
from standoff.bluesky.status import WorkStatus
from standoff.library import Bench, FilePath, path_of


class SessionCamera:
    """Captures into a session: ``Stageable``, ``Triggerable``, ``Readable``, ``Configurable``.

    ``stage`` opens the session at ``out``, new or to resume, and ``unstage`` releases it. Each
    trigger averages the frames of one capture at the height where the stage is and stores it, as
    the entry of the plan that lies there and has no capture yet: when its status is done, the
    capture is on the disk and journaled. So a scan may visit the heights of the plan in any
    order, and a killed scan loses nothing; a height that the plan lacks is refused.

    The pixels stay in the session; an event names their file and its SHA-256.

    Parameters
    ----------
    bench
        Open for as long as the device is used.
    plan
        What the session is to hold: one target at one orientation, which is in place. On a
        simulated bench it is placed by ``stage``.
    out
        Folder of the session.
    name
        First part of the keys in events.

    Raises
    ------
    PlanError
        If the plan has several targets to place, or lets the exposure be found automatically.
    """

    parent = None

    def __init__(
        self, bench: Bench, plan: CapturePlan, out: FilePath, *, name: str = "camera"
    ) -> None:
        placements = {entry.placement for entry in plan_entries(plan)}
        if len(placements) > 1:
            raise PlanError(
                f"plan {plan.name} has {len(placements)} targets or orientations; a scan has one: "
                "make a plan and a scan for each"
            )
        if plan.auto_exposure:
            raise PlanError(
                f"plan {plan.name} has auto_exposure, which a scan does not do; set exposure_us",
                keys=("auto_exposure",),
            )
        self.name = name
        self.plan = plan
        self.out = path_of(out, "out")
        self._bench = bench
        self._session: SessionWriter | None = None
        self._step: CaptureStep | None = None
        self._turn = Lock()
        self._unread_mm: float | None = None
        self._values: dict[str, Value] = {}
        self._taken_s = 0.0

    @property
    def hints(self) -> dict[str, list[str]]:
        """The key that a plot of a scan shows."""
        return {"fields": [f"{self.name}_focus_value"]}

    def stage(self) -> list[Any]:
        """Open the session, and place the target of a simulated bench.

        Raises
        ------
        SessionError
            If it is in use, cannot be written, or was made with another plan or bench.
        """
        if self._session is not None:
            raise SessionError(
                f"session {self.out} is open already; unstage {self.name} first", path=self.out
            )
        bench = self._bench
        first = plan_entries(self.plan)[0]
        if bench.is_simulated:
            bench.place(first.target, first.orientation_deg)
        session = SessionWriter(
            self.out,
            plan=self.plan,
            bench=bench.config,
            devices={
                "camera": camera_snapshot(bench.camera),
                "stage": stage_snapshot(bench.stage),
            },
            operator=bench.operator,
        )
        step = CaptureStep(
            self.plan,
            bench.devices,
            interrupted=lambda entry, error: self._journal_error(entry, error),
            utc_now=lambda: datetime.now(UTC),
        )
        try:
            self._require_space(session, step.frames_asked)
        except BaseException:
            session.close()
            raise
        self._session, self._step = session, step
        return [self]

    def unstage(self) -> list[Any]:
        """Release the session; doing so twice is harmless."""
        if self._session is not None:
            self._session.close()
        self._session = self._step = None
        return [self]

    def pending_heights_mm(self) -> list[float]:
        """Heights of the plan without a capture yet, one for each capture, while staged.

        Raises
        ------
        SessionError
            If the session is not open.
        """
        if self._session is None:
            raise SessionError(f"session {self.out} is not open; stage {self.name}", path=self.out)
        return [entry.height_mm for entry in self._session.pending_entries()]

    def trigger(self) -> WorkStatus:
        """Begin a capture at the present height; the status ends once it is stored."""
        return WorkStatus(self._capture, f"{self.name} capture")

    def read(self) -> dict[str, Any]:
        """What the last capture is: its number, file, height, level, focus and light."""
        self._unread_mm = None
        return readings(self._values, self._taken_s)

    def describe(self) -> dict[str, Any]:
        """Descriptions of ``read``."""
        info = self._bench.camera.info
        source = f"standoff:camera/{info.model}/{info.serial_number}"
        signals = {
            "index": Signal(source=source, is_whole=True),
            "file": Signal(source=source, is_text=True),
            "sha256": Signal(source=source, is_text=True),
            "height_mm": Signal(source=source, units="mm", precision=3),
            "mean_dn": Signal(source=source, units="DN", precision=1),
            "noise_dn": Signal(source=source, units="DN", precision=2),
            "saturated_pixels": Signal(source=source, is_whole=True),
            "focus_value": Signal(source=source, precision=6),
            "exposure_us": Signal(source=source, units="us"),
        }
        return described({f"{self.name}_{key}": signal for key, signal in signals.items()})

    def read_configuration(self) -> dict[str, Any]:
        """Settings of the camera that a scan does not change, and the session."""
        settings = self._bench.camera.settings
        return readings(
            {
                f"{self.name}_session": str(self.out.absolute()),
                f"{self.name}_target": self.plan.targets[0].target,
                f"{self.name}_kind": self.plan.targets[0].kind,
                f"{self.name}_frames": self._frames,
                f"{self.name}_pixel_format": settings.pixel_format,
                f"{self.name}_width_px": settings.width_px,
                f"{self.name}_height_px": settings.height_px,
                f"{self.name}_gain_db": math.nan if settings.gain_db is None else settings.gain_db,
                f"{self.name}_black_level_dn": settings.black_level_dn,
            }
        )

    def describe_configuration(self) -> dict[str, Any]:
        """Descriptions of ``read_configuration``."""
        source = "standoff:camera"
        signals = {
            "session": Signal(source=source, is_text=True),
            "target": Signal(source=source, is_text=True),
            "kind": Signal(source=source, is_text=True),
            "frames": Signal(source=source, is_whole=True),
            "pixel_format": Signal(source=source, is_text=True),
            "width_px": Signal(source=source, is_whole=True),
            "height_px": Signal(source=source, is_whole=True),
            "gain_db": Signal(source=source, units="dB"),
            "black_level_dn": Signal(source=source, units="DN"),
        }
        return described({f"{self.name}_{key}": signal for key, signal in signals.items()})

    @property
    def _frames(self) -> int:
        return self.plan.frames_per_capture or self._bench.config.capture.frames_per_capture

    def _capture(self) -> None:
        """Store the capture of one event.

        A scan that is paused during a capture repeats its trigger when it goes on. The capture
        has then been stored, without an event: it is reported, and no other is taken.
        """
        with self._turn:
            session, step = self._session, self._step
            if session is None or step is None:
                raise SessionError(
                    f"session {self.out} is not open; stage {self.name} before it is triggered",
                    path=self.out,
                )
            at_mm = self._bench.asked_mm
            if self._unread_mm != at_mm:
                self._store(session, step, self._entry_at(session, at_mm))
                self._unread_mm = at_mm

    def _store(self, session: SessionWriter, step: CaptureStep, entry: PlanEntry) -> None:
        exposure_us = entry.exposure_us or self._bench.config.camera.exposure_us
        try:
            take = step.capture_here(entry, exposure_us)
        except DeviceError as error:
            self._journal_error(entry, error)
            raise
        others = [capture.record for capture in session.captures if not capture.is_superseded]
        record = session.add_capture(entry, take)
        images = CaptureImages(
            mean_dn=take.averaged.mean_dn, variance_dn2=take.averaged.variance_dn2, record=record
        )
        for finding in check_capture(images, others):
            facts = {"index": entry.index, "capture": record.uid, "operator": self._bench.operator}
            session.journal("note", {"text": f"{finding.problem}: {finding.text}", **facts})
        self._taken_s = take.finished.timestamp()
        self._values = self._facts(record, images)

    def _entry_at(self, session: SessionWriter, at_mm: float) -> PlanEntry:
        """The first entry without a capture at a height."""

        def is_there(entry: PlanEntry) -> bool:
            return round(entry.height_mm - at_mm, HEIGHT_DECIMALS) == 0

        for entry in filter(is_there, session.pending_entries()):
            return entry
        if any(map(is_there, session.entries)):
            raise PlanError(
                f"plan {self.plan.name} has no more captures at {at_mm:.3f} mm; give it repeats, "
                "or take another folder"
            )
        raise PlanError(
            f"plan {self.plan.name} has no capture at {at_mm:.3f} mm; add the height to it, or "
            "visit those that it has"
        )

    def _facts(self, record: CaptureRecord, images: CaptureImages) -> dict[str, Value]:
        assert images.variance_dn2 is not None
        assert record.exposure_us is not None
        assert record.sha256 is not None
        values: dict[str, Value] = {
            "index": record.index,
            "file": record.file,
            "sha256": record.sha256,
            "height_mm": record.height_mm,
            "mean_dn": float(images.mean_dn.mean(dtype=np.float64)),
            "noise_dn": float(np.sqrt(images.variance_dn2.mean(dtype=np.float64))),
            "saturated_pixels": record.saturated_pixels,
            # Flat and dark captures have no focus; an event has a number for every key.
            "focus_value": float("nan") if record.focus_value is None else record.focus_value,
            "exposure_us": record.exposure_us,
        }
        return {f"{self.name}_{key}": value for key, value in values.items()}

    def _journal_error(self, entry: PlanEntry, error: Exception) -> None:
        if self._session is not None:
            facts = {"index": entry.index, "error": type(error).__name__, "message": str(error)}
            self._session.journal("error", facts)

    def _require_space(self, session: SessionWriter, frames: int) -> None:
        settings = self._bench.camera.settings
        pixels = settings.width_px * settings.height_px
        keep_frames = self.plan.keep_frames
        session.require_space(
            sum(
                pixels * bytes_per_pixel(entry, frames, keep_frames=keep_frames)
                for entry in session.pending_entries()
            )
        )
