"""Scores the files that programs wrote against the truth of a benchmark data set."""

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from io import StringIO
from typing import TYPE_CHECKING, Any

from acquisition.files import make_folder, write_file, write_page, written_together
from analysis.benchmark import (
    MANIFEST_NAME,
    BenchmarkData,
    BenchmarkScores,
    ProgramFiles,
    Score,
    markdown,
    score_tables,
    scored,
)
from analysis.reports import benchmark_report
from analysis.results_file import write_results
from calibration.documents import json_object
from simulation.arguments import checked
from simulation.notebook import Shown, html_table
from standoff.errors import ArgumentError
from standoff.library.call import Call, FilePath, Progress, listed_paths, path_of

if TYPE_CHECKING:
    from pandas import DataFrame

SCORE_FILES = ("scores.json", "scores.csv", "scores.md", "scores.html")


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ScoredBenchmark(Shown):
    """Scores of programs, side by side, and remarks in ``notes``."""

    scores: BenchmarkScores
    notes: tuple[str, ...] = ()

    def score(self, program: str, track: str, measure: str, group: str = "all") -> Score | None:
        """Return one score, or None where the program has none."""
        wanted = (program, track, group, measure)
        return next(
            (
                one
                for one in self.scores.scores
                if (one.program, one.track, one.group, one.measure) == wanted
            ),
            None,
        )

    def to_json(self) -> dict[str, Any]:
        """Return what scores.json holds."""
        return json_object(self.scores)

    def to_dataframe(self) -> "DataFrame":
        """Return the scores as a pandas table, one row per program, group and measure.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return self.scores.to_dataframe()

    def write(self, folder: FilePath) -> None:
        """Write scores.json, scores.csv, scores.md and scores.html into a folder, all or none.

        Raises
        ------
        ApplicationError, ResultsFileError
            If a file cannot be written.
        """
        out = make_folder(path_of(folder, "folder"))
        with written_together(out / SCORE_FILES[0]) as part:
            write_file(part / "scores.csv", _table(self.scores))
            write_file(part / "scores.md", markdown(self.scores).encode("utf-8"))
            write_page(part / "scores.html", benchmark_report(self.scores).html())
            write_results(part / SCORE_FILES[0], self.scores)

    def _repr_html_(self) -> str:
        tables = score_tables(self.scores)
        return "".join(html_table(one.title, one.columns, one.rows) for one in tables)


@checked
def score_benchmark(
    results: FilePath | Iterable[FilePath],
    data: FilePath,
    *,
    progress: Progress | None = None,
) -> ScoredBenchmark:
    """Score the files that programs wrote for the tasks of a benchmark data set.

    ``docs/benchmark-scoring.md`` says which files those are and what each score means.

    Parameters
    ----------
    results
        Folder of one program's results, or several folders, one per program.
    data
        Folder of the data set, with its truth.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    ScoredBenchmark
        Scores of all programs with their 95 % intervals over scenes.

    Raises
    ------
    ArgumentError
        If no folder of results is given.
    ResultsFileError
        If a file of the data set differs from its manifest, or a file of a program cannot be used.

    Examples
    --------
    A program that refuses to align anything, on the smallest set:

    >>> from pathlib import Path
    >>> data = standoff.make_benchmark("benchmark", size="tiny").out
    >>> Path("cautious").mkdir()
    >>> _ = Path("cautious/alignment.json").write_text("{}")
    >>> found = standoff.score_benchmark("cautious", data)
    >>> found.score("cautious", "alignment", "refused").value
    100.0
    >>> found.write("scores")
    """
    folders = list(listed_paths(results, "results"))
    if not folders:
        raise ArgumentError("expected at least one folder of results", argument="results")
    root = path_of(data, "data")
    known = BenchmarkData(root)
    programs = [ProgramFiles(folder) for folder in folders]
    files = [root / MANIFEST_NAME, *(path for one in programs for path in one.documents())]
    call = Call("score_benchmark", progress, files=files)
    scores = scored(known, programs, call.provenance(), call.bar)
    for one in scores.programs:
        for remark in one.remarks:
            call.note(remark)
    return ScoredBenchmark(scores=scores, notes=call.notes)


def _table(scores: BenchmarkScores) -> bytes:
    text = StringIO()
    table = csv.DictWriter(text, list(Score.model_fields), lineterminator="\n")
    table.writeheader()
    table.writerows(one.model_dump() for one in scores.scores)
    return text.getvalue().encode("utf-8")
