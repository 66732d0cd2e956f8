"""Scores of programs: measures, estimates with their intervals over scenes, and the document.

Tasks of one scene resemble each other, so whole scenes are drawn, with replacement. The draws
follow from the number of scenes alone: programs are judged on the same draws, and the same files
give the same intervals to the last bit.

References
----------
B. Efron, R. J. Tibshirani, "An Introduction to the Bootstrap", 1993, chapters 8 and 13 (clusters,
percentiles).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from math import nan
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from pydantic import Field

from acquisition.dataframe import dataframe
from analysis.benchmark._data_set import TRACKS, Track
from analysis.errors import ResultsFileError
from analysis.evaluation.roc import share_interval
from analysis.results_file import ResultsDocument, StoredValues
from calibration.documents import read_document
from simulation.arguments import FilePath, checked
from simulation.arrays import FloatArray, IntArray

if TYPE_CHECKING:
    from pandas import DataFrame


Better = Literal["less", "more", "near 0", "near 95"]

EVERYTHING = "all"
ANSWERED = "answered"


@dataclass(frozen=True, slots=True, kw_only=True)
class Measure:
    """A measure of a track, in the order of the tables.

    ``is_headline``: it is shown by group as well. ``is_of_all``: tasks without an answer count.
    """

    name: str
    title: str
    unit: str
    better: Better
    digits: int = 2
    is_headline: bool = False
    is_of_all: bool = False

    @property
    def label(self) -> str:
        """Title and unit."""
        return f"{self.title} / {self.unit}" if self.unit else self.title


def _of_answered(
    name: str, title: str, unit: str, better: Better = "less", digits: int = 2, **flags: bool
) -> Measure:
    return Measure(name=name, title=title, unit=unit, better=better, digits=digits, **flags)


def _of_all(
    name: str, title: str, unit: str, better: Better = "less", digits: int = 2, **flags: bool
) -> Measure:
    return _of_answered(name, title, unit, better, digits, is_of_all=True, **flags)


MEASURES: dict[Track, tuple[Measure, ...]] = {
    "psf": (
        _of_all(ANSWERED, "edges measured", "%", "more", 1),
        _of_answered("mtf50_error_median", "MTF50: median error", "%", is_headline=True),
        _of_answered("mtf50_bias", "MTF50: mean error", "%", "near 0"),
        _of_answered("mtf50_error_p95", "MTF50: 95th percentile of the error", "%"),
        _of_answered("mtf_error_rms", "MTF at 0.1 to 0.5 cy/px: rms error", "", digits=4),
        _of_answered("truth_within_95", "truths within the 95 % stated", "%", "near 95", 1),
    ),
    "simulation": (
        _of_all(ANSWERED, "photographs simulated", "%", "more", 1),
        _of_answered("pixels_predicted", "pixels predicted", "%", "more", 1),
        _of_answered(
            "error_median", "rms error: median over tasks", "% of contrast", is_headline=True
        ),
        _of_answered("correlation_median", "correlation: median over tasks", "", "more", 5),
    ),
    "alignment": (
        _of_all(ANSWERED, "related pairs aligned", "%", "more", 1),
        _of_all("within_0.1_px", "related pairs within 0.1 px", "%", "more", 1),
        _of_all("within_0.5_px", "related pairs within 0.5 px", "%", "more", 1, is_headline=True),
        _of_all("within_2_px", "related pairs within 2 px", "%", "more", 1),
        _of_answered("error_median", "error of those aligned: median", "px", digits=3),
        _of_all("refused", "related pairs refused", "%", digits=1),
        _of_all("unrelated_refused", "unrelated pairs refused", "%", "more", 1),
        _of_all("wrong", "wrong answers", "%", digits=1, is_headline=True),
    ),
    "changes": (
        _of_all(ANSWERED, "pairs judged", "%", "more", 1),
        _of_all("spots_found", "spots found at 1 false place a frame", "%", "more", 1),
        _of_all(
            "limit_50_dn", "50 % are found from an amplitude of", "DN", digits=1, is_headline=True
        ),
        _of_all("limit_80_dn", "80 % are found from an amplitude of", "DN", digits=1),
        _of_all("limit_50_noises", "the same, 50 %, in noises of a pixel", ""),
        _of_all("limit_80_noises", "the same, 80 %, in noises of a pixel", ""),
        _of_all("limit_50_dn_strict", "50 % at 0.1 false places a frame", "DN", digits=1),
        _of_answered("false_places", "false places in a changed frame", "", digits=2),
        _of_answered("auc", "AUC of the largest score", "", "more", 3, is_headline=True),
        _of_all("pixels_found", "changed pixels found at 1e-4 false ones", "%", "more", 1),
        _of_all("own_precision", "own detections: precision", "%", "more", 1),
        _of_all("own_recall", "own detections: recall", "%", "more", 1),
        _of_all("own_false_places", "own detections: false places a frame", "", digits=2),
    ),
    "things": (
        _of_all(ANSWERED, "pairs compared", "%", "more", 1),
        _of_all("things_found", "things found", "%", "more", 1, is_headline=True),
        _of_all("precision", "precision", "%", "more", 1, is_headline=True),
        _of_answered("false_entries", "false entries a pair", ""),
        _of_answered("entries_a_thing", "entries for a thing found", ""),
        _of_answered("told_rightly", "what happened told rightly", "%", "more", 1),
        _of_all(
            "unchanged_silent", "unchanged pairs without an entry", "%", "more", 1, is_headline=True
        ),
        _of_all("mirrored_refused", "mirrored pairs refused", "%", "more", 1),
    ),
}

TITLES: dict[Track, str] = {
    "psf": "Sharpness from photographs",
    "simulation": "Photographs from further away",
    "alignment": "Alignment of two photographs",
    "changes": "Changes between two photographs",
    "things": "Things gone, new, moved or of another colour",
}


DRAWS = 1000
_SEED = 20240
_TAILS = (0.025, 0.975)

Relation = Literal["=", ">", "<"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A value with its 95 % interval.

    ``relation`` says that the value is only a bound where that is all the tasks say. An end of the
    interval is None where it is not known: of a single scene, or beyond what was tried.
    """

    value: float
    low: float | None
    high: float | None
    relation: Relation = "="


def scene_numbers(scenes: Sequence[str]) -> IntArray:
    """Return the number of each task's scene, by the order of the scenes' names."""
    return np.unique(np.array(scenes, dtype=np.str_), return_inverse=True)[1].astype(np.int64)


@cache
def scene_draws(scenes: int, draws: int = DRAWS) -> IntArray:
    """How often each scene is drawn, shape (draws, scenes); every row's sum is ``scenes``."""
    rng = np.random.default_rng(_SEED)
    return rng.multinomial(scenes, np.full(scenes, 1 / scenes), size=draws)


def percentiles(values: FloatArray) -> tuple[float, float]:
    """Ends of the interval in which 95 % of the draws' values lie.

    Values may be infinite; those that are NaN, of draws that say nothing, are left out.
    """
    ordered = np.sort(values[~np.isnan(values)])
    low, high = (ordered[round(tail * (ordered.size - 1))] for tail in _TAILS)
    return float(low), float(high)


def estimate(
    values: FloatArray, scenes: IntArray, statistic: Callable[[FloatArray], float]
) -> Estimate | None:
    """Estimate a statistic of the tasks' values.

    Parameters
    ----------
    values
        One a task, shape (n,) or (n, k).
    scenes
        The number of each task's scene, shape (n,).
    statistic
        Of any choice of rows of ``values``.

    Returns
    -------
    Estimate or None
        None without tasks.
    """
    if not len(values):
        return None
    value = float(statistic(values))
    numbers = np.unique(scenes, return_inverse=True)[1]
    count = int(numbers.max()) + 1
    if count < 2:
        return Estimate(value=value, low=None, high=None)
    drawn = np.array(
        [statistic(np.repeat(values, draw[numbers], axis=0)) for draw in scene_draws(count)]
    )
    low, high = percentiles(drawn)
    return Estimate(value=value, low=low, high=high)


def share(is_hit: Sequence[bool], scenes: IntArray) -> Estimate | None:
    """Estimate a share of the tasks in percent.

    The interval is symmetric in the logit, with the variance between scenes; where no scene differs
    from another it is Clopper and Pearson's of so many scenes, as resampling would then find none.
    """
    if not len(is_hit):
        return None
    hit = np.asarray(is_hit, np.float64)
    numbers = np.unique(scenes, return_inverse=True)[1]
    count = int(numbers.max()) + 1
    value = float(hit.mean())
    away = np.bincount(numbers, hit - value)
    variance = float(np.sum(away**2)) / hit.size**2 * count / max(count - 1, 1)
    return _share_estimate(value, variance, count)


def share_of_sums(sums: FloatArray, scenes: IntArray) -> Estimate | None:
    """Estimate in percent what share the first column's sum is of the second's, shape (n, 2).

    By resampling; where all is found or nothing, as ``share`` does.
    """
    found, total = (float(column.sum()) for column in sums.T)
    if not total > 0:
        return None
    if found in (0.0, total):
        return certain_share(found / total, scenes[sums[:, 1] > 0])
    return estimate(sums, scenes, _percent)


def certain_share(value: float, scenes: IntArray) -> Estimate:
    """Estimate in percent a share that is 0 or 1 in every scene."""
    return _share_estimate(value, 0.0, np.unique(scenes).size)


def _share_estimate(value: float, variance: float, count: int) -> Estimate:
    interval = share_interval(value, variance, count - 1, count)
    return Estimate(value=100 * value, low=100 * interval.low, high=100 * interval.high)


def _percent(sums: FloatArray) -> float:
    """NaN of nothing."""
    total = float(sums[:, 1].sum())
    return 100 * float(sums[:, 0].sum()) / total if total > 0 else nan


_SCORES_SCHEMA: Final = "standoff.benchmark-scores/1"


class Score(StoredValues):
    """One measure of a program, over a group of tasks, with its 95 % interval over scenes.

    ``relation`` is ``>`` or ``<`` where ``value`` is only a bound. ``low`` and ``high`` are null
    where they are not known. The value is over ``answered`` of the ``tasks`` in the group.
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
    """A program that took part, as its about.json names it; ``remarks`` are on its answers."""

    name: str
    version: str = ""
    note: str = ""
    folder: str
    remarks: list[str] = Field(default=[])


class BenchmarkScores(ResultsDocument):
    """Scores of programs, side by side: the document of scores.json.

    ``data_size``, ``data_seed`` and ``data_sha256`` identify the data set; the last is the hash of
    the contents of all its files.
    """

    schema_name: Literal["standoff.benchmark-scores/1"] = Field(
        default=_SCORES_SCHEMA, alias="schema"
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
        """The tracks in which any program took part."""
        taken = {one.track for one in self.scores}
        return tuple(track for track in TRACKS if track in taken)

    def groups(self, track: Track) -> list[str]:
        """The groups of tasks in a track, in the order of ``scores``."""
        return list(dict.fromkeys(one.group for one in self.scores if one.track == track))

    def measures(self, track: Track, group: str) -> Iterator[Measure]:
        """The measures for which any program has a score in a group."""
        taken = {one.measure for one in self.scores if one.track == track and one.group == group}
        yield from (one for one in MEASURES[track] if one.name in taken)

    def score(self, program: str, track: Track, group: str, measure: str) -> Score | None:
        """One score of a program, None if it has none."""
        wanted = (program, track, group, measure)
        return next(
            (s for s in self.scores if (s.program, s.track, s.group, s.measure) == wanted), None
        )

    def to_dataframe(self) -> "DataFrame":
        """Return the scores as a pandas table, one row per program, group and measure.

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
        Path of the file, as the result of ``score_benchmark`` or ``standoff benchmark score``
        writes it.

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


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreList:
    """The scores of a program in a track, as they are found, and what there is to remark."""

    program: str
    track: Track
    scores: list[Score] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def add(
        self, group: str, measure: str, found: Estimate | None, answered: int, tasks: int
    ) -> None:
        """Add a score, unless there is no estimate."""
        if found is None:
            return
        units = {one.name: one.unit for one in MEASURES[self.track]}
        self.scores.append(
            Score(
                program=self.program,
                track=self.track,
                group=group,
                measure=measure,
                unit=units[measure],
                relation=found.relation,
                value=found.value,
                low=found.low,
                high=found.high,
                answered=answered,
                tasks=tasks,
            )
        )


def groups_of(
    labels: Sequence[Sequence[str]], main: str = EVERYTHING
) -> list[tuple[str, IntArray]]:
    """Return the groups of tasks and which tasks are in each: all of them, and those of each label.

    Parameters
    ----------
    labels
        Of each task, such as ``("kind tilted", "lens gaussian")``, one of each sort.
    main
        What the group of all is called.
    """
    found = [(main, np.arange(len(labels), dtype=np.int64))]
    for sort in zip(*labels, strict=True):
        found += [
            (label, np.flatnonzero(np.array(sort) == label).astype(np.int64))
            for label in sorted(set(sort))
        ]
    return found


Announce = Callable[[int], None]
"""Is told how many tasks are done."""
