"""The reports of a capture session, and of calibrations of the PSF and the geometry."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.files import Provenance
from acquisition.session import MANIFEST_NAME, Session, file_sha256
from analysis.reports.bench import (
    captures_section,
    device_rows,
    noise_section,
    stage_section,
    versions,
)
from analysis.reports.geometry import geometry_sections, geometry_verdicts
from analysis.reports.page import (
    Report,
    ReportFigure,
    ReportSection,
    ReportTable,
    Verdict,
    render_report,
)
from analysis.reports.psf import (
    calibration_front,
    calibration_sections,
    calibration_verdicts,
    verdict_section,
)
from analysis.reports.psf_edges import edge_table_section
from analysis.reports.psf_history import HistoryEntry, history_sections
from analysis.reports.validation import plot_curves, plot_furthest
from analysis.validation import ShownPair, Validation, furthest_pair
from calibration.edges import EdgeMeasurement, edges_of_image
from calibration.geometry import GeometryCalibration
from calibration.psf import PsfCalibration, capture_images


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


_SAME_MTF50 = 1e-3  # relative; the digits of a report


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionNotes:
    """What a session's report says beside the session, its PSF and its validation.

    ``remarks``: what the report leaves out, and why. ``warnings``: what the command noted; on the
    front page of a session with a PSF. ``comparisons``: sections on changes and poses that are
    among the results. ``origin``: provenance of the report.
    """

    remarks: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    comparisons: tuple[ReportSection, ...] = ()
    origin: Provenance | None = None


def render_session_report(
    session: Session,
    psf: PsfCalibration | None,
    validation: Validation | None,
    notes: SessionNotes = SessionNotes(),
) -> str:
    """Return the report of a session as one HTML document.

    ``session``: the session; its edge captures are read again for the figures. ``psf, validation``:
    what has been worked out from it so far; the furthest pair is simulated again for its figure.
    """
    verdicts: tuple[Verdict, ...] = ()
    sections = [captures_section(session)]
    front = None
    if psf is not None:
        records = {record.file: record for record in session.records}

        def load(edge: EdgeMeasurement) -> "np.ndarray[tuple[int, ...], np.dtype[np.float32]]":
            return session.load(records[edge.image]).mean_dn

        verdicts = calibration_verdicts(psf)
        front = calibration_front(psf, notes.warnings)
        limits = verdict_section(psf)
        sections = [*([] if limits is None else [limits]), *sections]
        sections += calibration_sections(with_curves(psf, session), load, frozenset(records))
    if validation is not None:
        shown = None
        if psf is not None:
            shown = furthest_pair(session, validation, psf.best_psf(validation.psf))
        sections.append(_agreement_section(validation, shown))
        verdicts += _agreement_verdicts(validation)
    sections += notes.comparisons
    sections += [s for s in (noise_section(session, psf), stage_section(session)) if s]
    if psf is not None:
        sections.append(edge_table_section(psf))
    if notes.remarks:
        sections.insert(0, ReportSection(title="Left out", text=notes.remarks))
    return render_report(
        Report(
            title=f"Session {session.plan.name}",
            subtitle=f"{session.path.resolve().name}, captured by {session.manifest.operator}",
            verdicts=verdicts,
            sections=tuple(sections),
            provenance=(*device_rows(session), *versions()),
            origin=notes.origin,
            front=front,
            has_uncertainties=psf is not None,
        )
    )


def with_curves(psf: PsfCalibration, session: Session) -> PsfCalibration:
    """Return the calibration with the curves of the edges of a session's captures.

    psf.json does not keep them, so the captures are measured again. An edge that does not come back
    with the same MTF50 (of a mosaic, or corrected by maps of the sensor) stays without.
    """
    if psf.channels is not None:
        return psf
    wanted = {edge.image for edge in psf.edges_used if edge.esfr_mtf50_cy_per_px is not None}
    records = [record for record in session.records if record.file in wanted]
    found = {
        (image.name, round(edge.x_px), round(edge.y_px)): edge
        for image in capture_images(session, records)
        for edge in edges_of_image(image)
    }
    return psf.model_copy(update={"edges": tuple(_with_curve(edge, found) for edge in psf.edges)})


def _with_curve(
    edge: EdgeMeasurement, found: Mapping[tuple[str, int, int], EdgeMeasurement]
) -> EdgeMeasurement:
    again = found.get((edge.image, round(edge.x_px), round(edge.y_px)))
    before = edge.esfr_mtf50_cy_per_px
    if again is None or before is None or again.esfr_mtf50_cy_per_px is None:
        return edge
    if not np.isclose(again.esfr_mtf50_cy_per_px, before, rtol=_SAME_MTF50):
        return edge
    return edge.model_copy(update={"esfr": again.esfr, "binned": again.binned})


def _agreement_verdicts(validation: Validation) -> tuple[Verdict, ...]:
    means = validation.means("followup-grid")
    matched, bicubic = means.get("matched"), means.get("bicubic")
    if matched is None:
        return ()
    peer = "" if bicubic is None else f"; bicubic {bicubic.mse_dn2:.2f}"
    return (
        Verdict(
            name="simulated follow-ups",
            value=f"MSE {matched.mse_dn2:.2f}",
            remark=f"model matched{peer}",
        ),
    )


def _agreement_section(validation: Validation, furthest: ShownPair | None) -> ReportSection:
    """Say how well each model predicts the captured follow-ups: Table II and its figures.

    ``furthest`` is drawn where the PSF to simulate it with is at hand.
    """
    rows = tuple(
        (
            model,
            f"{mean.correlation:.4f}",
            f"{mean.mse_dn2:.2f}",
            f"{mean.nmi:.4f}",
            f"{mean.psnr_db:.2f}",
            f"{mean.psnr_of_mean_db:.2f}",
            f"{mean.ssim:.4f}",
        )
        for model, mean in validation.means("followup-grid").items()
    )
    return ReportSection(
        title="Simulated against captured follow-ups",
        text=(
            "Each height was simulated from the nearest ones, on the captured follow-up's own "
            "pixels, and compared with what was captured there, after the paper's processing: "
            "normalised to 0 to 255, a Gaussian of sigma 10 px subtracted, centre half. The "
            "captures' own noise is part of the error. validation.json has the other alignments.",
            *(f"Left out: {one.text}." for one in validation.excluded),
            *(f"Remark: {remark}." for remark in validation.remarks),
        ),
        tables=(
            ReportTable(
                columns=(
                    "model",
                    "correlation",
                    "MSE",
                    "NMI",
                    "PSNR / dB",
                    "PSNR of mean MSE / dB",
                    "SSIM",
                ),
                rows=rows,
                caption=f"Means over {len(validation.pairs)} pairs.",
            ),
        ),
        figures=(
            ReportFigure.of(
                plot_curves(validation),
                "Each metric between a reference and a follow-up aligned to it, against the "
                "zoom-out. Dashed: the second reference.",
            ),
            *([] if furthest is None else [_furthest_figure(furthest)]),
        ),
    )


def _furthest_figure(furthest: ShownPair) -> ReportFigure:
    return ReportFigure.of(
        plot_furthest(furthest),
        f"{furthest.pair.target} from {furthest.pair.zoom:.2f} times further away: "
        "captured, simulated by each model, and their differences.",
        form="png",
    )
