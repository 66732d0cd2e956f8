"""scores.json: what programs reach on a data set of the benchmark."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final, Literal

from pydantic import Field

from acquisition.dataframe import dataframe
from analysis.benchmark.estimates import Relation
from analysis.benchmark.measures import MEASURES, Measure
from analysis.benchmark.stored_models import TRACKS, Track
from analysis.errors import ResultsFileError
from analysis.results_file import ResultsDocument, StoredValues
from calibration.documents import read_document
from simulation.arguments import FilePath, checked

if TYPE_CHECKING:
    from pandas import DataFrame

SCORES_SCHEMA: Final = "standoff.benchmark-scores/1"


class Score(StoredValues):
    """One measure of a program, over a group of tasks, with its 95 % interval over scenes.

    ``relation`` is ``>`` or ``<`` where the value is only a bound. An end of the interval is null
    where it is not known. ``answered`` of ``tasks`` gave the value.
    """

    program: str
    track: Track
    group: str
    measure: str
    unit: str
    relation: Relation = "="
    value: float
    low: float | None
    high: float | None
    answered: int
    tasks: int


class ScoredProgram(StoredValues):
    """A program that took part, as its about.json names it; ``remarks`` are of its answers."""

    name: str
    version: str = ""
    note: str = ""
    folder: str
    remarks: list[str] = Field(default=[])


class BenchmarkScores(ResultsDocument):
    """Scores of programs, side by side: the document of scores.json.

    ``data_size``, ``data_seed`` and ``data_sha256`` say which data set, the last one of the
    contents of all its files.
    """

    schema_name: Literal["standoff.benchmark-scores/1"] = Field(
        default=SCORES_SCHEMA, alias="schema"
    )
    data_size: str
    data_seed: int
    data_sha256: str
    programs: list[ScoredProgram] = Field(min_length=1)
    scores: list[Score]

    def __repr__(self) -> str:
        names = ", ".join(one.name for one in self.programs)
        return f"<{len(self.scores)} scores of {names} on the {self.data_size} set>"

    @property
    def tracks(self) -> tuple[Track, ...]:
        """Those in which a program took part."""
        taken = {one.track for one in self.scores}
        return tuple(track for track in TRACKS if track in taken)

    def groups(self, track: Track) -> list[str]:
        """The groups of a track's tasks, in their order."""
        return list(dict.fromkeys(one.group for one in self.scores if one.track == track))

    def measures(self, track: Track, group: str) -> Iterator[Measure]:
        """The measures that a program has in a group."""
        taken = {one.measure for one in self.scores if one.track == track and one.group == group}
        yield from (one for one in MEASURES[track] if one.name in taken)

    def score(self, program: str, track: Track, group: str, measure: str) -> Score | None:
        """One score, or None."""
        wanted = (program, track, group, measure)
        return next(
            (s for s in self.scores if (s.program, s.track, s.group, s.measure) == wanted), None
        )

    def to_dataframe(self) -> "DataFrame":
        """Return the scores as a pandas table, a line for each program, group and measure.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return dataframe(one.model_dump() for one in self.scores)


@checked
def read_scores(path: FilePath) -> BenchmarkScores:
    """Read a scores.json.

    Parameters
    ----------
    path
        Of the file, as the result of ``score_benchmark`` and ``standoff benchmark score`` write it.

    Returns
    -------
    BenchmarkScores
        Scores of programs, side by side.

    Raises
    ------
    ResultsFileError
        If it cannot be read, or is of another schema.

    Examples
    --------
    >>> from pathlib import Path
    >>> data = standoff.make_benchmark("benchmark", size="tiny").out
    >>> Path("cautious").mkdir()
    >>> _ = Path("cautious/alignment.json").write_text("{}")
    >>> standoff.score_benchmark("cautious", data).write("scores")
    >>> [one.name for one in standoff.read_scores("scores/scores.json").programs]
    ['cautious']
    """
    return read_document(
        path, BenchmarkScores, ResultsFileError, "write it with standoff benchmark score"
    )
