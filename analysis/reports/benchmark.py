"""The report of programs on the public benchmark: their scores side by side."""

from analysis.benchmark import (
    TITLES,
    BenchmarkScores,
    ScoreTable,
    main_groups,
    parts_of,
    score_figure,
    track_tables,
)
from analysis.benchmark.stored_models import Track
from analysis.reports.page import (
    Report,
    ReportFigure,
    ReportSection,
    ReportTable,
    Verdict,
    in_report_style,
    render_report,
)

plot_scores = in_report_style(score_figure)

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
            best = [col for at, col in table.best if at == row] or [1]
            value = cells[min(best)]
            name = table.columns[min(best)] if len(scores.programs) > 1 else ""
            found.append(Verdict(name=cells[0], value=value.split(" (")[0], remark=name))
    return tuple(found[:_HEADLINES_SHOWN])


def _section(scores: BenchmarkScores, track: Track) -> ReportSection:
    groups = scores.groups(track)
    figures = [
        ReportFigure.of(
            plot_scores(scores, track, measure, [main, *parts_of(groups, main)]),
            "Bars are 95 % intervals over scenes; an open triangle is a value beyond what was "
            "tried.",
        )
        for main in main_groups(groups)
        for measure in scores.measures(track, main)
        if measure.is_headline
    ]
    return ReportSection(
        title=TITLES[track],
        text=(
            "The best value of a row is marked by a star. Values stand beside how much was "
            "answered: an average over what a program chose to answer is none over all.",
        ),
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
