"""Runs a capture plan from begin to end: previewed, captured, its photographs compared."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Self

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
from acquisition.files import RESULTS_FOLDER, make_folder, make_results_folder
from acquisition.photographs import Photograph, read_photograph
from acquisition.plan import CapturePlan, PlanEntry, PlanEstimate, estimate_plan, plan_entries
from acquisition.printable import on_one_line
from acquisition.session import CaptureRecord, Session
from analysis.pose import describe_pose
from calibration.errors import RegistrationError
from calibration.registration import register_images
from simulation.arguments import checked
from simulation.notebook import Shown
from standoff.library.bench._devices import MovableBench, placement_of
from standoff.library.bench._plan_preview import bench_config, given_plan
from standoff.library.call import Call, FilePath, Progress, path_of
from standoff.library.series import find_changes_of_series


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
        As in ``Bench``: the bench, values that override keys of its file, the operator's name, and
        the function that asks the person who moves a manual stage.
    out
        Folder of the session: new, empty, or the one to resume.
    place
        Called when a target is to be placed or turned; it returns ``"ready"`` once that is done, or
        ``"skip"`` to leave that target out. Without it, a real bench accepts only plans with one
        target in one orientation, which must be in place already. A simulated bench places the
        targets itself, after calling ``place`` if it is given.
    review
        Called with the entry and the problems of a capture that is bad enough to retake; it
        returns ``"keep"`` or ``"retake"``.
    before_capture
        Called before each capture, with the stage at rest; it may wait.
    retake
        Indices of captures to take again.
    begun
        Called once the devices are open, with the time and disk space that the plan will take.
    captured
        Called after each capture, with the progress.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    CapturedSession
        How many captures were made; ``notes`` include the problems found with them.

    Raises
    ------
    PlanError
        If the plan is not valid, or needs several placements and ``place`` is not given.
    BenchConfigError, DeviceError, ImageFileError, SessionError
        If the bench file, a device, a photograph that the plan names or the session is at fault;
        the captures made so far are kept.

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


_COMPARISONS_FOLDER = "changes"
"""Folder of a session's results for the comparisons, one folder a target in it."""

Target = tuple[str, str]
"""Kind and name of a target."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedComparisons:
    """What a session's captures are compared with: photographs by kind and name of the target."""

    session: Path
    references: Mapping[Target, Photograph] = field(default_factory=dict)

    @classmethod
    def of(cls, plan: CapturePlan, folder: Path, session: Path) -> Self:
        """Read the photographs that a plan in ``folder`` names."""
        return cls(
            session=session,
            references={
                (target.kind, target.target): read_photograph(folder / target.reference)
                for target in plan.targets
                if target.reference is not None
            },
        )

    def pose_sentence(self, record: CaptureRecord) -> str | None:
        """Say how a capture's pose compares with its reference's; None without a reference."""
        reference = self.references.get((record.kind, record.target))
        if reference is None:
            return None
        capture = Session(self.session).load(record).mean_dn
        name = on_one_line(reference.path.name)
        try:
            found = register_images(reference.grey_dn, capture)
        except RegistrationError as error:
            return f"not recognised in {name}: {error}"
        return f"against {name}: {describe_pose(found.pose)}"

    def write(self, progress: Progress | None = None) -> tuple[str, ...]:
        """Compare all captures with their references; return where the results are.

        Captures that an earlier run compared are not compared again.
        """
        if not self.references:
            return ()
        session = Session(self.session)
        psf = self.session / RESULTS_FOLDER / "psf.json"
        said = []
        for (kind, target), reference in self.references.items():
            captures = tuple(
                self.session / one.record.file
                for one in session.captures
                if (one.record.kind, one.record.target) == (kind, target)
                and not one.is_superseded
                and one.excluded_because is None
            )
            if not captures:
                continue
            out = self.session / RESULTS_FOLDER / _COMPARISONS_FOLDER / _folder_name(kind, target)
            make_results_folder(self.session)
            document = find_changes_of_series(
                reference.path,
                captures,
                make_folder(out),
                psf if psf.is_file() else None,
                progress=progress,
            ).document
            if document is not None:
                lost = f", {document.refused} not recognised" if document.refused else ""
                said.append(
                    f"{target}: {document.changed} of {document.compared} captures differ from "
                    f"{on_one_line(reference.path.name)}{lost}; see "
                    f"{on_one_line(out / 'report.html')}"
                )
        return tuple(said)


def _folder_name(kind: str, target: str) -> str:
    safe = "".join(letter if letter.isalnum() else "-" for letter in target)
    return f"{kind}-{safe}"
