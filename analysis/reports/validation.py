"""The validation report: both tables beside the paper's, both figures, pairs and exclusions."""

from collections.abc import Sequence

import numpy as np

from acquisition.session import Session
from analysis.reports.bench import device_rows
from analysis.reports.page import (
    Report,
    ReportFigure,
    ReportSection,
    ReportTable,
    Verdict,
    render_report,
)
from analysis.reports.session import versions
from analysis.reports.validation_plots import plot_curves, plot_images
from analysis.validation import TABLE_NOTES, ResultTable, ShownPair, Validation, both_tables
from calibration.sharpness import NORMAL_95


def render_validation(session: Session, validation: Validation, shown: Sequence[ShownPair]) -> str:
    """Return the report as one HTML document.

    ``shown``: the images of Figure 2.
    """
    sections = (
        _screening_section(validation),
        ReportSection(
            title="Tables",
            text=TABLE_NOTES,
            tables=tuple(_report_table(table) for table in both_tables(validation)),
        ),
        ReportSection(
            title="Figure 2: processed images",
            figures=(
                ReportFigure.of(
                    plot_images(shown),
                    "The middle of the processed images on the reference's pixels.",
                    form="png",
                ),
            ),
        ),
        ReportSection(
            title="Figure 3: metrics against the zoom-out",
            figures=(
                ReportFigure.of(
                    plot_curves(validation),
                    "Each metric between the reference and a follow-up aligned to it. Dashed: the "
                    "second reference.",
                ),
            ),
        ),
        _fit_section(validation),
        _registration_section(validation),
    )
    return render_report(
        Report(
            title=f"Validation of session {session.plan.name}",
            subtitle=f"{session.path.resolve().name}, captured by {session.manifest.operator}",
            verdicts=_verdicts(validation),
            sections=sections,
            provenance=(
                ("psf", validation.psf),
                ("models", ", ".join(validation.models)),
                ("training steps", str(validation.training_steps)),
                *device_rows(session),
                *versions(),
            ),
            origin=validation.provenance,
        )
    )


def _verdicts(validation: Validation) -> tuple[Verdict, ...]:
    verdicts = [
        Verdict(
            name="pairs compared",
            value=str(len(validation.pairs)),
            remark=f"{len(validation.excluded)} captures excluded",
        )
    ]
    verdicts += [
        Verdict(name=f"{row.model}, {row.alignment}", value=f"MSE {row.mse_dn2:.2f}")
        for row in validation.table_2
        if (row.alignment, row.model) in (("as-in-paper", "paper"), ("followup-grid", "matched"))
    ]
    return tuple(verdicts)


def _screening_section(validation: Validation) -> ReportSection:
    text = ["Every capture was checked for shake and focus, and every pair for its alignment."]
    if not validation.excluded:
        text.append("No capture was excluded.")
    return ReportSection(
        title="Screening",
        text=(*text, *(f"Remark: {remark}." for remark in validation.remarks)),
        tables=(
            ReportTable(
                columns=("capture", "target", "height / mm", "excluded because"),
                rows=tuple(
                    (
                        str(one.capture),
                        one.target,
                        f"{one.height_mm:.3f}",
                        one.reason,
                    )
                    for one in validation.excluded
                ),
            ),
        )
        if validation.excluded
        else (),
    )


def _fit_section(validation: Validation) -> ReportSection:
    known = [pair for pair in validation.pairs if pair.chi2_reduced]
    if not known:
        return ReportSection(
            title="Fit",
            is_folded=True,
            text=("The noise of the captures is not known: they are of a single frame.",),
        )
    return ReportSection(
        title="Fit",
        is_folded=True,
        text=(
            "Mean square of captured minus simulated, over what noise, PSF, focus, alignment and "
            "the error that model lmmse states of itself explain: reduced chi-squared, 1 where "
            "nothing else is left. The worst pairs of the best model come first.",
        ),
        tables=(
            ReportTable(
                columns=("target", "heights / mm", "zoom", *validation.models),
                rows=tuple(
                    (
                        pair.target,
                        f"{pair.reference_height_mm:g} to {pair.followup_height_mm:g}",
                        f"{pair.zoom:.3f}",
                        *(f"{pair.chi2_reduced[model]:.2f}" for model in validation.models),
                    )
                    for pair in sorted(known, key=lambda one: -min(one.chi2_reduced.values()))
                ),
            ),
        ),
    )


def _report_table(table: ResultTable) -> ReportTable:
    return ReportTable(columns=table.columns, rows=(*table.rows, *table.paper), caption=table.title)


def _registration_section(validation: Validation) -> ReportSection:
    reaches_px = [NORMAL_95 * pair.place_err_px for pair in validation.pairs]
    return ReportSection(
        title="Alignment",
        is_folded=True,
        text=(
            f"A pixel's position in the reference is known to ± {np.median(reaches_px):.4f} px "
            f"(median of the pairs) and to ± {max(reaches_px):.4f} px at worst.",
        ),
        tables=(
            ReportTable(
                columns=(
                    "target",
                    "reference / mm",
                    "follow-up / mm",
                    "zoom",
                    "k1",
                    "± k1",
                    "± position / px",
                    "features",
                ),
                rows=tuple(
                    (
                        pair.target,
                        f"{pair.reference_height_mm:.2f}",
                        f"{pair.followup_height_mm:.2f}",
                        f"{pair.zoom:.5f}",
                        f"{pair.k1:+.5f}",
                        f"{NORMAL_95 * pair.k1_err:.5f}",
                        f"{NORMAL_95 * pair.place_err_px:.4f}",
                        str(pair.matches),
                    )
                    for pair in validation.pairs
                ),
            ),
        ),
    )
