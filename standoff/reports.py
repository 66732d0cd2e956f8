"""Writes the HTML reports, whole or not at all."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.atomic_write import atomic_write
from acquisition.session import Session
from analysis.calibration_report import (
    calibration_sections,
    calibration_verdicts,
    edge_table_section,
)
from analysis.report_page import render_report
from analysis.series import compare_series, series_of, write_comparison
from analysis.session_report import render_session_report, versions
from calibration.files import StoredEdge, StoredPsf, psf_document, read_psf
from calibration.psf_calibration import PsfCalibration
from standoff.errors import ApplicationError
from standoff.output import progress_bar

__all__ = [
    "RESULTS_FOLDER",
    "write_calibration_report",
    "write_file",
    "write_page",
    "write_session_report",
]

RESULTS_FOLDER = "results"
"""Folder of a session that holds what was worked out from it."""


def write_calibration_report(
    path: Path,
    calibration: PsfCalibration,
    load_image: Callable[[str], NDArray[np.floating[Any]]],
) -> None:
    """Write the report of a PSF calibration.

    Parameters
    ----------
    path
        The HTML file.
    calibration
        What was measured.
    load_image
        Gives the linear image of a name that stands in the calibration.

    Raises
    ------
    ApplicationError
        If the file cannot be written.
    """
    stored = StoredPsf.model_validate(psf_document(calibration))

    def load(edge: StoredEdge) -> NDArray[np.floating[Any]]:
        return load_image(edge.image)

    names = dict.fromkeys(edge.image for edge in stored.edges)
    subtitle = next(iter(names)) if len(names) == 1 else f"{len(names)} photographs"
    page = render_report(
        title="PSF calibration",
        subtitle=subtitle,
        verdicts=calibration_verdicts(stored),
        sections=(*calibration_sections(stored, load), edge_table_section(stored)),
        provenance=(("method", calibration.method), *versions()),
    )
    write_page(path, page)


def write_session_report(session: Session, path: Path) -> None:
    """Write the report of a session, from what its results folder holds.

    Where the PSF is known and a target was captured at several heights, the captures are
    compared with their simulations, and ``results/comparison.json`` is written too.

    Raises
    ------
    ApplicationError
        If a file cannot be written.
    CalibrationError, AnalysisError, SessionError
        If the results or captures cannot be read or compared.
    """
    results = session.path / RESULTS_FOLDER
    psf_path = results / "psf.json"
    psf = read_psf(psf_path) if psf_path.is_file() else None
    comparison = None
    pairs = sum(len(records) - 1 for records in series_of(session))
    if psf is not None and pairs:
        with progress_bar("comparing heights", pairs) as bar:
            comparison = compare_series(session, psf.total_psf(str(psf_path)), bar.advance_to)
        write_comparison(results / "comparison.json", comparison)
    write_page(path, render_session_report(session, psf, comparison))


def write_page(path: Path, page: str) -> None:
    """Write one HTML page.

    Raises
    ------
    ApplicationError
        If the file cannot be written.
    """
    write_file(path, page.encode("utf-8"))


def make_folder(path: Path) -> Path:
    """Make a folder for results, unless it is there.

    Raises
    ------
    ApplicationError
        If it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ApplicationError(f"cannot make the folder {path}: {error.strerror}") from error
    return path


def write_file(path: Path, data: bytes) -> None:
    """Write a result, whole or not at all.

    Raises
    ------
    ApplicationError
        If the file cannot be written.
    """
    try:
        atomic_write(path, data)
    except OSError as error:
        raise ApplicationError(f"cannot write {path}: {error.strerror}") from error
