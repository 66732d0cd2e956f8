"""Writes the report of a session."""

from os.path import lexists
from pathlib import Path

from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from acquisition.session import Session
from analysis.changes import read_changes
from analysis.errors import AnalysisError
from analysis.pose import read_pose
from analysis.reports import (
    ReportSection,
    SessionNotes,
    render_session_report,
    stored_changes_section,
    stored_pose_section,
)
from analysis.validation import Validation, registrations_at_most
from calibration.errors import PsfFileError
from calibration.files import read_psf
from calibration.psf import PsfCalibration
from standoff.terminal import note, print_psf_remarks, remarks_so_far
from standoff.workflows.output_files import RESULTS_FOLDER
from standoff.workflows.provenance import provenance_of
from standoff.workflows.reports import write_page
from standoff.workflows.validation_run import session_validation

_DEPTHS = ("*/", "*/*/", "*/*/*/")
"""Folders below the results in which comparisons are looked for: changes, target, capture."""

_SHOWN = 12


def write_session_report(session: Session, path: Path) -> None:
    """Write the report of a session, from the contents of its results folder.

    If the PSF is known and a target was captured at several heights, the captures are compared
    with their simulations, using ``results/validation.json``, which is written if it is missing
    or out of date.

    Raises
    ------
    ApplicationError
        If a file cannot be written.
    CalibrationError, SessionError
        If the results or captures cannot be read.
    """
    psf_path = session.path / RESULTS_FOLDER / "psf.json"
    psf = read_psf(psf_path) if lexists(psf_path) else None
    # All that is shown is read before anything is written.
    comparisons = _comparisons(session.path / RESULTS_FOLDER)
    if psf is not None and psf.edges:
        print_psf_remarks(psf)
    validation = None
    remarks: tuple[str, ...] = ()
    if psf is not None and registrations_at_most(session, 1):
        try:
            validation = _validation(session, psf, psf_path)
        except (AnalysisError, PsfFileError) as error:
            remarks = (f"No comparison of captured with simulated follow-ups: {error}.",)
            note(f"the report leaves out the comparison of heights: {error}")
    origin = provenance_of(session, None if psf is None else psf_path)
    notes = SessionNotes(
        remarks=remarks,
        warnings=remarks_so_far(),
        comparisons=comparisons,
        origin=origin,
    )
    page = render_session_report(session, psf, validation, notes)
    write_page(path, page)


def _validation(session: Session, psf: PsfCalibration, psf_path: Path) -> Validation:
    name = str(psf_path)
    return session_validation(session, psf.best_psf(name), name)


def _comparisons(results: Path) -> tuple[ReportSection, ...]:
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
        note(f"the report shows {len(sections)} comparisons, {left_out} more are in {results}")
    return tuple(sections)


def _found(results: Path, name: str) -> list[Path]:
    folders = [results, *(folder for depth in _DEPTHS for folder in results.glob(depth))]
    return sorted(path for folder in folders if lexists(path := folder / name))


def _name(path: Path, results: Path) -> str:
    folder = path.parent.relative_to(results)
    return str(folder) if folder.parts else path.name
