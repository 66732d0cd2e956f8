"""The reports of a detector's evaluation and of programs on the public benchmark."""

from matplotlib.figure import Figure

from analysis.benchmark import (
    CHOSEN,
    LEGEND,
    TITLES,
    BenchmarkScores,
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
from analysis.reports._page import (
    Report,
    ReportFigure,
    ReportSection,
    ReportTable,
    Verdict,
    in_report_style,
    number_text,
    present,
)

_plot_scores = in_report_style(score_figure)

_HEADLINES_SHOWN = 6


def benchmark_report(scores: BenchmarkScores) -> Report:
    """Return the report of programs on the public benchmark."""
    names = ", ".join(one.name for one in scores.programs)
    return Report(
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
            found.append(Verdict(cells[0], value, remark))
    return tuple(found[:_HEADLINES_SHOWN])


def _section(scores: BenchmarkScores, track: Track) -> ReportSection:
    groups = scores.groups(track)
    return ReportSection.of(
        TITLES[track],
        f"{LEGEND}; a star marks the best value of a row. {CHOSEN}",
        *(
            ReportTable(columns=one.columns, rows=one.marked_rows("★"), caption=one.title)
            for one in track_tables(scores, track)
        ),
        *(
            ReportFigure.of(
                _plot_scores(scores, track, measure, [main, *parts_of(groups, main)]),
                "Bars are 95 % intervals over scenes; an open triangle is a value beyond what was "
                "tried.",
            )
            for main in main_groups(groups)
            for measure in scores.measures(track, main)
            if measure.is_headline
        ),
    )


_plot_auc = in_report_style(auc_figure)
_plot_roc = in_report_style(roc_figure)

_FAILED_SHOWN = 20


def evaluation_figures(evaluation: Evaluation) -> tuple[Figure, Figure, Figure, Figure]:
    """Return the figures beside an evaluation.json, each for a PNG and an SVG."""
    areas, first = _plot_auc(evaluation), _plot_roc(evaluation.curves[0])
    return areas, areas, first, first


def evaluation_report(evaluation: Evaluation) -> Report:
    """Return the report of a detector's evaluation."""
    first, in_colour = evaluation.curves[0], evaluation.colour_photographs
    kinds = "pairs of each kind from every photograph, for each point"
    return Report(
        title="Change detector",
        subtitle=f"{evaluation.detector} on {evaluation.photographs} photographs, "
        f"{evaluation.crops} {kinds}",
        verdicts=tuple(
            Verdict(
                f"AUC at zoom {first.zoom[at]:g}",
                f"{first.auc[at]:.3f}",
                f"{first.auc_low[at]:.3f} to {first.auc_high[at]:.3f}",
            )
            for at in dict.fromkeys((0, len(first.zoom) // 2, len(first.zoom) - 1))
        ),
        sections=present(
            _areas(evaluation), *map(_curve_section, evaluation.curves), _failures(evaluation)
        ),
        provenance=present(
            ("change", evaluation.change),
            ("photographs in colour", str(in_colour)) if in_colour else None,
            ("capture model", first.model),
            ("crop", f"{evaluation.crop_px} px"),
            ("focus scatter", f"{evaluation.focus_scatter_px2:g} px²"),
            ("exposure scatter", f"{100 * evaluation.light_scatter:g} %"),
        ),
        origin=evaluation.provenance,
    )


def _areas(evaluation: Evaluation) -> ReportSection:
    whence = (
        "over photographs"
        if all(curve.is_by_photograph for curve in evaluation.curves)
        else "over pairs, as there are too few photographs"
    )
    return ReportSection.of(
        "AUC against zoom",
        evaluation.note,
        f"Intervals are {whence}. The ideal linear observer knows what changed and where: no "
        "detector that has to search reaches it.",
        ReportFigure.of(
            _plot_auc(evaluation),
            "Bars are 95 % intervals; dashed is Hotelling's observer with the same change.",
        ),
    )


def _curve_section(curve: EvaluationCurve) -> ReportSection:
    rows = tuple(
        (
            f"{zoom:g}",
            f"{curve.auc[at]:.3f}",
            f"{curve.auc_low[at]:.3f} to {curve.auc_high[at]:.3f}",
            f"{100 * curve.tpr[at]:.0f} %",
            f"{100 * curve.tpr_low[at]:.0f} to {100 * curve.tpr_high[at]:.0f} %",
            f"{curve.average_precision[at]:.3f}",
            number_text(curve.auc_bound[at], ".3f"),
            str(curve.pairs[at]),
        )
        for at, zoom in enumerate(curve.zoom)
    )
    columns = (
        *("zoom", "AUC", "95 %", f"found at {100 * curve.fpr:g} % false alarms"),
        *("95 %", "average precision", "AUC of the bound", "pairs"),
    )
    marks = ", and changes that a mark lies on against false marks." if curve.froc else "."
    return ReportSection.of(
        f"Tilt {curve.tilt_deg:g}°, noise {curve.noise_dn:g} DN, contrast {curve.contrast_dn:g}",
        ReportTable(columns=columns, rows=rows),
        ReportFigure.of(
            _plot_roc(curve), f"Changed pairs found against unchanged pairs flagged{marks}"
        ),
    )


def _failures(evaluation: Evaluation) -> ReportSection | None:
    if not evaluation.failed:
        return None
    return ReportSection.of(
        "Pairs without a score",
        f"{evaluation.failed_pairs} pairs; they are left out.",
        ReportTable.of(
            evaluation.failed[:_FAILED_SHOWN],
            {
                "photograph": lambda one: one.photograph,
                "pair": lambda one: one.pair,
                "reason": lambda one: one.message,
            },
            ends_in_words=True,
        ),
        is_folded=True,
    )


plot_changes = in_report_style(changes_figure)
plot_detectability = in_report_style(curves_figure)
plot_limits = in_report_style(limits_figure)
plot_pose = in_report_style(pose_figure)
