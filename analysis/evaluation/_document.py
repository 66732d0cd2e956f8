"""evaluation.json: how well a detector does, against pose, from its scores; also a curve of d'."""

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from io import BytesIO
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from acquisition.dataframe import dataframe
from analysis.detectability import DetectabilityCurve, DetectabilityCurves, auc_of, d_prime_of_auc
from analysis.errors import AnalysisError, ResultsFileError
from analysis.evaluation.roc import (
    MOST_MARKS as MARKS,
    Disc,
    MarkedPair,
    Marks,
    auc_interval,
    froc,
    precision_recall,
    roc_curve,
    tpr_at_fpr,
)
from analysis.evaluation.task import Condition, EvaluationTask
from analysis.results_file import ResultsDocument, StoredValues
from calibration.documents import read_document
from simulation import Model
from simulation.arguments import FilePath, checked
from simulation.arrays import FloatArray
from simulation.notebook import html_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame


class FailedPair(StoredValues):
    """A pair of which a detector gave nothing.

    ``reason`` is ``crashed``, ``hung``, ``not_finite``, ``shape``, ``missing`` or ``output``.
    """

    photograph: str
    pair: str
    reason: str
    message: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PhotographScores:
    """Scores of the pairs of one photograph.

    Parameters
    ----------
    path, sha256, encoding
        The photograph: its path as it is printed, its content, how its levels were read.
    scores
        Shape (crops, conditions, 2): without and with a change; NaN of failed pairs.
    is_done
        Shape (crops, conditions): whether the pairs were tried.
    marks
        Score, x and y of the highest local maxima of the maps, shape (crops, conditions, 2,
        ``MARKS``, 3), falling; NaN where there are no more.
    places
        x, y and radius of the change in the follow-up, shape (crops, conditions, 3).
    failed
        Pairs without a score.
    is_colour
        Whether the pairs are in colour.
    """

    path: str
    sha256: str
    encoding: str
    scores: FloatArray
    is_done: NDArray[np.bool_]
    marks: NDArray[np.float32]
    places: NDArray[np.float32]
    failed: list[FailedPair] = field(default_factory=list)
    is_colour: bool = False

    @classmethod
    def empty(cls, path: str, sha256: str, encoding: str, shape: tuple[int, int]) -> Self:
        """Nothing yet, for ``shape`` crops and conditions."""
        return cls(
            path=path,
            sha256=sha256,
            encoding=encoding,
            scores=np.full((*shape, 2), np.nan),
            is_done=np.zeros(shape, np.bool_),
            marks=np.full((*shape, 2, MARKS, 3), np.nan, np.float32),
            places=np.full((*shape, 3), np.nan, np.float32),
        )

    def marked(self, condition: int) -> list[MarkedPair]:
        """Return what the maps of a condition mark; of no map, an empty list."""
        pairs: list[MarkedPair] = []
        if not np.isfinite(self.marks[:, condition]).any():
            return pairs
        for crop, kind in product(range(len(self.scores)), (0, 1)):
            if not np.isfinite(self.scores[crop, condition, kind]):
                continue
            found = self.marks[crop, condition, kind].astype(np.float64)
            score, x, y = found[np.isfinite(found[:, 0])].T
            x_px, y_px, radius_px = self.places[crop, condition].tolist()
            pairs.append(
                MarkedPair(
                    marks=Marks(scores=score, x_px=x, y_px=y),
                    change=Disc(x_px=x_px, y_px=y_px, radius_px=radius_px) if kind else None,
                )
            )
        return pairs


_ARRAYS = ("scores", "is_done", "marks", "places")


def scores_bytes(scores: PhotographScores) -> bytes:
    """Return the scores of a photograph as bytes."""
    head = {name: getattr(scores, name) for name in ("path", "sha256", "encoding", "is_colour")}
    head["failed"] = [one.model_dump() for one in scores.failed]
    file = BytesIO()
    arrays = {name: getattr(scores, name) for name in _ARRAYS}
    np.savez_compressed(file, head=np.frombuffer(json.dumps(head).encode(), np.uint8), **arrays)
    return file.getvalue()


def scores_of(data: bytes) -> PhotographScores:
    """Return the scores that `scores_bytes` made bytes of."""
    with np.load(BytesIO(data), allow_pickle=False) as stored:
        head = json.loads(stored["head"].tobytes())
        head["failed"] = [FailedPair.model_validate(one) for one in head["failed"]]
        return PhotographScores(**head, **{name: stored[name] for name in _ARRAYS})


_EVALUATION_SCHEMA: Final = "standoff.evaluation/1"

_NOTE = (
    "AUC is the probability that a pair with a change has the higher score. Registration error, "
    "gloss, parallax and motion are not in the pairs."
)
_LEAST, _MOST_AUC = 1e-9, 1 - 1e-6
_HEAD_BYTES = 4096
_ENOUGH_PHOTOGRAPHS = 10

_LISTS = (
    *("auc", "auc_low", "auc_high", "auc_all_pairs", "tpr", "tpr_low", "tpr_high"),
    *("average_precision", "pairs", "dprime_bound", "auc_bound"),
)


class RocPoints(StoredValues):
    """Receiver operating characteristic at one zoom, as corners of its steps."""

    zoom: float
    fpr: list[float]
    tpr: list[float]


class FrocPoints(StoredValues):
    """Share of changes that a mark of the map hits, against false marks per pair, at one zoom."""

    zoom: float
    false_marks: list[float]
    found: list[float]


class EvaluationCurve(StoredValues):
    """How well a detector tells changed pairs from others, against zoom.

    Lists have a value for each zoom. ``auc`` compares changed pairs with unchanged pairs of other
    photographs, as a threshold set elsewhere would, with its 95 % interval over photographs;
    ``auc_all_pairs`` is the Mann-Whitney statistic of all pairs. ``tpr`` is the share of changes
    found at a false positive rate of ``fpr``, ``pairs`` the number of pairs with a change that have
    a score. ``dprime_bound`` and ``auc_bound`` are those of the ideal linear observer that knows
    where the change is; null if the signal that the change adds is not known.
    """

    detector: str
    model: Model
    noise_dn: float = Field(ge=0)
    contrast_dn: float
    signal_sigma_px: float | None
    tilt_deg: float
    fpr: float
    is_by_photograph: bool
    zoom: list[float] = Field(min_length=1)
    auc: list[float]
    auc_low: list[float]
    auc_high: list[float]
    auc_all_pairs: list[float]
    tpr: list[float]
    tpr_low: list[float]
    tpr_high: list[float]
    average_precision: list[float]
    pairs: list[int]
    dprime_bound: list[float | None]
    auc_bound: list[float | None]
    roc: list[RocPoints] = Field(default=[], repr=False)
    froc: list[FrocPoints] = Field(default=[], repr=False)

    @model_validator(mode="after")
    def _check(self) -> Self:
        for name in _LISTS:
            if len(getattr(self, name)) != len(self.zoom):
                raise ValueError(f"{name} must have a value for each zoom")
        if self.zoom[0] < 1 or any(np.diff(self.zoom) <= 0):
            raise ValueError("zoom must increase and start at 1 or more")
        return self

    @property
    def name(self) -> str:
        """Detector, tilt, noise and contrast of the curve, in words."""
        return (
            f"{self.detector}, tilt {self.tilt_deg:g} degrees, noise {self.noise_dn:g} DN, "
            f"contrast {self.contrast_dn:g} DN"
        )

    def as_d_prime(self) -> DetectabilityCurve:
        """Return the curve of d' with the same AUC, for limits; an AUC below 1/2 gives d' = 0.

        An AUC of 1 would give an infinite d': the middle of its interval is used instead.
        """
        middle = [
            auc if auc < 1 else (low + 1) / 2
            for auc, low in zip(self.auc, self.auc_low, strict=True)
        ]
        low, d_prime, high = (
            [_finite_d_prime(value) for value in values]
            for values in (self.auc_low, middle, self.auc_high)
        )
        return DetectabilityCurve(
            model=self.model,
            observer="detector",
            detector=self.detector,
            noise_dn=max(self.noise_dn, _LEAST),
            contrast_dn=max(abs(self.contrast_dn), _LEAST),
            signal_sigma_px=self.signal_sigma_px,
            zoom=self.zoom,
            dprime=d_prime,
            dprime_low=low,
            dprime_high=high,
            auc=self.auc,
        )


class Evaluation(ResultsDocument):
    """A detector's curves: the document of evaluation.json.

    ``photographs`` is the number of photographs that gave pairs, ``colour_photographs`` of them in
    colour; ``crops`` is the number of pairs with a change, and of as many without, cut from each
    photograph for each point. ``failed_pairs`` is the number of pairs without a score, ``failed``
    names the first of them.
    """

    schema_name: Literal["standoff.evaluation/1"] = Field(
        default=_EVALUATION_SCHEMA, alias="schema"
    )
    note: str = _NOTE
    detector: str
    photographs: int
    colour_photographs: int = 0
    crops: int
    crop_px: int
    reference_zoom: float
    change: str
    focus_scatter_px2: float = 0.0
    light_scatter: float = 0.0
    failed_pairs: int = 0
    failed: list[FailedPair] = Field(default=[], repr=False)
    curves: list[EvaluationCurve] = Field(min_length=1)

    def __repr__(self) -> str:
        first = self.curves[0]
        values = ", ".join(
            f"{auc:.3f} at zoom {zoom:g}" for auc, zoom in zip(first.auc, first.zoom, strict=True)
        )
        return f"<AUC of {first.name}: {values}; {len(self.curves)} curves>"

    def as_d_prime(self) -> DetectabilityCurves:
        """Return the curves of d' at the least tilt, in the form that judges limits and poses.

        Other tilts are judged by the local zoom that they cause, as with any curve of d'.
        """
        least = min(abs(curve.tilt_deg) for curve in self.curves)
        return DetectabilityCurves(
            images=self.photographs,
            reference_zoom=self.reference_zoom,
            signal=self.change,
            curves=[curve.as_d_prime() for curve in self.curves if abs(curve.tilt_deg) == least],
            provenance=self.provenance,
        )

    @property
    def failed_sentence(self) -> str | None:
        """Remark on pairs without a score; None if there are none."""
        if not self.failed_pairs:
            return None
        first = self.failed[0]
        count = "1 pair" if self.failed_pairs == 1 else f"{self.failed_pairs} pairs"
        return f"no score for {count}; the first: {first.photograph}, {first.pair}: {first.message}"

    @property
    def too_few_sentence(self) -> str | None:
        """Remark if the photographs are too few for a useful interval; None if they are not."""
        if self.photographs >= _ENOUGH_PHOTOGRAPHS:
            return None
        count = (
            "1 photograph says" if self.photographs == 1 else f"{self.photographs} photographs say"
        )
        return (
            f"{count} little about others, however many pairs are cut; take {_ENOUGH_PHOTOGRAPHS} "
            "or more"
        )

    def _repr_html_(self) -> str:
        rows = [(one.name, *(f"{auc:.3f}" for auc in one.auc)) for one in self.curves]
        zooms = (f"{zoom:g}" for zoom in self.curves[0].zoom)
        return html_table("AUC against zoom", ("zoom", *zooms), rows)

    def to_dataframe(self) -> "DataFrame":
        """Return the curves as a pandas table, one row per curve and zoom.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.

        Examples
        --------
        >>> task = standoff.EvaluationTask(zooms=(1.0, 1.5), crop_px=64, crops=4)
        >>> found = standoff.evaluate("absolute-difference", "photographs", "psf.json", task)
        >>> found.evaluation.to_dataframe().pivot_table("auc", "zoom", "tilt_deg").shape
        (2, 1)
        """
        each = ("zoom", *_LISTS)
        return dataframe(
            {
                **curve.model_dump(exclude={*each, "roc", "froc"}),
                **dict(zip(each, values, strict=True)),
            }
            for curve in self.curves
            for values in zip(*(getattr(curve, name) for name in each), strict=True)
        )

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of the AUC against zoom, with its interval and bound."""
        from analysis.evaluation._plot import auc_figure  # matplotlib, for whoever looks

        return auc_figure(self, ax)


@checked
def read_evaluation(path: FilePath) -> Evaluation:
    """Read an evaluation.json.

    Parameters
    ----------
    path
        Path of the file, as the result of ``evaluate`` or ``standoff evaluate`` writes it.

    Returns
    -------
    Evaluation
        A detector's curves; ``as_d_prime`` returns curves of d', which judge limits and poses.

    Raises
    ------
    ResultsFileError
        If it cannot be read, is of another schema, or a value is missing or wrong.

    Examples
    --------
    >>> task = standoff.EvaluationTask(zooms=(1.0, 1.5), crop_px=64, crops=4)
    >>> found = standoff.evaluate("absolute-difference", "photographs", "psf.json", task)
    >>> _ = found.write("evaluation.json")
    >>> standoff.read_evaluation("evaluation.json").crops
    4
    """
    return read_document(path, Evaluation, ResultsFileError, "write it with standoff evaluate")


def is_evaluation(path: Path) -> bool:
    """Whether a file says that it is an evaluation.json."""
    try:
        if not path.is_file():  # opening a pipe would wait for its writer
            return False
        with path.open("rb") as file:
            return _EVALUATION_SCHEMA.encode() in file.read(_HEAD_BYTES)
    except OSError:
        return False


def _finite_d_prime(auc: float) -> float:
    return float(d_prime_of_auc(min(max(auc, 0.5), _MOST_AUC)))


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
