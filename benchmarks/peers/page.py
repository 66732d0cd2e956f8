"""The page of a run of all programs: who reached what on the public benchmark.

    standoff benchmark score FOLDER/* --data DIR --out SCORES
    python -m benchmarks.peers.page FOLDER --scores SCORES/scores.json --page FILE.md

``FOLDER`` is what ``python -m benchmarks.peers --all`` has written. All values in tables are the
scorer's; ``remarks.md`` beside this module says what explains them.
"""

import argparse
from collections import defaultdict
from pathlib import Path
from statistics import median

from analysis.benchmark.scores import MEASURES, TITLES, BenchmarkScores, ScoredProgram, read_scores
from analysis.benchmark.tables import ScoreTable, main_groups, track_tables
from benchmarks.harness import environment, environment_line
from benchmarks.peers.program import TRACKS, Track
from benchmarks.peers.run import Results

OURS = "standoff"
FEWEST_PEERS = 6
REMARKS = Path(__file__).with_name("remarks.md")

SHOWN: dict[Track, tuple[str, ...]] = {
    "psf": (
        "answered",
        "mtf50_error_median",
        "mtf50_bias",
        "mtf50_error_p95",
        "mtf_error_rms",
        "truth_within_95",
    ),
    "simulation": ("answered", "error_median", "correlation_median"),
    "alignment": (
        "answered",
        "within_0.1_px",
        "within_0.5_px",
        "within_2_px",
        "error_median",
        "unrelated_refused",
        "wrong",
    ),
    "changes": (
        "answered",
        "spots_found",
        "limit_50_dn",
        "limit_80_dn",
        "auc",
        "own_precision",
        "own_recall",
        "own_false_places",
    ),
    "things": (
        "answered",
        "things_found",
        "precision",
        "false_entries",
        "entries_a_thing",
        "told_rightly",
        "unchanged_silent",
        "mirrored_refused",
    ),
}
"""Measures of the tables; scores.md of the scorer has all."""

HEADING = """# Results on the public benchmark

Made by `python -m benchmarks.peers.page`; do not edit. Size {size}, seed {seed}, SHA-256
`{sha256}`; the scores are those of `standoff benchmark score`
([what they mean](benchmark-scoring.md)), in brackets 95 % intervals over scenes, the best of a
column in bold. An average over what a program chose to answer is no average over all: read it
beside how much was answered. Times are processor seconds a task, the median, on

{environment}

No program saw the truth. The pictures were rendered by this project's simulated bench, which shares
no code with what is judged here; our own algorithms were written by those who wrote the benchmark.

    pip install quickMTF "setuptools<81" wheel sfft==1.7.3
    pip install --no-deps pybsm
    standoff benchmark make --out DATA --size {size} --seed {seed}
    python -m benchmarks.peers --all --data DATA --out RESULTS
    standoff benchmark score RESULTS/* --data DATA --out SCORES
    python -m benchmarks.peers.page RESULTS --scores SCORES/scores.json \\
      --page docs/benchmark-results.md
"""


def results_page(folder: Path, scores: BenchmarkScores) -> str:
    """Write the page in Markdown."""
    facts = environment(("numpy", "scipy", "opencv-contrib-python-headless", "scikit-image"))
    parts = [
        HEADING.format(
            size=scores.data_size,
            seed=scores.data_seed,
            sha256=scores.data_sha256,
            environment=environment_line(facts) + ".",
        ),
        REMARKS.read_text("utf-8"),
    ]
    results = {one.name: Results(folder / Path(one.folder).name) for one in scores.programs}
    for track in TRACKS:
        groups = scores.groups(track)
        for number, group in enumerate(main_groups(groups)):
            taking_part = [one for one in scores.programs if _answers(scores, one, track, group)]
            taking_part.sort(key=lambda one: one.name != OURS)
            kept = scores.model_copy(update={"programs": taking_part})
            tables = track_tables(kept, track)
            title = TITLES[track] + (f": {group}" if len(main_groups(groups)) > 1 else "")
            parts += [f"## {title}", _table(tables[number], track, results)]
            parts += _who_is_better(kept, track, number)
            parts += _parts_not_ours(tables[len(main_groups(groups)) :], group)
            parts += _left_out(results, taking_part, track)
            if group == "all":
                silent = [one.name for one in scores.programs if _is_silent(scores, one, track)]
                parts += [f"Without any answer: {', '.join(silent)}."] if silent else []
    given = [
        f"- **{one.name}**{f' ({one.version})' if one.version else ''}: {one.note}."
        for one in scores.programs
    ]
    parts += ["## What each program was given", "\n".join(given)]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _answers(scores: BenchmarkScores, one: ScoredProgram, track: Track, group: str) -> bool:
    """Whether a program answers anything in a group."""
    found = scores.score(one.name, track, group, "answered")
    return found is not None and found.value > 0


def _is_silent(scores: BenchmarkScores, one: ScoredProgram, track: Track) -> bool:
    """Whether a program took part in a track, and answered nothing."""
    found = scores.score(one.name, track, "all", "answered")
    return found is not None and found.value == 0


def _table(table: ScoreTable, track: Track, results: dict[str, Results]) -> str:
    """The scorer's table with a line for each program."""
    labels = _labels(track)
    rows = [number for number, row in enumerate(table.rows) if row[0] in labels]
    names = table.columns[1:-1]
    head = ["", *(table.rows[row][0] for row in rows), "s a task"]
    lines = ["| " + " | ".join(head) + " |", "| --- |" + " ---: |" * (len(head) - 1)]
    for column, name in enumerate(names, 1):
        cells = [
            f"**{table.rows[row][column]}**"
            if (row, column) in table.best
            else table.rows[row][column]
            for row in rows
        ]
        times = [line["processor_s"] for line in results[name].of_track(track) if "answer" in line]
        shown = f"**{name}**" if name == OURS else name
        lines.append(f"| {shown} | " + " | ".join([*cells, f"{median(times):.2f}"]) + " |")
    return "\n".join(lines)


def _labels(track: Track) -> set[str]:
    return {one.label for one in MEASURES[track] if one.name in SHOWN[track]}


def _who_is_better(scores: BenchmarkScores, track: Track, number: int) -> list[str]:
    """Sentences on measures in which a program alone beside ours has the better value."""
    ours, others = scores.programs[0], scores.programs[1:]
    if ours.name != OURS:
        return ["standoff takes no part."]
    better: dict[str, list[str]] = defaultdict(list)
    for other in others:
        pair = scores.model_copy(update={"programs": [ours, other]})
        table = track_tables(pair, track)[number]
        for row, column in sorted(table.best):
            if column == 2:
                better[table.rows[row][0]].append(other.name)
    lines = [
        f"- {label}: {', '.join(names)}"
        for label, names in better.items()
        if label in _labels(track)
    ]
    count = f"{len(others)} peers" + (
        ", as few others are known to us that measure this and can be run"
        if len(others) < FEWEST_PEERS
        else ""
    )
    if not lines:
        return [
            f"No program has a better value than standoff in any column but the time, of {count}."
        ]
    return [f"**Better than standoff**, of {count}:", "\n".join(lines)]


def _parts_not_ours(tables: list[ScoreTable], group: str) -> list[str]:
    """Sentences on the kinds, lenses and so on in which ours is not the best."""
    lines = []
    for table in tables:
        rows = [
            (number, row)
            for number, row in enumerate(table.rows)
            if group == "all" or row[0].startswith(f"{group}, ")
        ]
        lost = []
        for number, row in rows:
            best = [table.columns[column] for at, column in table.best if at == number]
            if best and OURS not in best:
                lost.append(f"{row[0].removeprefix(f'{group}, ')} ({', '.join(sorted(best))})")
        if lost:
            measure = table.title.split(": ", 1)[1]
            lines.append(
                f"{measure}, in {len(rows)} parts: another is best in {len(lost)}: "
                f"{'; '.join(lost)}."
            )
    return lines


def _left_out(
    results: dict[str, Results], programs: list[ScoredProgram], track: Track
) -> list[str]:
    """Sentences on programs that were asked for some of the tasks alone."""
    most = max(len(results[one.name].of_track(track)) for one in programs)
    return [
        f"{one.name} takes long, and answered {len(answered)} tasks alone, in "
        f"{sum(line['processor_s'] for line in answered) / 60:.1f} minutes of the processor. All "
        "others count as not answered."
        for one in programs
        if len(done := results[one.name].of_track(track)) < most
        and (answered := [line for line in done if "answer" in line])
    ]


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.peers.page",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="results of all programs")
    parser.add_argument("--scores", type=Path, required=True, help="scores.json of the scorer")
    parser.add_argument("--page", type=Path, required=True, metavar="FILE", help="page to write")
    given = parser.parse_args()
    page = results_page(given.folder, read_scores(given.scores))
    given.page.write_text(page, "utf-8")


if __name__ == "__main__":
    main()
