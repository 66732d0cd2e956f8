"""The reports on calibrations: of the PSF, of several over time, and of the geometry."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.session import MANIFEST_NAME, Session, file_sha256
from analysis.reports.bench import captures_section, device_rows, noise_section, stage_section
from analysis.reports.geometry import geometry_sections, geometry_verdicts
from analysis.reports.page import Report, ReportSection, render_report
from analysis.reports.psf import (
    HistoryEntry,
    calibration_front,
    calibration_sections,
    calibration_verdicts,
    edge_table_section,
    history_sections,
    verdict_section,
)
from analysis.reports.session import versions
from calibration.geometry import GeometryCalibration
from calibration.provenance import Provenance
from calibration.psf import PsfCalibration


def render_calibration_report(
    psf: PsfCalibration,
    load: Callable[[str], NDArray[np.floating[Any]]],
    session: Session | None = None,
) -> str:
    """Return the report of a PSF calibration as one HTML document.

    ``load``: returns a photograph by its name, shape ``(rows, cols)``, linear in light.
    ``session``: where the photographs are from: captures, noise and stage are reported, too.
    """
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
    return render_report(
        Report(
            title="PSF calibration",
            subtitle=subtitle,
            verdicts=calibration_verdicts(psf),
            sections=(
                *([] if limits is None else [limits]),
                *before,
                *calibration_sections(psf, lambda edge: load(edge.image)),
                *after,
                edge_table_section(psf),
            ),
            provenance=(("method", psf.method or ""), *rows, *versions()),
            origin=psf.provenance,
            front=calibration_front(psf, psf.notes),
        )
    )


def render_history_report(calibrations: dict[str, list[HistoryEntry]], origin: Provenance) -> str:
    """Return the report on several calibrations, by camera, as one HTML document."""
    count = sum(map(len, calibrations.values()))
    return render_report(
        Report(
            title="PSF history",
            subtitle=f"Calibrations: {count}; cameras: {len(calibrations)}",
            verdicts=(),
            sections=history_sections(calibrations),
            provenance=versions(),
            origin=origin,
        )
    )


def render_geometry_report(geometry: GeometryCalibration, subtitle: str) -> str:
    """Return the report of a geometry calibration as one HTML document."""
    return render_report(
        Report(
            title="Geometry",
            subtitle=subtitle,
            verdicts=geometry_verdicts(geometry),
            sections=geometry_sections(geometry),
            provenance=versions(),
            origin=geometry.provenance,
        )
    )
