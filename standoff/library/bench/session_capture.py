"""The run of a capture plan on a bench."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from acquisition.bench import BenchConfig
from acquisition.capture import (
    CaptureProgress,
    Placement,
    QualityFinding,
    RunOperator,
    RunSummary,
    Verdict,
    flicker_warnings,
    run_plan,
)
from acquisition.plan import (
    CapturePlan,
    PlanEntry,
    PlanEstimate,
    estimate_plan,
    plan_entries,
)
from simulation.arguments import checked
from simulation.notebook import Shown
from standoff.library.bench.devices import placement_of
from standoff.library.bench.movable_bench import MovableBench
from standoff.library.bench.plan_preview import bench_config, given_plan
from standoff.library.bench.planned_comparison import PlannedComparisons
from standoff.library.call import Call, Progress
from standoff.library.inputs import FilePath, path_of


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class CapturedSession(Shown, RunSummary):
    """A session, and what one run did for it."""

    session: Path
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the counts as ``standoff capture --json`` prints them."""
        counts = {one.name: getattr(self, one.name) for one in fields(RunSummary)}
        return {"session": str(self.session), **counts}


@checked
def capture_session(
    plan: CapturePlan | FilePath,
    bench: BenchConfig | FilePath,
    out: FilePath,
    *,
    settings: Mapping[str, Any] | None = None,
    operator: str | None = None,
    place: Callable[[PlanEntry], Placement] | None = None,
    review: Callable[[PlanEntry, tuple[QualityFinding, ...]], Verdict] = lambda *_: "keep",
    before_capture: Callable[[], None] = lambda: None,
    ask: Callable[[str], str] | None = None,
    retake: Sequence[int] = (),
    begun: Callable[[PlanEstimate], None] = lambda _: None,
    captured: Callable[[CaptureProgress], None] = lambda _: None,
    progress: Progress | None = None,
) -> CapturedSession:
    """Run a capture plan, or resume an interrupted session.

    Parameters
    ----------
    plan
        A plan, or the path of a plan file.
    bench, settings, operator, ask
        As in ``Bench``: the bench, keys that replace those of its file, the name in the session,
        and who is asked to move a manual stage.
    out
        Folder of the session: new, empty, or the one to resume.
    place
        Called when the target is to be changed or turned; returns ``"ready"`` once it is, or
        ``"skip"``. Without it a real bench takes plans of one target that is in place. A simulated
        bench then places the target itself.
    review
        Called for a capture with a fault; returns ``"keep"`` or ``"retake"``.
    before_capture
        Called before each capture, with the stage at rest; it may wait.
    retake
        Indices of captures to take again.
    begun, captured
        Called with what the plan will take, once the devices are open; and after each capture.
    progress
        Who watches.

    Returns
    -------
    CapturedSession
        How many captures were made; findings about them are among its ``notes``.

    Raises
    ------
    PlanError
        If the plan is not valid, or has several targets and nobody to place them.
    BenchConfigError, DeviceError, ImageFileError, SessionError
        If the bench, a device, a photograph that the plan names or the session is at fault; what
        was captured until then is kept.

    Examples
    --------
    >>> standoff.capture_session("plan.toml", "bench.toml", "coins").captured
    2
    """
    call, path = Call("capture_session", progress), path_of(out, "out")
    config, planned = bench_config(bench, settings), given_plan(plan)
    entries = plan_entries(planned)
    folder = Path() if isinstance(plan, CapturePlan) else path_of(plan, "plan").parent
    comparisons = PlannedComparisons.of(planned, folder, path)
    with MovableBench(config, operator=operator, ask=ask) as opened:
        frame = opened.camera.settings
        begun(estimate_plan(planned, entries, config, (frame.height_px, frame.width_px)))
        for remark in (*opened.warnings, *flicker_warnings(planned, entries, config)):
            call.note(remark)
        with call.bar("capturing", len(entries)) as advance_to:

            def show(done: CaptureProgress) -> None:
                captured(done)
                advance_to(done.captured)
                compared = comparisons.pose_sentence(done.record)
                remarks = [f"{finding.problem}: {finding.text}" for finding in done.findings]
                for remark in (*remarks, *done.remarks, *([compared] if compared else [])):
                    call.note(f"capture {done.entry.index}: {remark}")

            person = RunOperator(
                name=opened.operator,
                place=placement_of(planned, opened.simulated, place),
                progress=show,
                review=review,
                before_capture=before_capture,
            )
            done = run_plan(path, planned, opened.devices, person, retake=retake)
    for said in comparisons.write(progress):
        call.note(said)
    return CapturedSession(session=path, notes=call.notes, **asdict(done))
