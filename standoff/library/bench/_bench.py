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
from standoff.library.bench._devices import MovableBench, placement_of
from standoff.library.bench._focus import focus_region, pupil_of
from standoff.library.call import FilePath, path_of


class Bench(MovableBench):
    """A camera on a height stage, real or simulated; a context manager that opens and closes both.

    Constructing a bench neither opens nor moves anything. ``with`` opens both devices and closes
    them at its end; in a notebook, call `open` and `close` instead. An error or an interrupt
    during a move stops the stage.

    Parameters
    ----------
    bench
        The path of a bench file, or a `BenchConfig`.
    settings
        Values that override keys of the bench file: ``{"camera.exposure_us": 4000}``.
    operator
        Name of the operator, recorded in the sessions; the login name if None.
    ask
        Function that puts a question to the person who moves a manual stage and returns the
        answer; if None, the question is asked at the terminal.

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
        """Sweep the stage through focus, move to the peak and return the peak with its error.

        The stage is homed if necessary.

        Parameters
        ----------
        heights_mm
            Lowest and highest height of the sweep; if None, the whole travel is swept coarsely
            and then the range about the best height finely.
        steps
            Number of heights, at least 7.
        region
            Part of the frame to use; None for all of it.
        measure
            Focus measure; ``docs/focus.md`` describes them.
        geometry
            Geometry of an earlier session with this lens, or the path of its geometry.json, for
            the position of the entrance pupil. Without it, the error of the peak includes the
            uncertainty of that position.

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
        """Return the mean of several frames at the present height; no file is written.

        Parameters
        ----------
        exposure_us
            Exposure time in us; by default that of the bench file.
        frames
            Number of frames, at least 2; by default ``capture.frames_per_capture`` of the bench
            file.

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
        """Capture one target at each height into a session; the same call resumes a session.

        The stage is homed if necessary. A real target must be in place; a simulated one is placed.

        Parameters
        ----------
        heights_mm
            Heights in mm, in any order; the stage visits them in the order that its approach
            direction (``stage.approach``) requires.
        out
            Folder of the session: new, empty, or the one to resume.
        target, kind, orientation_deg
            Name, kind and orientation of the target under the camera, as in a plan.
        progress
            Called after each capture.

        Returns
        -------
        Session
            The session, with its plan and captures.

        Raises
        ------
        PlanError
            If a height is given twice, or the target has no name.
        StageLimitError
            If a height is outside the travel; raised before anything moves.
        SessionError, DeviceError
            If the session or a device fails; the captures made so far are kept.
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
            Called when a target is to be placed or turned; it returns ``"ready"`` once that is
            done, or ``"skip"`` to leave that target out. Without it, a real bench accepts only
            plans with one target in one orientation, which must be in place already. A simulated
            bench ignores it and places the targets itself.
        retake
            Indices of captures to take again.
        progress
            Called after each capture.

        Raises
        ------
        PlanError
            If the plan is not valid, or needs several placements and ``place`` is not given.
        SessionError, DeviceError
            If the session or a device fails; the captures made so far are kept.
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
    """Return the plan that captures one target, a table of ``[[targets]]``, at several heights.

    ``keys`` are further keys of the plan.
    """
    heights = [float(height) for height in heights_mm]
    table = {"schema": "standoff.plan/1", "name": name, "heights_mm": heights, "targets": [target]}
    return parse_plan({**table, **keys}, source="plan")
