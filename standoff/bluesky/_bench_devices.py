"""Stage and camera of a bench as devices of Bluesky, and a scan of heights.

Every trigger of the camera is a capture of one of our sessions.
"""

import math
import time
from collections.abc import Callable, Generator, Mapping
from datetime import UTC, datetime
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any

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
from acquisition.stages import refuse_beyond_limits
from standoff.errors import ApplicationError
from standoff.library import Bench, FilePath, path_of

if TYPE_CHECKING:
    from bluesky.utils import Msg

_TEXT, _WHOLE = {"dtype": "string"}, {"dtype": "integer"}


def _number(units: str | None = None, precision: int | None = None) -> dict[str, Any]:
    """What describes a number: its unit if it has one, and digits to show."""
    stated = {"units": units, "precision": precision}
    return {"dtype": "number"} | {key: value for key, value in stated.items() if value is not None}


def _described(device: str, source: str, signals: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Descriptions of a device's signals, as an event descriptor has them."""
    return {
        f"{device}_{key}": {"source": source, "shape": [], **signal}
        for key, signal in signals.items()
    }


def _readings(
    device: str, values: Mapping[str, float | str], taken_s: float | None = None
) -> dict[str, Any]:
    """Readings of a device, all of one moment: seconds since 1970, now if None."""
    stamp_s = time.time() if taken_s is None else taken_s
    return {
        f"{device}_{key}": {"value": value, "timestamp": stamp_s} for key, value in values.items()
    }


class WorkStatus:
    """Runs a blocking call in a thread of its own; Bluesky's protocol ``Status``.

    Parameters
    ----------
    work
        Done once; an exception it raises is the status's.
    name
        Of the thread.
    """

    def __init__(self, work: Callable[[], object], name: str) -> None:
        self._work = work
        self._error: BaseException | None = None
        self._is_over = Event()
        self._callbacks: list[Callable[[WorkStatus], None]] = []
        self._lock = Lock()
        Thread(target=self._run, name=name, daemon=True).start()

    @property
    def done(self) -> bool:
        """Whether the work has ended, well or not."""
        return self._is_over.is_set()

    @property
    def success(self) -> bool:
        """Whether it has ended without an error."""
        return self.done and self._error is None

    def exception(self, timeout: float | None = 0.0) -> BaseException | None:
        """Return the error of the work, None if it went well.

        Raises
        ------
        TimeoutError
            If it has not ended within ``timeout`` seconds; None waits for ever.
        """
        if not self._is_over.wait(timeout):
            raise TimeoutError(f"not done within {timeout} s")
        return self._error

    def add_callback(self, callback: Callable[["WorkStatus"], None]) -> None:
        """Call this with the status once the work has ended, at once if it has."""
        with self._lock:
            if not self.done:
                self._callbacks.append(callback)
                return
        callback(self)

    def _run(self) -> None:
        try:
            self._work()
        except BaseException as error:  # noqa: BLE001  # whoever waits raises it
            self._error = error
        with self._lock:
            self._is_over.set()
        for callback in self._callbacks:
            callback(self)


class HeightStage:
    """Moves the stage of an open bench: ``Movable``, ``Stoppable``, ``Locatable``, ``Readable``.

    A move outside the travel is refused before the scan begins, where the plan is checked
    (``bluesky.simulators.check_limits``), and before anything moves. The stage must be homed.

    Parameters
    ----------
    bench
        Open for as long as the device is used.
    name
        First part of the keys in events.
    """

    parent = None

    def __init__(self, bench: Bench, *, name: str = "stage") -> None:
        self.name = name
        self._bench = bench
        self._setpoint_mm: float | None = None
        self._move: WorkStatus | None = None

    @property
    def hints(self) -> dict[str, list[str]]:
        """The key that a plot of a scan shows."""
        return {"fields": [f"{self.name}_height_mm"]}

    @property
    def position(self) -> float:
        """Height read back now, in mm, for relative scans."""
        return self._bench.height_mm

    def set(self, height_mm: float) -> WorkStatus:
        """Begin to move to a height; the status ends once the stage has settled there."""
        self._setpoint_mm = float(height_mm)
        self._move = WorkStatus(lambda: self._bench.move(float(height_mm)), f"{self.name} move")
        return self._move

    def check_value(self, height_mm: float) -> None:
        """Refuse a height outside the travel; moves nothing.

        Raises
        ------
        StageLimitError
            With the travel.
        """
        refuse_beyond_limits(height_mm, self._bench.limits_mm)

    def stop(self, *, success: bool = False) -> None:
        """End a move under control; a stage at rest is left alone."""
        if self._move is not None and not self._move.done:
            self._bench.stop()

    def locate(self) -> dict[str, float]:
        """Where the stage was sent, and where it is."""
        height_mm = self._bench.height_mm
        setpoint_mm = height_mm if self._setpoint_mm is None else self._setpoint_mm
        return {"setpoint": setpoint_mm, "readback": height_mm}

    def read(self) -> dict[str, Any]:
        """Height read back and asked for, in mm."""
        place = self.locate()
        values = {"height_mm": place["readback"], "setpoint_mm": place["setpoint"]}
        return _readings(self.name, values)

    def describe(self) -> dict[str, Any]:
        """Descriptions of ``read``."""
        source = f"standoff:stage/{self._bench.stage.info.model}"
        keys = ("height_mm", "setpoint_mm")
        return _described(self.name, source, dict.fromkeys(keys, _number("mm", 3)))

    def read_configuration(self) -> dict[str, Any]:
        """Travel, and tolerance of a move."""
        low_mm, high_mm = self._bench.limits_mm
        tolerance_mm = self._bench.config.stage.tolerance_mm
        values = {"lowest_mm": low_mm, "highest_mm": high_mm, "tolerance_mm": tolerance_mm}
        return _readings(self.name, values)

    def describe_configuration(self) -> dict[str, Any]:
        """Descriptions of ``read_configuration``."""
        signals = dict.fromkeys(("lowest_mm", "highest_mm", "tolerance_mm"), _number("mm", 3))
        return _described(self.name, "standoff:bench file", signals)


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
        self._values: dict[str, float | str] = {}
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
        return _readings(self.name, self._values, self._taken_s)

    def describe(self) -> dict[str, Any]:
        """Descriptions of ``read``."""
        info = self._bench.camera.info
        source = f"standoff:camera/{info.model}/{info.serial_number}"
        signals = {
            "index": _WHOLE,
            "file": _TEXT,
            "sha256": _TEXT,
            "height_mm": _number("mm", 3),
            "mean_dn": _number("DN", 1),
            "noise_dn": _number("DN", 2),
            "saturated_pixels": _WHOLE,
            "focus_value": _number(precision=6),
            "exposure_us": _number("us"),
        }
        return _described(self.name, source, signals)

    def read_configuration(self) -> dict[str, Any]:
        """Settings of the camera that a scan does not change, and the session."""
        settings, target = self._bench.camera.settings, self.plan.targets[0]
        usual_frames = self._bench.config.capture.frames_per_capture
        values: dict[str, float | str] = {
            "session": str(self.out.absolute()),
            "target": target.target,
            "kind": target.kind,
            "frames": self.plan.frames_per_capture or usual_frames,
            "pixel_format": settings.pixel_format,
            "width_px": settings.width_px,
            "height_px": settings.height_px,
            "gain_db": math.nan if settings.gain_db is None else settings.gain_db,
            "black_level_dn": settings.black_level_dn,
        }
        return _readings(self.name, values)

    def describe_configuration(self) -> dict[str, Any]:
        """Descriptions of ``read_configuration``."""
        signals = {
            **dict.fromkeys(("session", "target", "kind", "pixel_format"), _TEXT),
            **dict.fromkeys(("frames", "width_px", "height_px"), _WHOLE),
            "gain_db": _number("dB"),
            "black_level_dn": _number("DN"),
        }
        return _described(self.name, "standoff:camera", signals)

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

    def _facts(self, record: CaptureRecord, images: CaptureImages) -> dict[str, float | str]:
        assert images.variance_dn2 is not None
        assert record.exposure_us is not None
        assert record.sha256 is not None
        return {
            "index": record.index,
            "file": record.file,
            "sha256": record.sha256,
            "height_mm": record.height_mm,
            "mean_dn": float(images.mean_dn.mean(dtype=np.float64)),
            "noise_dn": float(np.sqrt(images.variance_dn2.mean(dtype=np.float64))),
            "saturated_pixels": record.saturated_pixels,
            # Flat and dark captures have no focus; an event has a number for every key.
            "focus_value": math.nan if record.focus_value is None else record.focus_value,
            "exposure_us": record.exposure_us,
        }

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


def height_scan(
    stage: HeightStage, camera: SessionCamera, *, md: dict[str, Any] | None = None
) -> "Generator[Msg, Any, Any]":
    """Visit every height that the camera's session still lacks, with an event for each capture.

    Every height is checked against the travel before anything moves. Run again after an
    interrupt or an error, it resumes the session.

    Parameters
    ----------
    stage, camera
        Of one bench.
    md
        Metadata for the run's start document.

    Raises
    ------
    ApplicationError
        If Bluesky is not installed.
    StageLimitError
        If a height is outside the travel.
    """
    try:
        from bluesky import plan_stubs, preprocessors
    except ImportError as error:
        raise ApplicationError(
            f'a scan needs Bluesky ({error}): pip install "standoff[bluesky]"'
        ) from error
    for entry in plan_entries(camera.plan):
        stage.check_value(entry.height_mm)

    def scan() -> "Generator[Msg, Any, Any]":
        heights_mm = camera.pending_heights_mm()
        facts = {
            "plan_name": "height_scan",
            "detectors": [camera.name],
            "motors": [stage.name],
            "num_points": len(heights_mm),
            "hints": {"dimensions": [(stage.hints["fields"], "primary")]},
            "standoff_plan": camera.plan.to_json(),
            "standoff_session": str(camera.out.absolute()),
        }

        def visit() -> "Generator[Msg, Any, Any]":
            for height_mm in heights_mm:
                yield from plan_stubs.checkpoint()
                yield from plan_stubs.mv(stage, height_mm)
                yield from plan_stubs.trigger_and_read([camera, stage])

        return (yield from preprocessors.run_wrapper(visit(), md={**facts, **(md or {})}))

    return (yield from preprocessors.stage_wrapper(scan(), [camera]))
