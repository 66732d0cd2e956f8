"""The reports of a detector's evaluation and of programs on the public benchmark."""

from matplotlib.figure import Figure

from analysis.benchmark import (
    CHOSEN,
    LEGEND,
    TITLES,
    BenchmarkScores,
    ScoreTable,
    Track,
    main_groups,
    parts_of,
    score_figure,
    track_tables,
)
from analysis.changes import changes_figure
from analysis.detectability import curves_figure
from analysis.evaluation import Evaluation, EvaluationCurve, auc_figure, roc_figure
from analysis.pose import limits_figure, pose_figure
from analysis.reports.page import (
    Report,
    ReportFigure,
    ReportSection,
    ReportTable,
    Verdict,
    in_report_style,
    render_report,
)

_plot_scores = in_report_style(score_figure)

_HEADLINES_SHOWN = 6


def render_benchmark_report(scores: BenchmarkScores) -> str:
    """Return the report as one HTML page."""
    names = ", ".join(one.name for one in scores.programs)
    return render_report(
        Report(
            title="Benchmark",
            subtitle=f"{names} on the {scores.data_size} set, seed {scores.data_seed}",
            verdicts=_verdicts(scores),
            sections=tuple(_section(scores, track) for track in scores.tracks),
            provenance=(
                ("data set", f"sha256 {scores.data_sha256}"),
                *(
                    (one.name, " ".join(part for part in (one.version, one.note) if part))
                    for one in scores.programs
                ),
            ),
            origin=scores.provenance,
        )
    )


def _verdicts(scores: BenchmarkScores) -> tuple[Verdict, ...]:
    """The best of each headline, and whose it is."""
    found = []
    for track in scores.tracks:
        main = main_groups(scores.groups(track))[0]
        titles = [one.label for one in scores.measures(track, main) if one.is_headline]
        table = track_tables(scores, track)[0]
        for row, cells in enumerate(table.rows):
            if cells[0] not in titles:
                continue
            best = sorted(col for at, col in table.best if at == row)
            shown = best[0] if best else next(col for col in range(1, len(cells)) if cells[col])
            value = cells[shown].split(" (")[0].split(" [")[0]
            remark = ", ".join(table.columns[col] for col in best)
            found.append(Verdict(name=cells[0], value=value, remark=remark))
    return tuple(found[:_HEADLINES_SHOWN])


def _section(scores: BenchmarkScores, track: Track) -> ReportSection:
    groups = scores.groups(track)
    figures = [
        ReportFigure.of(
            _plot_scores(scores, track, measure, [main, *parts_of(groups, main)]),
            "Bars are 95 % intervals over scenes; an open triangle is a value beyond what was "
            "tried.",
        )
        for main in main_groups(groups)
        for measure in scores.measures(track, main)
        if measure.is_headline
    ]
    return ReportSection(
        title=TITLES[track],
        text=(f"{LEGEND}; a star marks the best value of a row. {CHOSEN}",),
        tables=tuple(_report_table(one) for one in track_tables(scores, track)),
        figures=tuple(figures),
    )


def _report_table(table: ScoreTable) -> ReportTable:
    return ReportTable(
        columns=table.columns,
        rows=tuple(
            tuple(
                f"{cell} ★" if (at, column) in table.best else cell
                for column, cell in enumerate(row)
            )
            for at, row in enumerate(table.rows)
        ),
        caption=table.title,
    )


_plot_auc = in_report_style(auc_figure)
_plot_roc = in_report_style(roc_figure)

_FAILED_SHOWN = 20


def evaluation_figures(evaluation: Evaluation) -> tuple[Figure, Figure, Figure, Figure]:
    """Return the figures beside an evaluation.json, each for a PNG and an SVG."""
    areas, first = _plot_auc(evaluation), _plot_roc(evaluation.curves[0])
    return areas, areas, first, first


def render_evaluation_report(evaluation: Evaluation) -> str:
    """Return the report as one HTML page."""
    first = evaluation.curves[0]
    kinds = "pairs of each kind from every photograph, for each point"
    return render_report(
        Report(
            title="Change detector",
            subtitle=f"{evaluation.detector} on {evaluation.photographs} photographs, "
            f"{evaluation.crops} {kinds}",
            verdicts=tuple(
                Verdict(
                    name=f"AUC at zoom {first.zoom[at]:g}",
                    value=f"{first.auc[at]:.3f}",
                    remark=f"{first.auc_low[at]:.3f} to {first.auc_high[at]:.3f}",
                )
                for at in dict.fromkeys((0, len(first.zoom) // 2, len(first.zoom) - 1))
            ),
            sections=(
                _areas(evaluation),
                *(_curve_section(curve) for curve in evaluation.curves),
                *_failures(evaluation),
            ),
            provenance=(
                ("change", evaluation.change),
                *(
                    [("photographs in colour", str(evaluation.colour_photographs))]
                    if evaluation.colour_photographs
                    else []
                ),
                ("capture model", first.model),
                ("crop", f"{evaluation.crop_px} px"),
                ("focus scatter", f"{evaluation.focus_scatter_px2:g} px²"),
                ("exposure scatter", f"{100 * evaluation.light_scatter:g} %"),
            ),
            origin=evaluation.provenance,
        )
    )


def _areas(evaluation: Evaluation) -> ReportSection:
    whence = (
        "over photographs"
        if all(curve.is_by_photograph for curve in evaluation.curves)
        else "over pairs, as there are too few photographs"
    )
    return ReportSection(
        title="AUC against zoom",
        text=(
            evaluation.note,
            f"Intervals are {whence}. The ideal linear observer knows what changed and where: no "
            "detector that has to search reaches it.",
        ),
        figures=(
            ReportFigure.of(
                _plot_auc(evaluation),
                "Bars are 95 % intervals; dashed is Hotelling's observer with the same change.",
            ),
        ),
    )


def _curve_section(curve: EvaluationCurve) -> ReportSection:
    rows = []
    for at, zoom in enumerate(curve.zoom):
        bound = curve.auc_bound[at]
        rows.append(
            (
                f"{zoom:g}",
                f"{curve.auc[at]:.3f}",
                f"{curve.auc_low[at]:.3f} to {curve.auc_high[at]:.3f}",
                f"{100 * curve.tpr[at]:.0f} %",
                f"{100 * curve.tpr_low[at]:.0f} to {100 * curve.tpr_high[at]:.0f} %",
                f"{curve.average_precision[at]:.3f}",
                "" if bound is None else f"{bound:.3f}",
                str(curve.pairs[at]),
            )
        )
    return ReportSection(
        title=f"Tilt {curve.tilt_deg:g}°, noise {curve.noise_dn:g} DN, "
        f"contrast {curve.contrast_dn:g}",
        tables=(
            ReportTable(
                columns=(
                    *("zoom", "AUC", "95 %", f"found at {100 * curve.fpr:g} % false alarms"),
                    *("95 %", "average precision", "AUC of the bound", "pairs"),
                ),
                rows=tuple(rows),
            ),
        ),
        figures=(
            ReportFigure.of(
                _plot_roc(curve),
                "Changed pairs found against unchanged pairs flagged"
                + (", and changes that a mark lies on against false marks." if curve.froc else "."),
            ),
        ),
    )


def _failures(evaluation: Evaluation) -> tuple[ReportSection, ...]:
    if not evaluation.failed:
        return ()
    return (
        ReportSection(
            title="Pairs without a score",
            is_folded=True,
            text=(f"{evaluation.failed_pairs} pairs; they are left out.",),
            tables=(
                ReportTable(
                    columns=("photograph", "pair", "reason"),
                    rows=tuple(
                        (one.photograph, one.pair, one.message)
                        for one in evaluation.failed[:_FAILED_SHOWN]
                    ),
                    ends_in_words=True,
                ),
            ),
        ),
    )


plot_changes = in_report_style(changes_figure)
plot_detectability = in_report_style(curves_figure)
plot_limits = in_report_style(limits_figure)
plot_pose = in_report_style(pose_figure)
