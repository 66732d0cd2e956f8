"""The report of a capture session: what was captured, the PSF, and how well models predict."""

import platform
from importlib.metadata import version

import numpy as np

from acquisition.session import Session
from analysis.comparison_plots import plot_error_by_zoom, plot_processed
from analysis.reports.bench import (
    captures_section,
    device_rows,
    noise_section,
    stage_section,
)
from analysis.reports.page import (
    ReportFigure,
    ReportSection,
    ReportTable,
    Verdict,
    render_report,
)
from analysis.reports.psf import (
    calibration_sections,
    calibration_verdicts,
    edge_table_section,
)
from analysis.series import SeriesComparison
from calibration.edges import EdgeMeasurement
from calibration.psf import PsfCalibration
from simulation import MODELS

__all__ = ["comparison_section", "render_session_report", "versions"]


def render_session_report(
    session: Session,
    psf: PsfCalibration | None,
    comparison: SeriesComparison | None,
    remarks: tuple[str, ...] = (),
) -> str:
    """Return the report of a session as one HTML document.

    Parameters
    ----------
    session
        The session; its edge captures are read again for the figures.
    psf, comparison
        What has been worked out from it so far.
    remarks
        What the report leaves out, and why.

    Raises
    ------
    SessionError
        If a capture file is missing or changed.
    """
    verdicts: tuple[Verdict, ...] = ()
    sections = [captures_section(session)]
    if psf is not None:
        records = {record.file: record for record in session.records}

        def load(edge: EdgeMeasurement) -> "np.ndarray[tuple[int, ...], np.dtype[np.float32]]":
            return session.load(records[edge.image]).mean_dn

        verdicts = calibration_verdicts(psf)
        sections += calibration_sections(psf, load, frozenset(records))
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
    sections += [s for s in (noise_section(session, psf), stage_section(session)) if s]
    if psf is not None:
        sections.append(edge_table_section(psf))
    if remarks:
        sections.insert(0, ReportSection(title="Left out", text=remarks))
    return render_report(
        title=f"Session {session.plan.name}",
        subtitle=f"{session.path.resolve().name}, captured by {session.manifest.operator}",
        verdicts=verdicts,
        sections=tuple(sections),
        provenance=(*device_rows(session), *versions()),
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
            *(f"Left out: {reason}." for reason in comparison.left_out),
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
