"""The validation report: both tables beside the paper's, both figures, pairs and exclusions."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from acquisition.session import Session
from analysis.choices import ValidationModel
from analysis.detectability import MODEL_COLOURS
from analysis.reports._bench import device_rows, versions
from analysis.reports._page import (
    Report,
    ReportFigure,
    ReportSection,
    ReportTable,
    Verdict,
    in_report_style,
    new_figure,
)
from analysis.validation import (
    METRICS,
    TABLE_NOTES,
    ResultTable,
    ShownPair,
    ValidatedPair,
    Validation,
    both_tables,
    drawn_procedure,
)
from calibration.estimate import NORMAL_95

_LABELS = {
    "correlation": "correlation",
    "mse_dn2": "MSE",
    "nmi": "NMI",
    "psnr_db": "PSNR / dB",
    "ssim": "SSIM",
}
_CROP_PX = 130
_FURTHEST_CROP_PX = 140


@in_report_style
def plot_images(shown: Sequence[ShownPair]) -> Figure:
    """Figure 2: reference, captured and simulated follow-ups after the processing.

    One row for every pair; the middle of the processed images, all on the reference's pixels.
    """
    columns = ["reference", "captured", *shown[0].simulated]
    figure = new_figure(1.35 * len(columns) + 0.2, 1.5 * len(shown) + 0.25)
    grid = figure.subplots(len(shown), len(columns), squeeze=False)
    for row, one in zip(grid, shown, strict=True):
        images = [one.reference, one.captured, *one.simulated.values()]
        window = _middle(one.reference.shape, _CROP_PX)
        reach = float(np.percentile(np.abs(one.captured[window]), 99.5))
        for axes, image in zip(row, images, strict=True):
            axes.imshow(image[window], cmap="gray", vmin=-reach, vmax=reach)
            axes.set(xticks=[], yticks=[])
            axes.grid(visible=False)
        row[0].set_ylabel(f"{one.pair.target}, z = {one.pair.zoom:.2f}")
    for axes, name in zip(grid[0], columns, strict=True):
        axes.set_title(name)
    return figure


@in_report_style
def plot_furthest(shown: ShownPair, crop_px: int = _FURTHEST_CROP_PX) -> Figure:
    """Show the middle of the processed capture beside every model's, differences below."""
    window = _middle(shown.captured.shape, crop_px)
    captured = shown.captured[window]
    simulated = {str(model): image[window] for model, image in shown.simulated.items()}
    figure = new_figure(7.3, 3.7)
    grid = figure.subplots(2, 1 + len(simulated))
    reach = float(np.percentile(np.abs(captured), 99.5))
    differences = [image - captured for image in simulated.values()]
    spread = float(np.percentile(np.abs(differences), 99.5))
    images = {"captured": captured} | simulated
    for axes, (name, image) in zip(grid[0], images.items(), strict=True):
        axes.imshow(image, cmap="gray", vmin=-reach, vmax=reach)
        axes.set_title(name)
    grid[1, 0].axis("off")
    grid[1, 0].text(
        0.5,
        0.5,
        f"minus captured,\n−{spread:.1f} to {spread:.1f}\nof 255",
        ha="center",
        va="center",
    )
    for axes, difference in zip(grid[1, 1:], differences, strict=True):
        axes.imshow(difference, cmap="RdBu", vmin=-spread, vmax=spread)
    for axes in grid.flat:
        axes.set(xticks=[], yticks=[])
        axes.grid(visible=False)
    return figure


@in_report_style
def plot_curves(validation: Validation) -> Figure:
    """Figure 3: every metric against the zoom-out, captured and simulated.

    A column for every target; the first reference's curves are drawn solid, the others dashed.
    The paper's three models are scaled up onto the reference, ours made on the follow-up's grid.
    """
    targets = list(dict.fromkeys(_target(pair) for pair in validation.pairs))
    figure = new_figure(2.6 * len(targets) + 0.9, 8.6)
    grid = figure.subplots(len(METRICS), len(targets), sharex=True, squeeze=False)
    for number, target in enumerate(targets):
        pairs = [pair for pair in validation.pairs if _target(pair) == target]
        for metric, axes in zip(METRICS, grid[:, number], strict=True):
            _draw_metric(axes, pairs, metric, validation.models)
            if number == 0:
                axes.set_ylabel(_LABELS[metric])
        grid[0, number].set_title(
            target[0] if target[1] == 0 else f"{target[0]}, {target[1]:g} deg"
        )
        grid[-1, number].set_xlabel("zoom-out z")
    handles, names = grid[0, 0].get_legend_handles_labels()
    figure.legend(
        handles,
        names,
        loc="outside lower center",
        ncols=min(len(names), 2 * grid.shape[1]),
        fontsize=8,
    )
    return figure


def _draw_metric(
    axes: Axes, pairs: list[ValidatedPair], metric: str, models: tuple[ValidationModel, ...]
) -> None:
    references = list(dict.fromkeys(pair.reference for pair in pairs))
    for number, reference in enumerate(references):
        is_first = number == 0
        line = "-" if is_first else "--"
        chosen = [pair for pair in pairs if pair.reference == reference]
        zooms = [pair.zoom for pair in chosen]
        for model in models:
            curve = [
                getattr(pair.of(drawn_procedure(model), model).curve, metric) for pair in chosen
            ]
            label = model if is_first else None
            axes.plot(zooms, curve, line, color=MODEL_COLOURS[model], linewidth=1.2, label=label)
        captured = [getattr(pair.captured_curves["reference-grid"], metric) for pair in chosen]
        axes.plot(
            zooms, captured, line, color="black", marker="o", markersize=3, linewidth=1.0,
            label="captured" if is_first else None,
        )  # fmt: skip


def _target(pair: ValidatedPair) -> tuple[str, float]:
    return pair.target, pair.orientation_deg


def _middle(shape: tuple[int, ...], crop_px: int) -> tuple[slice, slice]:
    side = min(crop_px, *shape)
    top, left = ((size - side) // 2 for size in shape)
    return slice(top, top + side), slice(left, left + side)


def validation_report(
    session: Session, validation: Validation, shown: Sequence[ShownPair]
) -> Report:
    """Return the report; ``shown`` are the images of Figure 2."""
    return Report(
        title=f"Validation of session {session.plan.name}",
        subtitle=f"{session.path.resolve().name}, captured by {session.manifest.operator}",
        verdicts=_verdicts(validation),
        sections=(
            _screening_section(validation),
            ReportSection.of(
                "Tables", *TABLE_NOTES, *(_report_table(one) for one in both_tables(validation))
            ),
            ReportSection.of(
                "Figure 2: processed images",
                ReportFigure.of(
                    plot_images(shown),
                    "The middle of the processed images on the reference's pixels.",
                    form="png",
                ),
            ),
            ReportSection.of(
                "Figure 3: metrics against the zoom-out",
                ReportFigure.of(
                    plot_curves(validation),
                    "Each metric between the reference and a follow-up aligned to it. Dashed: the "
                    "second reference.",
                ),
            ),
            _fit_section(validation),
            _registration_section(validation),
        ),
        provenance=(
            ("psf", validation.psf),
            ("models", ", ".join(validation.models)),
            ("training steps", str(validation.training_steps)),
            *device_rows(session),
            *versions(),
        ),
        origin=validation.provenance,
    )


def _verdicts(validation: Validation) -> tuple[Verdict, ...]:
    left_out = f"{len(validation.excluded)} captures excluded"
    return (
        Verdict("pairs compared", str(len(validation.pairs)), left_out),
        *(
            Verdict(f"{row.model}, {row.alignment}", f"MSE {row.mse_dn2:.2f}")
            for row in validation.table_2
            if (row.alignment, row.model)
            in (("as-in-paper", "paper"), ("followup-grid", "matched"))
        ),
    )


def _screening_section(validation: Validation) -> ReportSection:
    excluded = ReportTable.of(
        validation.excluded,
        {
            "capture": lambda one: str(one.capture),
            "target": lambda one: one.target,
            "height / mm": lambda one: f"{one.height_mm:.3f}",
            "excluded because": lambda one: one.reason,
        },
    )
    return ReportSection.of(
        "Screening",
        "Every capture was checked for shake and focus, and every pair for its alignment.",
        excluded if validation.excluded else "No capture was excluded.",
        *(f"Remark: {remark}." for remark in validation.remarks),
    )


def _fit_section(validation: Validation) -> ReportSection:
    known = [pair for pair in validation.pairs if pair.chi2_reduced]
    if not known:
        text = "The noise of the captures is not known: they are of a single frame."
        return ReportSection.of("Fit", text, is_folded=True)
    rows = tuple(
        (
            pair.target,
            f"{pair.reference_height_mm:g} to {pair.followup_height_mm:g}",
            f"{pair.zoom:.3f}",
            *(f"{pair.chi2_reduced[model]:.2f}" for model in validation.models),
        )
        for pair in sorted(known, key=lambda one: -min(one.chi2_reduced.values()))
    )
    return ReportSection.of(
        "Fit",
        "Mean square of captured minus simulated, over what noise, PSF, focus, alignment and "
        "the error that model lmmse states of itself explain: reduced chi-squared, 1 where "
        "nothing else is left. The worst pairs of the best model come first.",
        ReportTable(columns=("target", "heights / mm", "zoom", *validation.models), rows=rows),
        is_folded=True,
    )


def _report_table(table: ResultTable) -> ReportTable:
    return ReportTable(columns=table.columns, rows=(*table.rows, *table.paper), caption=table.title)


def _registration_section(validation: Validation) -> ReportSection:
    reaches_px = [NORMAL_95 * pair.place_err_px for pair in validation.pairs]
    return ReportSection.of(
        "Alignment",
        f"A pixel's position in the reference is known to ± {np.median(reaches_px):.4f} px "
        f"(median of the pairs) and to ± {max(reaches_px):.4f} px at worst.",
        ReportTable.of(
            validation.pairs,
            {
                "target": lambda pair: pair.target,
                "reference / mm": lambda pair: f"{pair.reference_height_mm:.2f}",
                "follow-up / mm": lambda pair: f"{pair.followup_height_mm:.2f}",
                "zoom": lambda pair: f"{pair.zoom:.5f}",
                "k1": lambda pair: f"{pair.k1:+.5f}",
                "± k1": lambda pair: f"{NORMAL_95 * pair.k1_err:.5f}",
                "± position / px": lambda pair: f"{NORMAL_95 * pair.place_err_px:.4f}",
                "features": lambda pair: str(pair.matches),
            },
        ),
        is_folded=True,
    )
