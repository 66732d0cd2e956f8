"""Scores as tables: programs side by side, one for each group of measures, and breakdowns."""

from collections.abc import Sequence
from dataclasses import dataclass

from analysis.benchmark._data_set import Track
from analysis.benchmark.scores import TITLES, BenchmarkScores, Measure, Score

LEGEND = "In brackets 95 % intervals over scenes; [n]: of the n tasks that were answered"
CHOSEN = (
    "An average over the tasks that a program chose to answer is not an average over all tasks."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreTable:
    """A table of texts; ``best`` are the cells, by row and column, with the best value of a row."""

    track: Track
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    best: frozenset[tuple[int, int]]

    def marked_rows(self, mark: str) -> tuple[tuple[str, ...], ...]:
        """Return the rows, with a mark behind the best values."""
        return tuple(
            tuple(
                f"{cell} {mark}" if (at, column) in self.best else cell
                for column, cell in enumerate(row)
            )
            for at, row in enumerate(self.rows)
        )


def score_tables(scores: BenchmarkScores) -> list[ScoreTable]:
    """Return the tables of all tracks, in their order.

    The first tables of a track have all its measures; those after it show a measure by kind, lens
    and so on.
    """
    return [table for track in scores.tracks for table in track_tables(scores, track)]


def track_tables(scores: BenchmarkScores, track: Track) -> list[ScoreTable]:
    """Return the tables of a track."""
    groups = scores.groups(track)
    tables = [
        _table(
            scores,
            track,
            f"{TITLES[track]}: {group}" if len(main_groups(groups)) > 1 else TITLES[track],
            [(one.label, group, one) for one in scores.measures(track, group)],
        )
        for group in main_groups(groups)
    ]
    for group in main_groups(groups):
        for measure in scores.measures(track, group):
            if measure.is_headline:
                parts = parts_of(groups, group)
                table = _table(
                    scores,
                    track,
                    f"{TITLES[track]}: {measure.label}",
                    [(part, part, measure) for part in parts],
                )
                tables += [table] if table.rows else []
    return tables


def main_groups(groups: Sequence[str]) -> list[str]:
    """The groups of all tasks, or of all edges and of all photographs."""
    return [one for one in groups if one in ("all", "edges", "photographs")]


def parts_of(groups: Sequence[str], main: str) -> list[str]:
    """The groups that a main group is broken down into."""
    others = [one for one in groups if one not in main_groups(groups)]
    return others if main == "all" else [one for one in others if one.startswith(f"{main}, ")]


def markdown(scores: BenchmarkScores) -> str:
    """Return all tables as Markdown, the best value of each row in bold."""
    lines = [
        "# Scores",
        "",
        f"Data set: size {scores.data_size}, seed {scores.data_seed}, SHA-256 "
        f"`{scores.data_sha256}`. {LEGEND}; the best value of a row is bold. "
        f"{CHOSEN}",
    ]
    for one in scores.programs:
        about = " ".join(part for part in (one.version, one.note) if part)
        lines += ["", f"- **{_escaped(one.name)}** {_escaped(about)}".rstrip()]
    for table in score_tables(scores):
        lines += ["", f"## {_escaped(table.title)}", ""]
        lines.append("| " + " | ".join(map(_escaped, table.columns)) + " |")
        lines.append("|" + " --- |" * len(table.columns))
        for at, row in enumerate(table.rows):
            cells = [
                f"**{_escaped(cell)}**" if (at, col) in table.best else _escaped(cell)
                for col, cell in enumerate(row)
            ]
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _value_text(score: Score, measure: Measure) -> str:
    """A value with its interval and, where it is of the tasks answered alone, their number."""
    bound = "" if score.relation == "=" else f"{score.relation} "
    text = f"{bound}{score.value:.{measure.digits}f}"
    is_of_fewer = score.answered < score.tasks and not measure.is_of_all
    fewer = f" [{score.answered}]" if is_of_fewer else ""
    if score.low is None and score.high is None:
        return text + fewer
    low, high = (
        "beyond" if end is None else f"{end:.{measure.digits}f}" for end in (score.low, score.high)
    )
    return f"{text} ({low} to {high}){fewer}"


def _table(
    scores: BenchmarkScores,
    track: Track,
    title: str,
    wanted: Sequence[tuple[str, str, Measure]],
) -> ScoreTable:
    taken = {one.program for one in scores.scores if one.track == track}
    names = [one.name for one in scores.programs if one.name in taken]
    rows: list[tuple[str, ...]] = []
    best: set[tuple[int, int]] = set()
    for label, group, measure in wanted:
        found = [scores.score(name, track, group, measure.name) for name in names]
        if not any(found):
            continue
        known = [one for one in found if one is not None]
        cells = ["" if one is None else _value_text(one, measure) for one in found]
        best |= {
            (len(rows), 1 + column)
            for column, one in enumerate(found)
            if len(known) > 1 and one is not None and _is_best(one, known, measure)
        }
        rows.append((label, *cells, str(known[0].tasks)))
    return ScoreTable(
        track=track,
        title=title,
        columns=("", *names, "tasks"),
        rows=tuple(rows),
        best=frozenset(best),
    )


def _is_best(score: Score, others: Sequence[Score], measure: Measure) -> bool:
    """Whether none is better, and some is worse."""
    ranks = [_badness(one, measure) for one in others]
    return _badness(score, measure) == min(ranks) < max(ranks)


def _badness(score: Score, measure: Measure) -> tuple[bool, float]:
    """Less is better; a bound from below is worse than any value."""
    rounded = round(score.value, measure.digits)
    away = {
        "less": rounded,
        "more": -rounded,
        "near 0": abs(rounded),
        "near 95": abs(rounded - 95),
    }[measure.better]
    return score.relation == ">", away


def _escaped(text: str) -> str:
    marked = "".join(f"\\{letter}" if letter in "\\`*_{}[]<>#|!" else letter for letter in text)
    return " ".join(marked.split())
