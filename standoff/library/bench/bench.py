"""The bench from Python: move, focus, capture, sweep."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import UTC, datetime

from acquisition.capture import CaptureProgress, CaptureStep, Placement, RunOperator, run_plan
from acquisition.choices import CaptureKind, FocusMeasure
from acquisition.focus import FocusOptions, FocusPeak, NoFocusPeakError, SweepRequest, sweep_bench
from acquisition.photographs import BenchCapture
from acquisition.plan import CapturePlan, PlanEntry, load_plan, parse_plan, plan_entries
from acquisition.session import Session
from calibration.edges import Region
from calibration.geometry import GeometryCalibration
from simulation.arguments import checked
from standoff.library.bench.devices import MovableBench, placement_of
from standoff.library.bench.focus import focus_region, pupil_of
from standoff.library.call import FilePath, path_of


class Bench(MovableBench):
    """A camera on a height stage, real or simulated; a context manager that opens and closes both.

    Making one opens nothing and moves nothing; ``with`` opens the devices, and so does `open`,
    for notebooks. Leaving closes them. An error or an interrupt during a move stops the stage.

    Parameters
    ----------
    bench
        The path of a bench file, or what one says.
    settings
        Keys that replace those of the file: ``{"camera.exposure_us": 4000}``.
    operator
        Name in the sessions that it writes; the login name if None.
    ask
        Asks whoever moves a manual stage a question; at the terminal if None.

    Raises
    ------
    TypeError
        If the bench is neither a path nor a config.
    BenchConfigError
        If a key is unknown, missing or out of range; the message names it.

    Examples
    --------
    >>> with standoff.Bench("bench.toml") as bench:
    ...     _ = bench.home()
    ...     near = bench.capture()
    ...     height_mm = bench.move(250.0)
    ...     series = bench.sweep([200, 250, 300], "coins", target="coins", kind="texture")
    >>> round(height_mm, 2), len(series.records)
    (250.0, 3)
    """

    @checked
    def focus(
        self,
        heights_mm: tuple[float, float] | None = None,
        *,
        steps: int = 15,
        region: Region | None = None,
        measure: FocusMeasure = "squared-gradient",
        geometry: GeometryCalibration | FilePath | None = None,
    ) -> FocusPeak:
        """Sweep the stage through the focus, move to the peak and return it with its error.

        The stage is homed if necessary.

        Parameters
        ----------
        heights_mm
            Lowest and highest height; if None, the whole travel, then finely about the best.
        steps
            Number of heights, at least 7.
        region
            Part of the frame to use; None for all of it.
        geometry
            Of an earlier session with this lens, or its geometry.json: where the entrance pupil
            is. Without it that is part of the error.

        Raises
        ------
        NoFocusPeakError
            If there is no peak between the heights; the message says where to look.
        DeviceError
            If a device fails; the stage is stopped first.
        """
        request = SweepRequest(
            heights_mm=heights_mm,
            steps=steps,
            frames=self.config.capture.frames_per_capture,
            ends_at_peak=True,
            pupil=pupil_of(geometry),
        )
        self._asked_mm = None
        self._exposure_control().settle(self.config.camera.exposure_us)
        found = sweep_bench(
            self.devices,
            FocusOptions(measure=measure, region=focus_region(region)),
            request,
            lambda _: None,
        )
        if found.peak is None:
            raise NoFocusPeakError(found.why_not or "no peak")
        return found.peak

    @checked
    def capture(
        self, *, exposure_us: float | None = None, frames: int | None = None
    ) -> BenchCapture:
        """Average some frames at the present height; writes nothing.

        Parameters
        ----------
        exposure_us
            By default that of the bench.
        frames
            By default as the bench says; at least 2.

        Raises
        ------
        DeviceError
            If a device fails, the height is not known or the stage is not at rest.
        """
        target = {"kind": "texture", "target": "capture"}
        plan = height_series("capture", [self.asked_mm], target, frames_per_capture=frames)
        step = CaptureStep(
            plan,
            self.devices,
            interrupted=lambda *_: None,
            utc_now=lambda: datetime.now(UTC),
            exposures=self._exposure_control(),
        )
        (entry,) = plan_entries(plan)
        bench_us = self.config.camera.exposure_us
        take = step.capture_here(entry, bench_us if exposure_us is None else exposure_us)
        averaged = take.averaged
        assert take.focus_value is not None
        return BenchCapture(
            mean_dn=averaged.mean_dn,
            variance_dn2=averaged.variance_dn2,
            height_mm=take.height_mm,
            frames_used=averaged.frames_used,
            settings=take.settings,
            saturated_pixels=averaged.saturated_pixels,
            focus_value=take.focus_value,
        )

    @checked
    def sweep(
        self,
        heights_mm: Iterable[float],
        out: FilePath,
        *,
        target: str,
        kind: CaptureKind,
        orientation_deg: float = 0.0,
        progress: Callable[[CaptureProgress], None] = lambda _: None,
    ) -> Session:
        """Capture one target at each height, as a session; the same call resumes it.

        The stage is homed if necessary. A real target must be in place; a simulated one is placed.

        Parameters
        ----------
        heights_mm
            In any order; the stage visits them from the side of approach.
        out
            Folder of the session: new, empty, or the one to resume.
        target, kind, orientation_deg
            What lies under the camera, as in a plan.
        progress
            Called after each capture.

        Returns
        -------
        Session
            What `Session` reads: plan, captures and files.

        Raises
        ------
        PlanError
            If a height is given twice, or the target has no name.
        StageLimitError
            Before anything moves, if a height is outside the travel.
        SessionError, DeviceError
            As ``standoff capture``; what was captured until then is kept.
        """
        plan = height_series(
            path_of(out, "out").name,
            heights_mm,
            {"kind": kind, "target": target, "orientations_deg": [orientation_deg]},
            order="descending" if self.config.stage.approach == "from_above" else "ascending",
        )
        return self.run(plan, out, progress=progress)

    @checked
    def run(
        self,
        plan: CapturePlan | FilePath,
        out: FilePath,
        *,
        place: Callable[[PlanEntry], Placement] | None = None,
        retake: Sequence[int] = (),
        progress: Callable[[CaptureProgress], None] = lambda _: None,
    ) -> Session:
        """Run a whole capture plan, or resume it; see ``standoff capture``.

        Parameters
        ----------
        plan
            A plan, or the path of a plan file.
        out
            Folder of the session.
        place
            Called when the target is to be changed or turned; returns ``"ready"`` once it is, or
            ``"skip"``. A simulated bench places its own targets. Without it, a real bench
            takes plans of one target that is in place.
        retake
            Indices of captures to take again.
        progress
            Called after each capture.

        Raises
        ------
        PlanError
            If the plan is not valid, or has several targets and nobody to place them.
        SessionError, DeviceError
            As ``standoff capture``; what was captured until then is kept.
        """
        planned = plan if isinstance(plan, CapturePlan) else load_plan(path_of(plan, "plan"))
        placed = placement_of(planned, self.simulated, None if self.is_simulated else place)
        person = RunOperator(name=self.operator, place=placed, progress=progress)
        self._asked_mm = None
        self._exposure_control().settle(self.config.camera.exposure_us)
        run_plan(path_of(out, "out"), planned, self.devices, person, retake=retake)
        return Session(out)


def height_series(
    name: str, heights_mm: Iterable[float], target: Mapping[str, object], **keys: object
) -> CapturePlan:
    """Return the plan of one target, as ``[[targets]]`` describes it, over a series of heights.

    ``keys`` are other keys of the plan.
    """
    heights = [float(height) for height in heights_mm]
    table = {"schema": "standoff.plan/1", "name": name, "heights_mm": heights, "targets": [target]}
    return parse_plan({**table, **keys}, source="plan")
