"""From the scores of pairs to curves of AUC, and what belongs to them, against zoom."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from analysis.detectability import DetectabilityCurve, auc_of
from analysis.errors import AnalysisError
from analysis.evaluation.document import EvaluationCurve, FrocPoints, RocPoints
from analysis.evaluation.roc import (
    MarkedPair,
    auc_interval,
    froc,
    precision_recall,
    roc_curve,
    tpr_at_fpr,
)
from analysis.evaluation.scores import PhotographScores
from analysis.evaluation.task import Condition, EvaluationTask
from simulation.arrays import FloatArray

Photographs = Callable[[], Iterator[PhotographScores]]
"""Reads the scores of all photographs again, in a fixed order, one after the other."""

FPR = 0.05
"""False alarms at which the share of changes found is stated."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScoredPairs:
    """Scores of one condition, and the number of the photograph that each is from."""

    unchanged: FloatArray
    changed: FloatArray
    unchanged_group: NDArray[np.int64]
    changed_group: NDArray[np.int64]
    marked: list[MarkedPair]

    @classmethod
    def of(cls, photographs: Iterator[PhotographScores], condition: int) -> "ScoredPairs":
        """Collect a condition's scores of all photographs, without those of failed pairs."""
        scores: tuple[list[FloatArray], list[FloatArray]] = [], []
        groups: tuple[list[NDArray[np.int64]], list[NDArray[np.int64]]] = [], []
        marked: list[MarkedPair] = []
        for number, one in enumerate(photographs):
            marked += one.marked(condition)
            for kind in (0, 1):
                found = one.scores[:, condition, kind]
                is_there = np.isfinite(found)
                scores[kind].append(found[is_there])
                groups[kind].append(np.full(np.count_nonzero(is_there), number))
        return cls(
            unchanged=np.concatenate(scores[0]),
            changed=np.concatenate(scores[1]),
            unchanged_group=np.concatenate(groups[0]),
            changed_group=np.concatenate(groups[1]),
            marked=marked,
        )


def evaluation_curves(
    task: EvaluationTask,
    detector: str,
    photographs: Photographs,
    bounds: Mapping[tuple[float, float], DetectabilityCurve],
    progress: Callable[[int], None] = lambda _: None,
) -> list[EvaluationCurve]:
    """Compute a curve for every tilt, noise and contrast.

    Parameters
    ----------
    task
        What was asked for.
    detector
        Name of the detector.
    photographs
        Their scores.
    bounds
        d' of the ideal linear observer against zoom by noise and contrast; of a change without a
        d' none.
    progress
        Called with the number of conditions done.

    Raises
    ------
    AnalysisError
        If a condition has no pair with, or none without a change that gave a score.
    """
    conditions = task.conditions
    curves: list[EvaluationCurve] = []
    done = 0
    for tilt, noise, contrast in product(task.tilts_deg, task.noises_dn, task.contrasts_dn):
        columns: dict[str, list[float | None]] = {}
        rocs, frocs, is_grouped = [], [], []
        for zoom in task.zooms:
            condition = Condition(zoom=zoom, tilt_deg=tilt, noise_dn=noise, contrast_dn=contrast)
            pairs = ScoredPairs.of(photographs(), conditions.index(condition))
            if not (pairs.changed.size and pairs.unchanged.size):
                raise AnalysisError(f"no pair gave a score at {condition.name}")
            row, is_by_photograph = _row(pairs)
            bound = bounds.get((noise, contrast))
            d_prime = None if bound is None else _bound_at(bound, condition)
            row["dprime_bound"] = d_prime
            row["auc_bound"] = None if d_prime is None else float(auc_of(d_prime))
            for name, value in row.items():
                columns.setdefault(name, []).append(value)
            is_grouped.append(is_by_photograph)
            roc = roc_curve(pairs.unchanged, pairs.changed)
            rocs.append(RocPoints(zoom=zoom, fpr=roc.fpr.tolist(), tpr=roc.tpr.tolist()))
            if pairs.marked:
                frocs.append(_froc_points(zoom, pairs.marked))
            done += 1
            progress(done)
        curves.append(
            EvaluationCurve.model_validate(
                {
                    **{"detector": detector, "model": task.model, "noise_dn": noise},
                    **{"contrast_dn": contrast, "signal_sigma_px": task.change.sigma_px},
                    **{"tilt_deg": tilt, "fpr": FPR, "zoom": list(task.zooms)},
                    "is_by_photograph": all(is_grouped),
                    **columns,
                    "roc": rocs,
                    "froc": frocs,
                }
            )
        )
    return curves


def _row(pairs: ScoredPairs) -> tuple[dict[str, float | None], bool]:
    scores = (pairs.unchanged, pairs.changed, pairs.unchanged_group, pairs.changed_group)
    area = auc_interval(*scores)
    share = tpr_at_fpr(*scores, fpr=FPR)
    return (
        {
            **{"auc": area.auc, "auc_low": area.low, "auc_high": area.high},
            "auc_all_pairs": area.auc_all_pairs,
            **{"tpr": share.tpr, "tpr_low": share.low, "tpr_high": share.high},
            "average_precision": precision_recall(pairs.unchanged, pairs.changed).average_precision,
            "pairs": int(pairs.changed.size),
        },
        area.is_by_photograph,
    )


def _bound_at(bound: DetectabilityCurve, condition: Condition) -> float | None:
    """D' of the ideal observer at the largest local zoom in the middle of a tilted follow-up."""
    local = condition.zoom / np.cos(np.radians(condition.tilt_deg))
    d_prime = float(bound.d_prime_at(local))
    return d_prime if np.isfinite(d_prime) else None


def _froc_points(zoom: float, pairs: list[MarkedPair]) -> FrocPoints:
    found = froc(pairs)
    return FrocPoints(
        zoom=zoom,
        false_marks=found.false_marks_per_pair.tolist(),
        found=found.found.tolist(),
    )
