"""Writes the report of a session."""

from dataclasses import dataclass
from os.path import lexists
from pathlib import Path
from typing import Any

from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from acquisition.session import Session, verify
from analysis.changes import read_changes
from analysis.errors import AnalysisError
from analysis.pose import read_pose
from analysis.reports import (
    ReportSection,
    SessionNotes,
    psf_remarks,
    render_session_report,
    stored_changes_section,
    stored_pose_section,
)
from analysis.validation import Validation, registrations_at_most
from calibration.errors import PsfFileError
from calibration.files import read_psf
from calibration.psf import PsfCalibration
from simulation.arguments import checked
from simulation.notebook import Shown
from standoff.library.call import Call, Progress
from standoff.library.files import (
    PAGES,
    RESULTS_FOLDER,
    make_results_folder,
    require_writable,
    write_page,
)
from standoff.library.inputs import FilePath, opened_session, output_path
from standoff.library.sessions.validation_run import session_validation

_DEPTHS = ("*/", "*/*/", "*/*/*/")
"""Folders below the results in which comparisons are looked for: changes, target, capture."""

_SHOWN = 12


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class WrittenReport(Shown):
    """A report on a session, and what there is to say of it."""

    session: Path
    report: Path
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the paths as ``standoff report --json`` prints them."""
        return {"session": str(self.session), "report": str(self.report)}


@checked
def write_report(
    session: Session | FilePath, out: FilePath | None = None, *, progress: Progress | None = None
) -> WrittenReport:
    """Write a report on a session and the results obtained from it so far.

    Parameters
    ----------
    session
        A session or its folder.
    out
        The page, HTML or PDF; ``results/report.html`` of the session by default.
    progress
        Who watches.

    Returns
    -------
    WrittenReport
        Where it is.

    Raises
    ------
    ApplicationError
        If a file cannot be written.
    CalibrationError, SessionError
        If the results or captures cannot be read.

    Examples
    --------
    >>> standoff.write_report("session").report.name
    'report.html'
    """
    call, opened = Call("write_report", progress), opened_session(session)
    results = make_results_folder(opened.path)
    page = results / "report.html" if out is None else output_path(out, "out", PAGES)
    require_writable([page])
    if not lexists(results / "psf.json"):
        call.note(
            f"{results / 'psf.json'} is missing: the report shows no PSF; standoff calibrate "
            f"--session {opened.path} --out {results / 'psf.json'} writes it"
        )
    spoilt = [
        check
        for check in verify(opened.path).files
        if check.state in ("missing", "changed") and not check.is_superseded
    ]
    if spoilt:
        call.note(
            f"{len(spoilt)} files of the session are missing or changed, the first "
            f"{spoilt[0].file}; standoff verify {opened.path} lists them"
        )
    write_session_report(call, opened, page)
    return WrittenReport(session=opened.path, report=page, notes=call.notes)


def write_session_report(
    call: Call, session: Session, path: Path, more: tuple[ReportSection, ...] = ()
) -> None:
    """Write the report of a session, from the contents of its results folder, and ``more``.

    If the PSF is known and a target was captured at several heights, the captures are compared
    with their simulations, using ``results/validation.json``, which is written if it is missing
    or out of date.
    """
    psf_path = session.path / RESULTS_FOLDER / "psf.json"
    psf = read_psf(psf_path) if lexists(psf_path) else None
    # All that is shown is read before anything is written.
    comparisons = _comparisons(call, session.path / RESULTS_FOLDER)
    if psf is not None and psf.edges:
        for remark in psf_remarks(psf):
            call.note(remark)
    validation = None
    remarks: tuple[str, ...] = ()
    if psf is not None and registrations_at_most(session, 1):
        try:
            validation = _validation(call, session, psf, psf_path)
        except (AnalysisError, PsfFileError) as error:
            remarks = (f"No comparison of captured with simulated follow-ups: {error}.",)
            call.note(f"the report leaves out the comparison of heights: {error}")
    origin = call.provenance_of(session, None if psf is None else psf_path)
    notes = SessionNotes(
        remarks=remarks,
        warnings=call.notes,
        comparisons=(*comparisons, *more),
        origin=origin,
    )
    page = render_session_report(session, psf, validation, notes)
    write_page(path, page)


def _validation(call: Call, session: Session, psf: PsfCalibration, psf_path: Path) -> Validation:
    name = str(psf_path)
    return session_validation(call, session, psf.best_psf(name), name, psf)


def _comparisons(call: Call, results: Path) -> tuple[ReportSection, ...]:
    """A section for each changes.json and pose.json of the results; of very many, the first."""
    poses, changes = (_found(results, name) for name in ("pose.json", "changes.json"))
    sections = [
        stored_pose_section(_name(path, results), read_pose(path)) for path in poses[:_SHOWN]
    ]
    for path in changes[:_SHOWN]:
        figure = path.with_name("changes-figure.png")
        picture = read_regular_file(figure, LARGEST_IMAGE_BYTES) if figure.is_file() else None
        sections.append(stored_changes_section(_name(path, results), read_changes(path), picture))
    left_out = max(len(poses) - _SHOWN, 0) + max(len(changes) - _SHOWN, 0)
    if left_out:
        call.note(f"the report shows {len(sections)} comparisons, {left_out} more are in {results}")
    return tuple(sections)


def _found(results: Path, name: str) -> list[Path]:
    folders = [results, *(folder for depth in _DEPTHS for folder in results.glob(depth))]
    return sorted(path for folder in folders if lexists(path := folder / name))


def _name(path: Path, results: Path) -> str:
    folder = path.parent.relative_to(results)
    return str(folder) if folder.parts else path.name
