"""A focus sweep from the page: the stage moves, the curve grows, the peak is fitted."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from threading import Lock
from typing import Literal

import numpy as np

from acquisition.bench import BenchConfig, BenchDevices
from acquisition.choices import FEWEST_POSITIONS
from acquisition.errors import OperatorStopError, StreamInterruptedError
from acquisition.exposure_control import ExposureControl
from acquisition.focus import (
    FocusOptions,
    FocusPeak,
    FocusPoint,
    FocusSweep,
    Region,
    SweepRequest,
    sweep_bench,
)
from acquisition.stages import refuse_beyond_limits
from calibration.estimate import NORMAL_95
from calibration.geometry import Levelling, level_by_focus
from standoff.console.camera_service import CameraService
from standoff.console.jobs import Job
from standoff.console.monitors import field_regions
from standoff.console.stage_service import StageService
from standoff.errors import REPORTED_ERRORS, ApplicationError

SweepState = Literal["idle", "running", "done", "failed", "stopped"]

CURVE_POINTS = 81


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SweepPlan:
    """What is swept: between two heights, or the whole travel and then finely if they are None.

    ``has_field`` measures the four regions near the corners as well, for levelling the camera;
    ``ends_at_peak`` moves the stage there.
    """

    heights_mm: tuple[float, float] | None
    steps: int
    options: FocusOptions
    has_field: bool
    ends_at_peak: bool


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SweepView:
    """The sweep that runs, or the last one.

    ``points`` are those of the present pass. ``revision`` increases with every change; ``message``
    says what was found, or why nothing was.
    """

    state: SweepState = "idle"
    message: str = ""
    steps: int = 0
    planned: int = 0
    taken: int = 0
    points: tuple[FocusPoint, ...] = ()
    peak: FocusPeak | None = None
    levelling: Levelling | None = None
    advice: str = ""
    revision: int = 0

    def curve(self) -> tuple[tuple[float, float], ...]:
        """Heights and values of the fitted curve over the points, for drawing."""
        if self.peak is None or not self.points:
            return ()
        heights = [point.height_mm for point in self.points]
        along_mm = np.linspace(min(heights), max(heights), CURVE_POINTS)
        values = self.peak.curve(along_mm)
        return tuple(zip(along_mm.tolist(), values.tolist(), strict=True))


class FocusSweepRun:
    """Runs focus sweeps as jobs, one at a time; ``view`` is the one that runs, or the last one."""

    def __init__(
        self,
        bench: BenchConfig,
        camera: CameraService,
        stage: StageService,
        *,
        clock: Callable[[], float],
    ) -> None:
        self._bench = bench
        self._camera = camera
        self._stage = stage
        self._clock = clock
        self._lock = Lock()
        self.view = SweepView()

    def prepare(self, plan: SweepPlan) -> None:
        """Check a sweep before it begins: too few heights, or one beyond the travel."""
        if plan.steps < FEWEST_POSITIONS:
            raise ApplicationError(f"A sweep needs at least {FEWEST_POSITIONS} heights.")
        if plan.heights_mm is not None:
            low_mm, high_mm = plan.heights_mm
            if not low_mm < high_mm:
                raise ApplicationError("The first height must be below the second.")
            for height_mm in plan.heights_mm:
                refuse_beyond_limits(height_mm, self._bench.stage.limits_mm)

    def work(self, job: Job, plan: SweepPlan) -> None:
        """Sweep; the body of a job."""
        passes = 1 if plan.heights_mm is not None else 2
        with self._lock:
            self.view = SweepView(
                state="running",
                steps=plan.steps,
                planned=passes * plan.steps,
                revision=self.view.revision + 1,
            )
        try:
            found, regions = self._sweep(job, plan)
        except OperatorStopError:
            self._show(state="stopped", message="stopped")
            raise
        except REPORTED_ERRORS as error:
            self._show(state="failed", message=str(error))
            raise
        if found.peak is None:
            self._show(state="failed", message=found.why_not or "no peak", points=found.points)
            return
        levelling = self._levelling(found, regions)
        half_mm = NORMAL_95 * found.peak.err_mm
        message = f"sharpest at {found.peak.height_mm:.3f} ± {half_mm:.3f} mm"
        if found.remark is not None:
            message += f"; {found.remark}"
        self._show(
            state="done",
            message=message,
            points=found.points,
            peak=found.peak,
            levelling=levelling,
            advice=_advice(plan, levelling),
        )

    def _sweep(self, job: Job, plan: SweepPlan) -> tuple[FocusSweep, tuple[Region, ...]]:
        with self._camera.lent(job.check) as camera:
            settings = camera.settings
            # The live picture may have changed the exposure a moment ago. A stream that breaks off
            # is begun again by the first height.
            with suppress(StreamInterruptedError):
                ExposureControl(camera, None, self._clock).settle(settings.exposure_us)
            shape = settings.height_px, settings.width_px
            regions = tuple(field_regions(shape).values()) if plan.has_field else ()
            request = SweepRequest(
                heights_mm=plan.heights_mm,
                steps=plan.steps,
                frames=self._bench.capture.frames_per_capture,
                ends_at_peak=plan.ends_at_peak,
                field=regions,
            )
            devices = BenchDevices(
                config=self._bench,
                camera=camera,
                stage=self._stage.lent(job.check),
                clock=self._clock,
            )
            return sweep_bench(devices, plan.options, request, self._add), regions

    def _add(self, point: FocusPoint) -> None:
        with self._lock:
            view = self.view
            is_new_pass = view.taken % view.steps == 0
            points = (point,) if is_new_pass else (*view.points, point)
            self.view = replace(
                view, points=points, taken=view.taken + 1, revision=view.revision + 1
            )

    def _levelling(self, found: FocusSweep, regions: tuple[Region, ...]) -> Levelling | None:
        """Which side to raise; None where a corner has no peak."""
        peaks = [peak for peak in found.field if peak is not None]
        if found.peak is None or not regions or len(peaks) < len(regions):
            return None
        optics = self._bench.optics
        focal_mm, pitch_um = optics.focal_length_mm, optics.pixel_pitch_um
        return level_by_focus(
            np.array([peak.height_mm for peak in peaks]),
            np.array([peak.err_mm for peak in peaks]),
            np.array([(r.x_px + r.width_px / 2, r.y_px + r.height_px / 2) for r in regions]),
            # The scale at a distance of about the height.
            1e-3 * pitch_um * found.peak.height_mm / focal_mm,
        )

    def _show(self, **changes: object) -> None:
        with self._lock:
            grown = self.view.revision + 1
            self.view = replace(self.view, **changes, revision=grown)  # type: ignore[arg-type]  # names and types are SweepView's


def _advice(plan: SweepPlan, levelling: Levelling | None) -> str:
    """Which side to raise, in words; empty where nobody asked."""
    if not plan.has_field:
        return ""
    if levelling is None:
        return "levelling needs detail in all four corners: use a textured target"
    return levelling.advice
