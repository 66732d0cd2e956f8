"""Scores the track of changes, and the contrast from which a change is found.

The curve's two coefficients maximise Firth's penalised likelihood. It is finite also where every
spot above an amplitude is found and none below, where the plain likelihood has no maximum; the
amplitude of 50 % is then between the two.

References
----------
D. Firth, "Bias reduction of maximum likelihood estimates", Biometrika 80, 1993; G. Heinze,
M. Schemper, "A solution to the problem of separation in logistic regression", Statistics in
Medicine 21, 2002.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, log

import numpy as np

from analysis.benchmark._change_answers import (
    FALSE_PIXELS,
    JudgedPair,
    PlaceSteps,
    TruePair,
    false_regions,
    judged,
    level_exceeded_by,
    own_detections,
)
from analysis.benchmark._data_set import BenchmarkData, ChangesTask, ChangesTruth, Places, TaskList
from analysis.benchmark._program_files import ProgramFiles
from analysis.benchmark.scores import (
    ANSWERED,
    Announce,
    Estimate,
    Relation,
    ScoreList,
    certain_share,
    estimate,
    groups_of,
    percentiles,
    scene_draws,
    scene_numbers,
    share,
    share_of_sums,
)
from analysis.errors import ResultsFileError
from analysis.evaluation.roc import auc_interval
from simulation.arrays import BoolArray, FloatArray, IntArray

_STEPS = 60
_CLOSE = 1e-9
_LONGEST_STEP = 2.0
_STEEPEST = 200.0
_LARGEST_LOGIT = 500.0


def limits_of(
    amplitudes: FloatArray, is_found: BoolArray, weights: FloatArray, shares: Sequence[float]
) -> FloatArray:
    """Amplitudes from which on shares of the spots are found, for several draws of the spots.

    Parameters
    ----------
    amplitudes
        Of the spots, positive, shape (n,).
    is_found
        Of each in each draw, shape (draws, n).
    weights
        How often each counts, shape (draws, n); not all 0 in a draw.
    shares
        Those wanted, each between 0 and 1.

    Returns
    -------
    ndarray of float64, shape (shares, draws)
        At least the smallest amplitude, never an extrapolation; infinite beyond the largest one.
    """
    of_log = np.log(amplitudes)
    least, most = float(of_log.min()), float(of_log.max())
    middle = weights @ of_log / weights.sum(axis=1)
    level, slope = _logistic(of_log - middle[:, None], is_found.astype(np.float64), weights)
    logits = np.array([log(share / (1 - share)) for share in shares])[:, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        reached = np.where(slope > 0, middle + (logits - level) / slope, least)
    is_reached = level + slope * (most - middle) >= logits
    return np.where(is_reached, np.exp(np.clip(reached, least, most)), inf)


def limit_estimate(amplitudes: FloatArray, limits: FloatArray) -> Estimate:
    """Return a limit with its interval; a bound where the amplitudes tried do not reach it.

    Parameters
    ----------
    amplitudes
        Of all spots, shape (n,).
    limits
        That of all spots, and those of draws, shape (1 + draws,); infinite beyond the largest.
    """
    least, most = float(amplitudes.min()), float(amplitudes.max())
    value, drawn = float(limits[0]), limits[1:]
    ends = percentiles(drawn) if drawn.size else (inf, inf)
    low, high = (None if end == inf else end for end in ends)
    if value == inf:
        return Estimate(value=most, low=low, high=None, relation=">")
    relation: Relation = "<" if value <= least * (1 + _CLOSE) else "="
    return Estimate(value=value, low=low, high=high, relation=relation)


def _logistic(x: FloatArray, hit: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Level and slope of the logit of each draw by Newton's steps on Firth's score.

    All arguments have shape (draws, n), the weighted mean of ``x`` is 0.
    """
    beta = np.zeros((2, len(x)))
    for _ in range(_STEPS):
        logit = np.clip(beta[0][:, None] + beta[1][:, None] * x, -_LARGEST_LOGIT, _LARGEST_LOGIT)
        chance = 1 / (1 + np.exp(-logit))
        spread = weight * chance * (1 - chance)
        a, b, c = spread.sum(axis=1), (spread * x).sum(axis=1), (spread * x**2).sum(axis=1)
        a, c = a + 1e-300, c + _CLOSE * a + 1e-300  # of one amplitude there is no slope
        determinant = np.maximum(a * c - b**2, 1e-300)
        leverage = spread * (c[:, None] - 2 * b[:, None] * x + a[:, None] * x**2)
        away = weight * (hit - chance) + leverage / determinant[:, None] * (0.5 - chance)
        level, slope = away.sum(axis=1), (away * x).sum(axis=1)
        step = np.stack([c * level - b * slope, a * slope - b * level]) / determinant
        longest = np.abs(step).max(axis=0)
        step *= np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, _CLOSE))
        beta = np.clip(beta + step, -_STEEPEST, _STEEPEST)
        if longest.max() < _CLOSE:
            break
    return beta[0], beta[1]


PLACES_A_FRAME, FEW_PLACES_A_FRAME = 1.0, 0.1
SHARES = (50, 80)

_DRAWS_OF_LIMITS = 400

_Judged = tuple[TruePair, JudgedPair, int]
"""A pair, what a program's map says of it, and the number of its scene."""

_Add = Callable[[str, Estimate | None], None]


def score_changes(
    data: BenchmarkData, files: ProgramFiles, program: str, advance_to: Announce
) -> ScoreList:
    """Score a program's change maps and its own detections.

    Raises
    ------
    ResultsFileError
        If a file of the data set or of the program cannot be used.
    """
    truth = data.read("truth/changes.json", ChangesTruth)
    tasks = data.read("changes/tasks.json", TaskList[ChangesTask]).by_name
    paths = files.pictures("changes", truth.tasks)
    detections = files.detections(truth.tasks)
    missing = next((name for name in truth.tasks if name not in tasks), None)
    if missing is not None:
        raise ResultsFileError(f"{data.folder}: task {missing} is not in changes/tasks.json")
    pairs = [
        TruePair.read(data, tasks[name], truth.tasks[name], truth.levels_per_dn)
        for name in sorted(truth.tasks)
    ]
    unchanged = [one for one in pairs if not one.truth.changed]
    pixels = sum(one.shape[0] * one.shape[1] for one in unchanged)
    answers: list[JudgedPair | None] = []
    for done, pair in enumerate(pairs):
        path = paths.get(pair.name)
        answers.append(None if path is None else judged(pair, path, len(unchanged), pixels))
        advance_to(done + 1)
    scores = ScoreList(program=program, track="changes")
    for group, members in groups_of([(f"kind {one.truth.kind}",) for one in pairs]):
        of_group = _Group(
            pairs=[pairs[at] for at in members], answers=[answers[at] for at in members]
        )
        if paths:
            of_group.score(scores, group)
        if detections is not None:
            _score_own(scores, group, of_group.pairs, detections)
    return scores


@dataclass(frozen=True, slots=True, kw_only=True)
class _Spots:
    """The spots of a group: amplitudes, noise, score, and number of the scene, shape (n,) each."""

    amplitude_dn: FloatArray
    noise_dn: FloatArray
    score: FloatArray
    scene: IntArray


class _Group:
    """Pairs of a kind, and a program's answers."""

    def __init__(self, *, pairs: Sequence[TruePair], answers: Sequence[JudgedPair | None]) -> None:
        self.pairs = pairs
        self._answers = answers
        self._scenes = scene_numbers([one.truth.scene for one in pairs])
        self._done = [
            (pair, answer, int(scene))
            for pair, answer, scene in zip(pairs, answers, self._scenes, strict=True)
            if answer is not None
        ]

    def score(self, scores: ScoreList, group: str) -> None:
        """Add the scores of the maps."""
        done, count = len(self._done), len(self.pairs)

        def add(measure: str, found: Estimate | None) -> None:
            scores.add(group, measure, found, done, count)

        add(ANSWERED, share([one is not None for one in self._answers], self._scenes))
        unchanged = [one for one in self._done if not one[0].truth.changed]
        changed = [one for one in self._done if one[0].truth.changed]
        spots = self._spots()
        if not unchanged or not spots.score.size:
            return
        self._score_limits(add, unchanged, spots)
        if changed:
            add("auc", _auc(unchanged, changed))
            add("pixels_found", self._pixels_found(unchanged))

    def _score_limits(
        self,
        add: _Add,
        unchanged: Sequence[_Judged],
        spots: _Spots,
    ) -> None:
        steps = PlaceSteps.of([one.counts for _, one, _ in unchanged if one.counts is not None])
        scenes = np.array([scene for _, _, scene in unchanged])
        draws = scene_draws(int(self._scenes.max()) + 1, _DRAWS_OF_LIMITS)
        at_one = _Thresholds.of(steps, scenes, PLACES_A_FRAME, draws)
        add("spots_found", at_one.share_found(spots))
        for scale, unit in ((np.ones_like(spots.noise_dn), "dn"), (spots.noise_dn, "noises")):
            if np.all(scale > 0):
                limits = at_one.limits(spots, spots.amplitude_dn / scale)
                for percent, limit in zip(SHARES, limits, strict=True):
                    add(f"limit_{percent}_{unit}", limit)
        if FEW_PLACES_A_FRAME * len(unchanged) >= 1:
            strict = _Thresholds.of(steps, scenes, FEW_PLACES_A_FRAME, draws)
            add("limit_50_dn_strict", strict.limits(spots, spots.amplitude_dn)[0])
        changed = [one for one in self._done if one[0].truth.changed]
        if changed:
            false = [false_regions(pair, one.path, at_one.level) for pair, one, _ in changed]
            of_scenes = np.array([scene for _, _, scene in changed])
            add("false_places", estimate(np.array(false, np.float64), of_scenes, np.mean))

    def _spots(self) -> _Spots:
        """Those that can be seen, of all pairs; of a pair that was not judged none is found."""
        rows = []
        for pair, answer, scene in zip(self.pairs, self._answers, self._scenes, strict=True):
            for at, spot in enumerate(pair.seen):
                score = -np.inf if answer is None else float(answer.spot_scores[at])
                rows.append((spot.amplitude_dn, spot.noise_dn, score, scene))
        table = np.array(rows, np.float64).reshape(-1, 4)
        return _Spots(
            amplitude_dn=table[:, 0],
            noise_dn=table[:, 1],
            score=table[:, 2],
            scene=table[:, 3].astype(np.int64),
        )

    def _pixels_found(self, unchanged: Sequence[_Judged]) -> Estimate | None:
        pixels = sum(one.judged_px for _, one, _ in unchanged)
        level = level_exceeded_by([one.top for _, one, _ in unchanged], pixels, FALSE_PIXELS)
        sums, scenes = [], []
        for pair, answer, scene in zip(self.pairs, self._answers, self._scenes, strict=True):
            if pair.is_painted is not None:
                found = 0 if answer is None else int(np.sum(answer.painted > level))
                sums.append((found, int(pair.is_painted.sum())))
                scenes.append(int(scene))
        return share_of_sums(np.array(sums, np.float64), np.array(scenes))


@dataclass(frozen=True, slots=True, kw_only=True)
class _Thresholds:
    """The threshold of all scenes and that of each draw of them, shape (1 + draws,).

    ``draws`` says how often each scene counts, shape (1 + draws, scenes), at first once each.
    """

    levels: FloatArray
    draws: IntArray

    @classmethod
    def of(
        cls, steps: PlaceSteps, scenes: IntArray, places: float, draws: IntArray
    ) -> "_Thresholds":
        """Thresholds at so many places a frame.

        A draw without unchanged pairs is left out, and all are of a single scene.
        """
        once = np.ones((1, draws.shape[1]), np.int64)
        used = draws[(draws[:, scenes].sum(axis=1) > 0) & (draws.shape[1] > 1)]
        used = np.concatenate([once, used])
        levels = [steps.threshold(places, draw[scenes].astype(np.float64)) for draw in used]
        return cls(levels=np.array(levels), draws=used)

    @property
    def level(self) -> float:
        """That of all scenes."""
        return float(self.levels[0])

    def share_found(self, spots: _Spots) -> Estimate:
        """Share of the spots found, in percent."""
        is_found, weights = self._counted(spots)
        if is_found[0].all() or not is_found[0].any():
            return certain_share(float(is_found[0, 0]), spots.scene)
        shares = 100 * np.sum(weights * is_found, axis=1) / weights.sum(axis=1)
        low, high = percentiles(shares[1:]) if shares.size > 1 else (None, None)
        return Estimate(value=float(shares[0]), low=low, high=high)

    def limits(self, spots: _Spots, amplitudes: FloatArray) -> list[Estimate]:
        """Limits of detection at each of ``SHARES``."""
        limits = limits_of(amplitudes, *self._counted(spots), [one / 100 for one in SHARES])
        return [limit_estimate(amplitudes, one) for one in limits]

    def _counted(self, spots: _Spots) -> tuple[BoolArray, FloatArray]:
        """Which spots are found and how often each counts, in all draws that have spots.

        A map that judges nothing at a spot finds it at no threshold.
        """
        weights = self.draws[:, spots.scene].astype(np.float64)
        has_spots = weights.sum(axis=1) > 0
        levels = self.levels[has_spots, None]
        is_found = (spots.score > levels) & (spots.score > -np.inf)
        return np.asarray(is_found, np.bool_), weights[has_spots]


def _auc(
    unchanged: Sequence[_Judged],
    changed: Sequence[_Judged],
) -> Estimate:
    of_kinds = [
        (np.array([one.largest for _, one, _ in kind]), np.array([scene for _, _, scene in kind]))
        for kind in (unchanged, changed)
    ]
    (lower, of_lower), (higher, of_higher) = of_kinds
    found = auc_interval(lower, higher, of_lower, of_higher)
    return Estimate(value=found.auc, low=found.low, high=found.high)


def _score_own(
    scores: ScoreList, group: str, pairs: Sequence[TruePair], detections: Mapping[str, Places]
) -> None:
    """Add the scores of a program's own detections; a pair that it does not name has none."""
    own = [own_detections(pair, detections.get(pair.name, [])) for pair in pairs]
    scenes = scene_numbers([one.truth.scene for one in pairs])
    named = sum(pair.name in detections for pair in pairs)

    def add(measure: str, found: Estimate | None) -> None:
        scores.add(group, measure, found, named, len(pairs))

    counts = np.array([(one.found, one.false_places, one.spots) for one in own], np.float64)
    found, false_places, spots = counts.T
    add("own_precision", share_of_sums(np.column_stack([found, found + false_places]), scenes))
    add("own_recall", share_of_sums(np.column_stack([found, spots]), scenes))
    add("own_false_places", estimate(false_places, scenes, np.mean))
