"""``standoff benchmark``: the public benchmark's data set, and programs' results on it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option, Typer

from standoff import library, terminal

if TYPE_CHECKING:
    from analysis.benchmark import BenchmarkScores

benchmark = Typer(
    name="benchmark", help="The public benchmark: make its data set, and score programs on it."
)


@benchmark.command("make")
@terminal.command()
def make(
    *,
    out: Path,
    size: library.BenchmarkSize = "small",
    seed: Annotated[int, Option(min=0)] = 1,
    workers: terminal.Workers = 1,
) -> None:
    """Render the benchmark's photographs, tasks and truth.

    Options
    -------
    out: Folder for the set; an existing one is resumed.
    size: tiny: a few MB; small: about 100 MB; full: about 1 GB.
    seed: Seed for everything random; published results are for seed 1.
    """
    made = library.make_benchmark(out, **terminal.keywords_of(library.make_benchmark))
    tasks = ", ".join(f"{count} {track}" for track, count in made.tasks.items())
    said = (
        f"{out}: {made.size} set, seed {made.seed}: tasks {tasks}; {made.files} files, "
        f"{made.bytes / 1e6:.1f} MB ({made.tasks_found_done} tasks already done)"
    )
    terminal.answer(made.to_json, lambda: terminal.say(said, f"sha256 {made.sha256}"))


@benchmark.command("score")
@terminal.command()
def score(
    results: list[Path],
    *,
    data: Path,
    out: Path | None = None,
    force: terminal.Force = False,
) -> None:
    """Score the files that programs wrote against the truth of a data set.

    Options
    -------
    results: Folders of results, one for each program.
    data: Folder of the data set, with its truth.
    out: Folder for scores.json, scores.csv, scores.md and scores.html.
    """
    if out is not None:
        terminal.refuse_replacing(*(out / name for name in library.SCORE_FILES))
    found = library.score_benchmark(results, data, progress=terminal.ShownProgress())
    if out is not None:
        found.write(out)
    document = {"out": None if out is None else str(out), **found.to_json()}
    terminal.answer(document, lambda: _show(found.scores, out), found.notes)


def _show(scores: BenchmarkScores, out: Path | None) -> None:
    from analysis.benchmark import LEGEND, score_tables

    for table in score_tables(scores):
        terminal.print_table(table.title, table.columns, table.marked_rows("*"))
    terminal.say(f"{LEGEND}; * marks the best of a row" if len(scores.programs) > 1 else LEGEND)
    if out is not None:
        terminal.say(f"wrote {', '.join(str(out / name) for name in library.SCORE_FILES)}")
