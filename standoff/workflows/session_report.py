"""Writes the report of a session."""

from pathlib import Path

from acquisition.session import Session
from analysis.errors import AnalysisError
from analysis.reports import render_session_report
from analysis.validation import Validation, registrations_at_most
from calibration.errors import PsfFileError
from calibration.files import read_psf
from calibration.psf import PsfCalibration
from standoff.terminal import note, print_psf_remarks, remarks_so_far
from standoff.workflows.output_files import RESULTS_FOLDER
from standoff.workflows.provenance import provenance_of
from standoff.workflows.reports import write_page
from standoff.workflows.validation_run import session_validation


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
    psf = read_psf(psf_path) if psf_path.is_file() else None
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
    origin = provenance_of(session, psf_path if psf_path.is_file() else None)
    page = render_session_report(session, psf, validation, remarks, origin, remarks_so_far())
    write_page(path, page)


def _validation(session: Session, psf: PsfCalibration, psf_path: Path) -> Validation:
    name = str(psf_path)
    return session_validation(session, psf.best_psf(name), name)
