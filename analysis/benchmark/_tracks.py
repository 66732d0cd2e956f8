"""Scores programs on the tracks of PSF, simulation and alignment, and all of them together."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt
from pathlib import Path

import numpy as np

from acquisition.files import Provenance
from analysis.benchmark._changes_track import score_changes
from analysis.benchmark._data_set import (
    TRACKS,
    AlignmentTask,
    AlignmentTruth,
    BenchmarkData,
    GivenAlignment,
    Places,
    PsfTruth,
    SimulationTask,
    SimulationTruth,
    TaskList,
    Track,
    TrueAlignment,
    TrueChart,
    TrueEdge,
    TrueSimulation,
)
from analysis.benchmark._program_files import ALIGNMENT_NAME, GivenEdge, ProgramFiles, given_levels
from analysis.benchmark._things_track import score_things
from analysis.benchmark.scores import (
    ANSWERED,
    Announce,
    BenchmarkScores,
    Score,
    ScoredProgram,
    ScoreList,
    estimate,
    groups_of,
    scene_numbers,
    share,
)
from analysis.errors import ResultsFileError
from calibration.estimate import NORMAL_95
from simulation.arrays import BoolArray, FloatArray, IntArray


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


def _score_psf(data: BenchmarkData, files: ProgramFiles, program: str) -> ScoreList:
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
            _score_edges(scores, group, [of_kind[at] for at in members])
    return scores


def _edges(truth: PsfTruth, given: Mapping[tuple[str, str], GivenEdge]) -> list[_Edge]:
    return [
        _Edge(chart=name, of=chart, truth=chart.edges[edge], given=given.get((name, edge)))
        for name, chart in sorted(truth.charts.items())
        for edge in sorted(chart.edges)
    ]


def _score_edges(scores: ScoreList, group: str, edges: list[_Edge]) -> None:
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


BORDER_PX = 8.0
"""Pixels that look nearer to the reference's rim are not scored: there a model has to guess."""

_ZOOMS = (0.0, 1.0, 1.5, 2.0, 3.0, np.inf)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Simulated:
    error_percent: float
    correlation: float
    predicted: float


def _score_simulation(
    data: BenchmarkData, files: ProgramFiles, program: str, advance_to: Announce
) -> ScoreList:
    """Score the photographs that a program simulated.

    Raises
    ------
    ResultsFileError
        If a file of the data set or of the program cannot be used.
    """
    truth = data.read("truth/simulation.json", SimulationTruth)
    tasks = data.read("simulation/tasks.json", TaskList[SimulationTask]).by_name
    given = files.pictures("simulation", truth.tasks)
    names = sorted(truth.tasks)
    found: list[_Simulated | None] = []
    for done, name in enumerate(names):
        if name not in tasks:
            raise ResultsFileError(f"{data.folder}: task {name} is not in simulation/tasks.json")
        found.append(_scored(data, tasks[name], truth, given[name]) if name in given else None)
        advance_to(done + 1)
    scores = ScoreList(program=program, track="simulation")
    scenes = scene_numbers([truth.tasks[name].scene for name in names])
    for group, members in groups_of([_labels(truth.tasks[name]) for name in names]):
        at = members[[found[one] is not None for one in members]]
        values = [one for place in at if (one := found[place]) is not None]
        is_done = [found[one] is not None for one in members]
        scores.add(group, ANSWERED, share(is_done, scenes[members]), len(at), len(members))
        for name, column, statistic in (
            ("pixels_predicted", [100 * one.predicted for one in values], np.mean),
            ("error_median", [one.error_percent for one in values], np.median),
            ("correlation_median", [one.correlation for one in values], np.median),
        ):
            estimated = estimate(np.array(column), scenes[at], statistic)
            scores.add(group, name, estimated, len(at), len(members))
    return scores


def _labels(truth: TrueSimulation) -> tuple[str, ...]:
    low, high = next(ends for ends in pairwise(_ZOOMS) if ends[0] < truth.zoom <= ends[1])
    zooms = f"zoom {low:g} to {high:g}" if high < np.inf else f"zoom above {low:g}"
    kinds = (f"kind {truth.kind}", zooms, f"lens {truth.lens.kind}")
    return (*kinds, f"condition {truth.condition}")


def _scored(
    data: BenchmarkData, task: SimulationTask, truth: SimulationTruth, path: Path
) -> _Simulated | None:
    """Errors of one photograph; None where nothing was predicted."""
    shape, name = task.followup_shape, f"truth/simulation/{task.task}.tif"
    true_dn = data.levels(name, shape).astype(np.float64) / truth.levels_per_dn
    given_dn = given_levels(path, shape).astype(np.float64)
    inside = is_inside(task, data.levels(task.reference).shape)
    if not inside.any():
        raise ResultsFileError(f"{data.folder}: task {task.task} shows nothing of its reference")
    is_scored = inside & ~np.isnan(given_dn)
    contrast_dn = float(true_dn[inside].std())
    if not is_scored.any():
        return None
    if not contrast_dn > 0:
        raise ResultsFileError(f"{data.folder}: the truth of task {task.task} has no contrast")
    away_dn = given_dn[is_scored] - true_dn[is_scored]
    return _Simulated(
        error_percent=100 * float(np.sqrt(np.mean(away_dn**2))) / contrast_dn,
        correlation=_correlation(given_dn[is_scored], true_dn[is_scored]),
        predicted=float(is_scored.sum() / inside.sum()),
    )


def is_inside(task: SimulationTask, shape: tuple[int, ...]) -> BoolArray:
    """Which pixels of the follow-up look at the reference, ``BORDER_PX`` or more from its rim."""
    rows, cols = task.followup_shape
    y, x = np.indices((rows, cols), dtype=np.float64)
    matrix = np.array(task.homography_to_reference)
    x_, y_, w_ = (row[0] * x + row[1] * y + row[2] for row in matrix)
    with np.errstate(divide="ignore", invalid="ignore"):
        across, down = x_ / w_, y_ / w_
    fits = (across >= BORDER_PX) & (across <= shape[1] - 1 - BORDER_PX)
    return np.asarray(
        fits & (down >= BORDER_PX) & (down <= shape[0] - 1 - BORDER_PX) & (w_ > 0), np.bool_
    )


def _correlation(given: FloatArray, true: FloatArray) -> float:
    """Pearson's; 0 of what has no contrast."""
    away, from_ = given - given.mean(), true - true.mean()
    scale = float(np.sqrt(np.sum(away**2) * np.sum(from_**2)))
    return float(np.sum(away * from_)) / scale if scale > 0 else 0.0


_WITHIN_PX = (0.1, 0.5, 2.0)
_WRONG_PX = 5.0
"""Further off than this an answer is wrong: nothing can be compared by it."""

_FARTHEST_PX = 1e6
_SAME_PX = 1e-3
_SINGULAR = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True)
class _Aligned:
    """What became of a pair; ``error_px`` is None where it was refused."""

    truth: TrueAlignment
    error_px: float | None

    @property
    def is_wrong(self) -> bool:
        """Whether an answer was given that should not have been."""
        return self.error_px is not None and not (self.truth.related and self.error_px <= _WRONG_PX)

    def is_within(self, most_px: float) -> bool:
        return self.error_px is not None and self.error_px <= most_px


def _score_alignment(data: BenchmarkData, files: ProgramFiles, program: str) -> ScoreList:
    """Score a program's alignment of pairs; pairs that it does not name count as refused.

    Raises
    ------
    ResultsFileError
        If a file of the data set or of the program cannot be used.
    """
    truth = data.read("truth/alignment.json", AlignmentTruth)
    tasks = data.read("alignment/tasks.json", TaskList[AlignmentTask]).by_name
    given = files.alignments(truth.tasks)
    path = files.folder / ALIGNMENT_NAME
    pairs = []
    for name in sorted(truth.tasks):
        if name not in tasks:
            raise ResultsFileError(f"{data.folder}: task {name} is not in alignment/tasks.json")
        try:
            error = _error_px(tasks[name], truth.tasks[name], given.get(name))
        except ValueError as problem:
            raise ResultsFileError(f"{path}: task {name}: {problem}", source=str(path)) from problem
        pairs.append(_Aligned(truth=truth.tasks[name], error_px=error))
    scores = ScoreList(program=program, track="alignment")
    scores.remarks.extend(
        f"{path}: the homography of {name} is singular: it counts as wrong"
        for name in sorted(given)
        if _is_singular(given[name])
    )
    for group, members in groups_of([(f"kind {one.truth.kind}",) for one in pairs]):
        _score_pairs(scores, group, [pairs[at] for at in members])
    return scores


def _score_pairs(scores: ScoreList, group: str, pairs: list[_Aligned]) -> None:
    related = [one for one in pairs if one.truth.related]
    others = [one for one in pairs if not one.truth.related]
    scenes = scene_numbers([one.truth.scene for one in related])
    errors = [one.error_px for one in related]
    aligned = [error for error in errors if error is not None]
    at = np.array([place for place, one in enumerate(errors) if one is not None], np.int64)
    shares = {
        ANSWERED: [error is not None for error in errors],
        **{f"within_{px:g}_px": [one.is_within(px) for one in related] for px in _WITHIN_PX},
        "refused": [error is None for error in errors],
    }
    for name, is_hit in shares.items():
        scores.add(group, name, share(is_hit, scenes), len(aligned), len(related))
    found = estimate(np.array(aligned), scenes[at], np.median)
    scores.add(group, "error_median", found, len(aligned), len(related))
    refused = [one.error_px is None for one in others]
    of_others = scene_numbers([one.truth.scene for one in others])
    answered = len(others) - sum(refused)
    scores.add(group, "unrelated_refused", share(refused, of_others), answered, len(others))
    of_all = scene_numbers([one.truth.scene for one in pairs])
    wrong = share([one.is_wrong for one in pairs], of_all)
    scores.add(group, "wrong", wrong, len(aligned) + answered, len(pairs))


def _error_px(
    task: AlignmentTask, truth: TrueAlignment, given: GivenAlignment | None
) -> float | None:
    """Root mean square distance at the truth's points in px of the reference; None if refused.

    Raises
    ------
    ValueError
        If there is not a place for each point.
    """
    if given is None or given.refused:
        return None
    places = _places(task, given)
    if not truth.points:
        return _FARTHEST_PX
    points = np.array(truth.points)
    named = _points(task.followup_points)
    nearest = [int(np.argmin(np.hypot(*(named - point).T))) for point in points[:, :2]]
    if np.abs(named[nearest] - points[:, :2]).max() > _SAME_PX:
        raise ValueError("the truth has points that the task does not ask for")
    away = np.hypot(*(places[nearest] - points[:, 2:]).T)
    return float(np.sqrt(np.mean(np.minimum(away, _FARTHEST_PX) ** 2)))


def _places(task: AlignmentTask, given: GivenAlignment) -> FloatArray:
    """Where the program puts the points, shape (n, 2); infinitely far where that is nowhere."""
    points = _points(task.followup_points)
    if given.reference_points is not None:
        if len(given.reference_points) != len(points):
            raise ValueError(
                f"{len(given.reference_points)} reference_points, expected {len(points)}, one for "
                "each of followup_points"
            )
        return _points(given.reference_points)
    matrix = np.array(given.homography_to_reference)
    if _is_singular(given):
        return np.full_like(points, np.inf)
    x, y, w = matrix @ np.column_stack([points, np.ones(len(points))]).T
    # A homography has no sign, but points beyond its horizon are nowhere.
    is_shown = w * (1 if np.sum(w > 0) >= w.size / 2 else -1) > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.column_stack([x, y]) / w[:, None]
    return np.where(is_shown[:, None], found, np.inf)


def _is_singular(given: GivenAlignment) -> bool:
    """Whether an answer is a homography that squeezes the frame onto a line or a point."""
    if given.homography_to_reference is None:
        return False
    values = np.linalg.svd(np.array(given.homography_to_reference), compute_uv=False)
    return bool(not values[2] > _SINGULAR * values[0])


def _points(places: Places) -> FloatArray:
    return np.array(places, np.float64).reshape(-1, 2)


Bar = Callable[[str, int], AbstractContextManager[Announce]]
"""Gives a block a function that shows how many tasks are done."""


def scored(
    data: BenchmarkData, programs: Sequence[ProgramFiles], provenance: Provenance, bar: Bar
) -> BenchmarkScores:
    """Score programs in every track that they took part in.

    Raises
    ------
    ResultsFileError
        If a file of the data set or of a program cannot be used, or there is nothing to score.
    """
    names = [one.about.name for one in programs]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ResultsFileError(
            f"two folders of results both have the name {twice!r}; give them different names in "
            "about.json"
        )
    scores: list[Score] = []
    shown: list[ScoredProgram] = []
    for files in programs:
        taken = [track for track in TRACKS if data.has(track) and files.has(track)]
        if not taken:
            raise ResultsFileError(
                f"{files.folder} contains no results; expected psf.csv, alignment.json, "
                "things.json, detections.json, or folders simulation and changes",
                source=str(files.folder),
            )
        found = [_scores_of(track, data, files, bar) for track in taken]
        scores += [score for one in found for score in one.scores]
        shown.append(
            ScoredProgram(
                **files.about.model_dump(),
                folder=str(files.folder),
                remarks=[remark for one in found for remark in one.remarks],
            )
        )
    manifest = data.manifest
    return BenchmarkScores(
        data_size=manifest.size,
        data_seed=manifest.seed,
        data_sha256=manifest.sha256,
        programs=shown,
        scores=scores,
        provenance=provenance,
    )


def _scores_of(track: Track, data: BenchmarkData, files: ProgramFiles, bar: Bar) -> ScoreList:
    name = files.about.name
    if track == "psf":
        return _score_psf(data, files, name)
    if track == "alignment":
        return _score_alignment(data, files, name)
    if track == "things":
        return score_things(data, files, name)
    score = _score_simulation if track == "simulation" else score_changes
    with bar(f"scoring {track} of {name}", data.tasks_of(track)) as advance_to:
        return score(data, files, name, advance_to)
