"""Scores of sharpness: MTF50 and contrasts along edges, or of photographs without an edge."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt

import numpy as np

from analysis.benchmark.data_set import BenchmarkData
from analysis.benchmark.estimates import estimate, scene_numbers, share
from analysis.benchmark.measures import ANSWERED
from analysis.benchmark.program_files import GivenEdge, ProgramFiles
from analysis.benchmark.score_list import ScoreList, groups_of
from analysis.benchmark.stored_models import PsfTruth, TrueChart, TrueEdge
from calibration.sharpness import NORMAL_95
from simulation.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True)
class _Edge:
    chart: str
    of: TrueChart
    truth: TrueEdge
    given: GivenEdge | None

    @property
    def error_percent(self) -> float | None:
        """Of MTF50; None where it was not measured."""
        if self.given is None or self.given.mtf50 is None or self.truth.mtf50 is None:
            return None
        return 100 * (self.given.mtf50 / self.truth.mtf50 - 1)

    @property
    def is_within(self) -> bool | None:
        """Whether the truth lies within 95 % as stated; None where no standard error was given."""
        if self.given is None or self.given.mtf50 is None or self.truth.mtf50 is None:
            return None
        if self.given.standard_error is None:
            return None
        return abs(self.given.mtf50 - self.truth.mtf50) <= NORMAL_95 * self.given.standard_error

    @property
    def squared_errors(self) -> FloatArray:
        """Of the contrasts that were given."""
        given = {} if self.given is None else self.given.mtf
        known = [name for name in given if name in self.truth.mtf]
        return np.array([(given[name] - self.truth.mtf[name]) ** 2 for name in known])


def score_psf(data: BenchmarkData, files: ProgramFiles, program: str) -> ScoreList:
    """Score what a program says of edges, and of photographs without one, apart.

    Raises
    ------
    ResultsFileError
        If a file of the data set or of the program cannot be used.
    """
    truth = data.read("truth/psf.json", PsfTruth)
    edges = _edges(truth, files.edges(truth))
    scores = ScoreList(program=program, track="psf")
    for kind in ("edges", "photographs"):
        of_kind = [one for one in edges if one.of.kind == kind and one.truth.mtf50 is not None]
        if not of_kind:
            continue
        labels = [
            (f"{kind}, lens {one.of.lens.kind}", f"{kind}, {one.of.condition}") for one in of_kind
        ]
        for group, members in groups_of(labels, kind):
            _score_group(scores, group, [of_kind[at] for at in members])
    return scores


def _edges(truth: PsfTruth, given: Mapping[tuple[str, str], GivenEdge]) -> list[_Edge]:
    return [
        _Edge(chart=name, of=chart, truth=chart.edges[edge], given=given.get((name, edge)))
        for name, chart in sorted(truth.charts.items())
        for edge in sorted(chart.edges)
    ]


def _score_group(scores: ScoreList, group: str, edges: list[_Edge]) -> None:
    charts = scene_numbers([one.chart for one in edges])
    count = len(edges)
    errors, at = _known([one.error_percent for one in edges])
    measured = len(at)
    is_measured = [one.error_percent is not None for one in edges]
    scores.add(group, ANSWERED, share(is_measured, charts), measured, count)
    for name, found in (
        ("mtf50_error_median", estimate(np.abs(errors), charts[at], _median)),
        ("mtf50_bias", estimate(errors, charts[at], _mean)),
        ("mtf50_error_p95", estimate(np.abs(errors), charts[at], _p95)),
    ):
        scores.add(group, name, found, measured, count)
    squares = [one.squared_errors for one in edges]
    given = np.flatnonzero([each.size > 0 for each in squares])
    sums = np.array([(squares[one].sum(), squares[one].size) for one in given])
    found = estimate(sums, charts[given], _root_of_mean)
    scores.add(group, "mtf_error_rms", found, len(given), count)
    within, at = _known([one.is_within for one in edges])
    scores.add(group, "truth_within_95", share((within > 0).tolist(), charts[at]), len(at), count)


def _known(values: list[float | None] | list[bool | None]) -> tuple[FloatArray, IntArray]:
    """The values that are not None, and where they are."""
    at = np.array([place for place, one in enumerate(values) if one is not None], np.int64)
    return np.array([one for one in values if one is not None], np.float64), at


def _median(values: FloatArray) -> float:
    return float(np.median(values))


def _mean(values: FloatArray) -> float:
    return float(np.mean(values))


def _p95(values: FloatArray) -> float:
    return float(np.percentile(values, 95))


def _root_of_mean(sums: FloatArray) -> float:
    """Of sums of squares and their counts, shape (n, 2)."""
    return sqrt(float(sums[:, 0].sum() / sums[:, 1].sum()))
