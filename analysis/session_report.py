"""The report of a capture session: what was captured, the PSF, and how well models predict."""

import platform
from collections.abc import Mapping
from importlib.metadata import version

import numpy as np

from acquisition.session import Session
from analysis.calibration_report import (
    calibration_sections,
    calibration_verdicts,
    edge_table_section,
)
from analysis.comparison_plots import plot_error_by_zoom, plot_processed
from analysis.report_page import (
    ReportFigure,
    ReportSection,
    ReportTable,
    Verdict,
    render_report,
)
from analysis.series import SeriesComparison
from calibration.files import StoredEdge, StoredPsf
from simulation import MODELS

__all__ = ["comparison_section", "render_session_report", "versions"]


def render_session_report(
    session: Session, psf: StoredPsf | None, comparison: SeriesComparison | None
) -> str:
    """Return the report of a session as one HTML document.

    Parameters
    ----------
    session
        The session; its edge captures are read again for the figures.
    psf, comparison
        What has been worked out from it so far.

    Raises
    ------
    SessionError
        If a capture file is missing or changed.
    """
    verdicts: tuple[Verdict, ...] = ()
    sections = [_captures_section(session)]
    if psf is not None:
        records = {record.file: record for record in session.records}

        def load(edge: StoredEdge) -> "np.ndarray[tuple[int, ...], np.dtype[np.float32]]":
            return session.load(records[edge.image]).mean_dn

        verdicts = calibration_verdicts(psf)
        known = [edge for edge in psf.edges if edge.image in records]
        drawn = psf.model_copy(update={"edges": known})
        sections += calibration_sections(drawn, load)
    if comparison is not None:
        sections.append(comparison_section(comparison))
        mean = comparison.means["matched"]
        verdicts += (
            Verdict(
                name="simulated follow-ups",
                value=f"MSE {mean.mse_dn2:.2f}",
                remark=f"model matched; bicubic {comparison.means['bicubic'].mse_dn2:.2f}",
            ),
        )
    if psf is not None:
        sections.append(edge_table_section(psf))
    return render_report(
        title=f"Session {session.plan.name}",
        subtitle=f"{session.path.resolve().name}, captured by {session.manifest.operator}",
        verdicts=verdicts,
        sections=tuple(sections),
        provenance=(*_devices(session), *versions()),
    )


def comparison_section(comparison: SeriesComparison) -> ReportSection:
    """Say how well each model predicts the captured follow-ups: Table II and its figures."""
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
        for model, mean in ((model, comparison.means[model]) for model in MODELS)
    )
    furthest = max(comparison.pairs, key=lambda pair: pair.comparison.registration.zoom)
    zoom = furthest.comparison.registration.zoom
    return ReportSection(
        title="Simulated against captured follow-ups",
        text=(
            "Each height was simulated from the nearest one and compared with what was captured "
            "there, after the paper's processing: normalised to 0 to 255, a Gaussian of sigma "
            "10 px subtracted, centre half. The captures' own noise is part of the error.",
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
                caption=f"Means over {len(comparison.pairs)} pairs.",
            ),
        ),
        figures=(
            ReportFigure.of(
                plot_error_by_zoom(comparison),
                "Mean squared error against the zoom-out measured between the captures.",
            ),
            ReportFigure.of(
                plot_processed(furthest),
                f"{furthest.reference.target} from {zoom:.2f} times further away: captured, "
                "simulated by each model, and their differences.",
                form="png",
            ),
        ),
    )


def versions() -> tuple[tuple[str, str], ...]:
    """Return the versions of what made the report."""
    names = ("standoff", "numpy", "scipy", "opencv-contrib-python-headless", "scikit-image")
    return (("Python", platform.python_version()), *((name, version(name)) for name in names))


def _captures_section(session: Session) -> ReportSection:
    rows = tuple(
        (
            str(capture.record.index),
            capture.record.kind,
            capture.record.target,
            f"{capture.record.orientation_deg:g}",
            f"{capture.record.height_asked_mm:.3f}",
            f"{capture.record.height_mm:.3f}",
            str(capture.record.frames_used),
            str(capture.record.incomplete_frames),
            str(capture.record.saturated_pixels),
            "" if capture.record.focus_value is None else f"{capture.record.focus_value:.4g}",
            _standing(capture.is_superseded, capture.excluded_because),
        )
        for capture in session.captures
    )
    columns = (
        "capture",
        "kind",
        "target",
        "turn / deg",
        "asked / mm",
        "height / mm",
        "frames",
        "lost",
        "saturated",
        "focus",
        "remarks",
    )
    complete = "complete" if session.is_complete else "not complete: run the capture again"
    return ReportSection(
        title="Captures",
        text=(
            f"{len(session.records)} of {len(session.entries)} planned; {complete}.",
            "Asked is the height the plan asks for, height what was read back; lost counts "
            "incomplete frames that were replaced, saturated the pixels clipped in any frame.",
        ),
        tables=(ReportTable(columns=columns, rows=rows),),
    )


def _standing(is_superseded: bool, excluded_because: str | None) -> str:
    if is_superseded:
        return "superseded"
    return "" if excluded_because is None else f"excluded: {excluded_because}"


def _devices(session: Session) -> tuple[tuple[str, str], ...]:
    return tuple((name, _snapshot(snapshot)) for name, snapshot in session.devices.items())


def _snapshot(snapshot: Mapping[str, object]) -> str:
    parts = (snapshot.get(f"Device{key}") for key in ("VendorName", "ModelName", "SerialNumber"))
    return " ".join(str(part) for part in parts if part)
