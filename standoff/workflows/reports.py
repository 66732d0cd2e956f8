"""Writes the reports, as HTML or PDF, whole or not at all."""

import logging
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.session import MANIFEST_NAME, file_sha256
from analysis.reports import (
    Report,
    ReportSection,
    calibration_front,
    calibration_sections,
    calibration_verdicts,
    captures_section,
    device_rows,
    edge_table_section,
    geometry_sections,
    geometry_verdicts,
    noise_section,
    render_report,
    stage_section,
    verdict_section,
    versions,
)
from calibration.edges import EdgeMeasurement
from calibration.geometry import GeometryCalibration
from calibration.psf import PsfCalibration
from standoff.workflows.edge_sources import EdgeSources
from standoff.workflows.output_files import require_pdf, write_file


def pdf_bytes(page: str) -> bytes:
    """Return a report page as the bytes of a PDF file.

    Raises
    ------
    ApplicationError
        If the extra is missing; the message says how to install it.
    """
    require_pdf()
    import weasyprint  # an optional dependency

    for name in ("weasyprint", "fontTools"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    return bytes(weasyprint.HTML(string=page).write_pdf())


def write_calibration_report(
    path: Path,
    psf: PsfCalibration,
    sources: EdgeSources,
    warnings: Iterable[str] = (),
) -> None:
    """Write the report of a PSF calibration, as HTML or PDF.

    Parameters
    ----------
    path
        The file; its suffix chooses the format.
    psf
        The calibration.
    sources
        The photographs of the calibration; of a session, captures, noise and stage are reported
        too.
    warnings
        What the command noted.

    Raises
    ------
    ApplicationError
        If the file cannot be written.
    """

    def load(edge: EdgeMeasurement) -> NDArray[np.floating[Any]]:
        return sources.load(edge.image)

    session = sources.session

    names = list(dict.fromkeys(edge.image for edge in psf.edges))
    subtitle = names[0] if len(names) == 1 else f"{len(names)} photographs"
    before: list[ReportSection] = []
    after: list[ReportSection] = []
    if session is None:
        rows: tuple[tuple[str, str], ...] = ()
    else:
        subtitle = f"Session {session.plan.name}: {subtitle}"
        before = [captures_section(session)]
        after = [s for s in (noise_section(session, psf), stage_section(session)) if s]
        rows = (
            ("session.json", f"sha256 {file_sha256(session.path / MANIFEST_NAME)}"),
            *device_rows(session),
        )
    limits = verdict_section(psf)
    page = render_report(
        Report(
            title="PSF calibration",
            subtitle=subtitle,
            verdicts=calibration_verdicts(psf),
            sections=(
                *([] if limits is None else [limits]),
                *before,
                *calibration_sections(psf, load),
                *after,
                edge_table_section(psf),
            ),
            provenance=(("method", psf.method or ""), *rows, *versions()),
            origin=psf.provenance,
            front=calibration_front(psf, warnings),
        )
    )
    write_page(path, page)


def write_page(path: Path, page: str) -> None:
    """Write one page: as PDF if the file's suffix says so, else as HTML.

    Raises
    ------
    ApplicationError
        If the file cannot be written, or the PDF extra is missing.
    """
    is_pdf = path.suffix.lower() == ".pdf"
    write_file(path, pdf_bytes(page) if is_pdf else page.encode("utf-8"))


def write_geometry_report(path: Path, geometry: GeometryCalibration, subtitle: str) -> None:
    """Write the report of a geometry calibration as one HTML page.

    Raises
    ------
    ApplicationError
        If the file cannot be written.
    """
    page = render_report(
        Report(
            title="Geometry",
            subtitle=subtitle,
            verdicts=geometry_verdicts(geometry),
            sections=geometry_sections(geometry),
            provenance=versions(),
            origin=geometry.provenance,
        )
    )
    write_page(path, page)
