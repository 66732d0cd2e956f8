"""Writes the report of a geometry calibration."""

from pathlib import Path

from analysis.geometry_report import geometry_sections, geometry_verdicts
from analysis.report_page import render_report
from analysis.session_report import versions
from calibration.files import StoredGeometry, geometry_document
from calibration.geometry import GeometryCalibration
from standoff.reports import write_page

__all__ = ["write_geometry_report"]


def write_geometry_report(path: Path, geometry: GeometryCalibration, subtitle: str) -> None:
    """Write the report of a geometry calibration as one HTML page.

    Raises
    ------
    ApplicationError
        If the file cannot be written.
    """
    stored = StoredGeometry.model_validate(geometry_document(geometry))
    page = render_report(
        title="Geometry",
        subtitle=subtitle,
        verdicts=geometry_verdicts(stored),
        sections=geometry_sections(stored),
        provenance=versions(),
    )
    write_page(path, page)
