"""``standoff benchmark score``: programs' results against the truth, side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from standoff import library, terminal

if TYPE_CHECKING:
    from analysis.benchmark import BenchmarkScores


def score(
    results: Annotated[
        list[Path],
        Argument(help="Folders of results, one of each program.", show_default=False),
    ],
    *,
    data: Annotated[Path, Option(help="Folder of the data set, with its truth.")],
    out: Annotated[
        Path | None,
        Option(help="Folder for scores.json, scores.csv, scores.md and scores.html."),
    ] = None,
    force: terminal.Force = False,
    json: terminal.Json = False,
) -> None:
    """Score the files that programs wrote against the truth of a data set."""
    if out is not None:
        terminal.refuse_overwriting([out / name for name in library.SCORE_FILES], force=force)
    found = library.score_benchmark(results, data, progress=terminal.ShownProgress())
    if out is not None:
        found.write(out)
    terminal.note_once(found.notes)
    if json:
        terminal.print_json({"out": None if out is None else str(out), **found.to_json()})
        return
    _print(found.scores)
    if out is not None:
        terminal.say(f"wrote {', '.join(str(out / name) for name in library.SCORE_FILES)}")


def _print(scores: BenchmarkScores) -> None:
    from analysis.benchmark import score_tables

    for table in score_tables(scores):
        rows = [
            [f"{cell} *" if (at, column) in table.best else cell for column, cell in enumerate(row)]
            for at, row in enumerate(table.rows)
        ]
        terminal.print_table(table.title, table.columns, rows)
    text = "in brackets 95 % intervals over scenes"
    terminal.say(f"{text}; * is the best of a row" if len(scores.programs) > 1 else text)
