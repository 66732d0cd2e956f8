"""The reports of a capture session, and of calibrations of the PSF and the geometry."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.files import Provenance
from acquisition.session import MANIFEST_NAME, Session, file_sha256
from analysis.reports._bench import (
    captures_section,
    device_rows,
    noise_section,
    stage_section,
    versions,
)
from analysis.reports._geometry import geometry_sections, geometry_verdicts
from analysis.reports._page import (
    Report,
    ReportFigure,
    ReportSection,
    ReportTable,
    Verdict,
    present,
)
from analysis.reports._psf import (
    calibration_front,
    calibration_sections,
    calibration_verdicts,
    verdict_section,
)
from analysis.reports._psf_edges import edge_table_section
from analysis.reports._psf_history import HistoryEntry, history_sections
from analysis.reports._validation import plot_curves, plot_furthest
from analysis.validation import Validation, furthest_pair
from calibration.edges import EdgeMeasurement, edges_of_image
from calibration.geometry import GeometryCalibration
from calibration.psf import PsfCalibration, capture_images
from simulation.arrays import Float32Array


def calibration_report(
    psf: PsfCalibration,
    load: Callable[[str], NDArray[np.floating[Any]]],
    session: Session | None = None,
) -> Report:
    """Return the report of a PSF calibration.

    ``load``: returns a photograph by its name, shape ``(rows, cols)``, linear in light.
    ``session``: where the photographs are from: captures, noise and stage are reported, too.
    """
    names = list(dict.fromkeys(edge.image for edge in psf.edges))
    subtitle = names[0] if len(names) == 1 else f"{len(names)} photographs"
    captures: ReportSection | None = None
    bench: tuple[ReportSection, ...] = ()
    rows: tuple[tuple[str, str], ...] = ()
    if session is not None:
        subtitle = f"Session {session.plan.name}: {subtitle}"
        captures, bench = captures_section(session), _bench_sections(session, psf)
        digest = file_sha256(session.path / MANIFEST_NAME)
        rows = (("session.json", f"sha256 {digest}"), *device_rows(session))
    return Report(
        title="PSF calibration",
        subtitle=subtitle,
        verdicts=calibration_verdicts(psf),
        sections=present(
            verdict_section(psf),
            captures,
            *calibration_sections(psf, lambda edge: load(edge.image)),
            *bench,
            edge_table_section(psf),
        ),
        provenance=(("method", psf.method or ""), *rows, *versions()),
        origin=psf.provenance,
        front=calibration_front(psf, psf.notes),
    )


def _bench_sections(session: Session, psf: PsfCalibration | None) -> tuple[ReportSection, ...]:
    return present(noise_section(session, psf), stage_section(session))


def history_report(calibrations: dict[str, list[HistoryEntry]], origin: Provenance) -> Report:
    """Return the report on several calibrations, by camera."""
    count = sum(map(len, calibrations.values()))
    return Report(
        title="PSF history",
        subtitle=f"Calibrations: {count}; cameras: {len(calibrations)}",
        sections=history_sections(calibrations),
        provenance=versions(),
        origin=origin,
    )


def geometry_report(geometry: GeometryCalibration, subtitle: str) -> Report:
    """Return the report of a geometry calibration."""
    return Report(
        title="Geometry",
        subtitle=subtitle,
        verdicts=geometry_verdicts(geometry),
        sections=geometry_sections(geometry),
        provenance=versions(),
        origin=geometry.provenance,
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


def session_report(
    session: Session,
    psf: PsfCalibration | None,
    validation: Validation | None,
    notes: SessionNotes = SessionNotes(),
) -> Report:
    """Return the report of a session.

    ``session``: the session; its edge captures are read again for the figures. ``psf, validation``:
    what has been worked out from it so far; the furthest pair is simulated again for its figure.
    """
    left_out = ReportSection.of("Left out", *notes.remarks) if notes.remarks else None
    sections = [left_out, None if psf is None else verdict_section(psf), captures_section(session)]
    if psf is not None:
        records = {record.file: record for record in session.records}

        def load(edge: EdgeMeasurement) -> Float32Array:
            return session.load(records[edge.image]).mean_dn

        sections += calibration_sections(with_curves(psf, session), load, frozenset(records))
    if validation is not None:
        sections.append(_agreement_section(session, validation, psf))
    sections += [*notes.comparisons, *_bench_sections(session, psf)]
    return Report(
        title=f"Session {session.plan.name}",
        subtitle=f"{session.path.resolve().name}, captured by {session.manifest.operator}",
        verdicts=(
            *(() if psf is None else calibration_verdicts(psf)),
            *(() if validation is None else _agreement_verdicts(validation)),
        ),
        sections=present(*sections, None if psf is None else edge_table_section(psf)),
        provenance=(*device_rows(session), *versions()),
        origin=notes.origin,
        front=None if psf is None else calibration_front(psf, notes.warnings),
        has_uncertainties=psf is not None,
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
    mse = f"MSE {matched.mse_dn2:.2f}"
    return (Verdict("simulated follow-ups", mse, f"model matched{peer}"),)


def _agreement_section(
    session: Session, validation: Validation, psf: PsfCalibration | None
) -> ReportSection:
    """Say how well each model predicts the captured follow-ups: Table II and its figures.

    The furthest pair is drawn where the PSF to simulate it with is at hand.
    """
    furthest = None
    if psf is not None:
        pair = furthest_pair(session, validation, psf.best_psf(validation.psf))
        furthest = ReportFigure.of(
            plot_furthest(pair),
            f"{pair.pair.target} from {pair.pair.zoom:.2f} times further away: "
            "captured, simulated by each model, and their differences.",
            form="png",
        )
    return ReportSection.of(
        "Simulated against captured follow-ups",
        "Each height was simulated from the nearest ones, on the captured follow-up's own "
        "pixels, and compared with what was captured there, after the paper's processing: "
        "normalised to 0 to 255, a Gaussian of sigma 10 px subtracted, centre half. The "
        "captures' own noise is part of the error. validation.json has the other alignments.",
        *(f"Left out: {one.text}." for one in validation.excluded),
        *(f"Remark: {remark}." for remark in validation.remarks),
        ReportTable.of(
            validation.means("followup-grid").items(),
            {
                "model": lambda row: row[0],
                "correlation": lambda row: f"{row[1].correlation:.4f}",
                "MSE": lambda row: f"{row[1].mse_dn2:.2f}",
                "NMI": lambda row: f"{row[1].nmi:.4f}",
                "PSNR / dB": lambda row: f"{row[1].psnr_db:.2f}",
                "PSNR of mean MSE / dB": lambda row: f"{row[1].psnr_of_mean_db:.2f}",
                "SSIM": lambda row: f"{row[1].ssim:.4f}",
            },
            f"Means over {len(validation.pairs)} pairs.",
        ),
        ReportFigure.of(
            plot_curves(validation),
            "Each metric between a reference and a follow-up aligned to it, against the "
            "zoom-out. Dashed: the second reference.",
        ),
        furthest,
    )
