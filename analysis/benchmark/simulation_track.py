"""Scores of simulated photographs: their error in percent of the true contrast."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from analysis.benchmark.data_set import BenchmarkData
from analysis.benchmark.estimates import estimate, scene_numbers, share
from analysis.benchmark.measures import ANSWERED
from analysis.benchmark.program_files import ProgramFiles, given_levels
from analysis.benchmark.score_list import Announce, ScoreList, groups_of
from analysis.benchmark.stored_models import (
    SimulationTask,
    SimulationTruth,
    TaskList,
    TrueSimulation,
)
from analysis.errors import ResultsFileError
from simulation.arrays import BoolArray, FloatArray

BORDER_PX = 8.0
"""Pixels that look nearer to the reference's rim are not scored: there a model has to guess."""

_ZOOMS = (0.0, 1.0, 1.5, 2.0, 3.0, np.inf)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Simulated:
    error_percent: float
    correlation: float
    predicted: float


def score_simulation(
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
