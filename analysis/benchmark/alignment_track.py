"""Scores of alignment: how far the points of a follow-up are from their true place."""

from dataclasses import dataclass

import numpy as np

from analysis.benchmark.data_set import BenchmarkData
from analysis.benchmark.estimates import estimate, scene_numbers, share
from analysis.benchmark.measures import ANSWERED
from analysis.benchmark.program_files import ALIGNMENT_NAME, ProgramFiles
from analysis.benchmark.score_list import ScoreList, groups_of
from analysis.benchmark.stored_models import (
    AlignmentTask,
    AlignmentTruth,
    GivenAlignment,
    Places,
    TaskList,
    TrueAlignment,
)
from analysis.errors import ResultsFileError
from simulation.arrays import FloatArray

WITHIN_PX = (0.1, 0.5, 2.0)
WRONG_PX = 5.0
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
        return self.error_px is not None and not (self.truth.related and self.error_px <= WRONG_PX)

    def is_within(self, most_px: float) -> bool:
        return self.error_px is not None and self.error_px <= most_px


def score_alignment(data: BenchmarkData, files: ProgramFiles, program: str) -> ScoreList:
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
    for group, members in groups_of([(f"kind {one.truth.kind}",) for one in pairs]):
        _score_group(scores, group, [pairs[at] for at in members])
    return scores


def _score_group(scores: ScoreList, group: str, pairs: list[_Aligned]) -> None:
    related = [one for one in pairs if one.truth.related]
    others = [one for one in pairs if not one.truth.related]
    scenes = scene_numbers([one.truth.scene for one in related])
    errors = [one.error_px for one in related]
    aligned = [error for error in errors if error is not None]
    at = np.array([place for place, one in enumerate(errors) if one is not None], np.int64)
    shares = {
        ANSWERED: [error is not None for error in errors],
        **{f"within_{px:g}_px": [one.is_within(px) for one in related] for px in WITHIN_PX},
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
        If the homography is singular, or there is not a place for each point.
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
    values = np.linalg.svd(matrix, compute_uv=False)
    if not values[2] > _SINGULAR * values[0]:
        raise ValueError("homography_to_reference is singular; leave the pair out, or refuse it")
    x, y, w = matrix @ np.column_stack([points, np.ones(len(points))]).T
    # A homography has no sign, but points beyond its horizon are nowhere.
    is_shown = w * (1 if np.sum(w > 0) >= w.size / 2 else -1) > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.column_stack([x, y]) / w[:, None]
    return np.where(is_shown[:, None], found, np.inf)


def _points(places: Places) -> FloatArray:
    return np.array(places, np.float64).reshape(-1, 2)
