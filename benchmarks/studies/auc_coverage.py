"""How often intervals of AUC, and of TPR at 5 % false alarms, hold the truth: their methods.

Scores are binormal: a share of their variance, 0, 0.3 or 0.7, is that of the photograph, the rest
of the pair. The photograph adds to the scores of its changed and unchanged pairs alike ("shared":
it looks more changed as such), or to both kinds independently ("apart"). The AUC is known in closed
form, ``Phi(d' / sqrt 2)``, and so is the TPR, ``Phi(d' - 1.645)``. One to 40 photographs with 5 to
100 pairs of each kind, AUC 0.6 to 0.98; 1000 intervals of 95 % each (400 of TPR).

Methods, all written here but the one that ``analysis`` uses (which comes first): DeLong's variance
(independent pairs) with the normal quantile, Obuchowski's of clusters, the jackknife over
photographs of the AUC between photographs, and the bootstrap over photographs (percentiles, and its
variance); the variances plain and on the logit, with Student's quantile for the number of
photographs. Two and three photographs by the method used alone.

    OMP_NUM_THREADS=1 python -m benchmarks.studies.auc_coverage [--quick]
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from math import exp, log, sqrt

import numpy as np
from scipy.special import ndtr, ndtri, stdtrit

from analysis.evaluation.roc import auc_interval, tpr_at_fpr
from benchmarks.harness import Recorder, benchmark
from simulation.arrays import FloatArray

AUCS = (0.6, 0.8, 0.92, 0.98)
PHOTOGRAPHS = (1, 4, 10, 40)
PAIRS = (5, 20, 100)
EFFECTS = (("none", 0.0), ("shared", 0.3), ("shared", 0.7), ("apart", 0.3), ("apart", 0.7))
FPR = 0.05
RESAMPLES = 200
CHOSEN = "jackknife between photographs, logit"
GOOD = (0.93, 0.97)

Interval = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Condition:
    """What scores are drawn from."""

    effect: str
    share: float
    photographs: int
    pairs: int
    auc: float

    @property
    def d_prime(self) -> float:
        """Distance of the means."""
        return sqrt(2) * float(ndtri(self.auc))

    @property
    def tpr(self) -> float:
        """Share of changed pairs above the threshold of 5 % false alarms."""
        return float(ndtr(self.d_prime + ndtri(FPR)))

    @property
    def of_photographs(self) -> str:
        """The photographs' part, in words."""
        return f"{self.effect} {self.share:g}" if self.share else "none"

    def draw(self, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Scores without and with a change, shape (photographs, pairs)."""
        own = rng.standard_normal((2, self.photographs, 1))
        if self.effect == "shared":
            own[1] = own[0]
        each = rng.standard_normal((2, self.photographs, self.pairs))
        without, with_change = sqrt(self.share) * own + sqrt(1 - self.share) * each
        return without, with_change + self.d_prime


def _won(without: FloatArray, with_change: FloatArray) -> FloatArray:
    """Comparisons won by photograph of the changed and of the unchanged pair; no ties."""
    photographs, pairs = without.shape
    order = np.argsort(np.concatenate([without.ravel(), with_change.ravel()]))
    of = np.tile(np.repeat(np.arange(photographs), pairs), 2)[order]
    is_without = order < without.size
    one = np.zeros((order.size, photographs), np.float32)
    one[np.flatnonzero(is_without), of[is_without]] = 1
    below = np.cumsum(one, axis=0)[~is_without].astype(np.float64)
    by_changed = np.zeros((photographs, photographs))
    np.add.at(by_changed, of[~is_without], below)
    return by_changed


def _around(auc: float, variance: float, freedom: float) -> dict[str, Interval]:
    """The interval plain and in the logit; where the variance says nothing, a point."""
    quantile = float(stdtrit(freedom, 0.975)) if freedom < np.inf else float(ndtri(0.975))
    half = quantile * sqrt(max(variance, 0.0))
    spread = auc * (1 - auc)
    if spread <= 0 or half <= 0:
        return {"plain": (auc, auc), "logit": (auc, auc)}
    middle, wide = log(auc / (1 - auc)), min(half / spread, 300.0)
    low, high = (1 / (1 + exp(-(middle + sign * wide))) for sign in (-1, 1))
    return {"plain": (auc - half, auc + half), "logit": (low, high)}


def _methods(
    without: FloatArray, with_change: FloatArray, rng: np.random.Generator
) -> Iterator[tuple[str, Interval]]:
    """All methods on one set of scores."""
    photographs, pairs = without.shape
    number = np.repeat(np.arange(photographs), pairs)
    chosen = auc_interval(without.ravel(), with_change.ravel(), number, number)
    yield CHOSEN, (chosen.low, chosen.high)
    table = _won(without, with_change)
    met = pairs**2
    auc = float(table.sum() / (met * photographs**2))
    ordered = np.sort(without.ravel()), np.sort(with_change.ravel())
    placed = np.searchsorted(ordered[0], with_change) / without.size
    placed_without = 1 - np.searchsorted(ordered[1], without) / with_change.size
    delong = float(np.var(placed, ddof=1) + np.var(placed_without, ddof=1)) / without.size
    for scale, interval in _around(auc, delong, np.inf).items():
        yield f"DeLong, {scale}", interval
    if photographs == 1:
        return
    away = placed.mean(axis=1) + placed_without.mean(axis=1) - 2 * auc
    clustered = float(np.sum(away**2)) / (photographs * (photographs - 1))
    for scale, interval in _around(auc, clustered, photographs - 1).items():
        yield f"Obuchowski, {scale}", interval
    apart = table - np.diag(np.diag(table))
    between = float(apart.sum()) / (met * photographs * (photographs - 1))
    left = apart.sum() - apart.sum(axis=0) - apart.sum(axis=1)
    away = left / (met * (photographs - 1) * (photographs - 2)) - between
    jackknife = float(np.sum(away**2)) * (photographs - 1) / photographs
    yield (
        "jackknife between photographs, plain",
        _around(between, jackknife, photographs - 1)["plain"],
    )
    drawn = rng.multinomial(photographs, np.full(photographs, 1 / photographs), RESAMPLES)
    again = np.sum((drawn @ table) * drawn, axis=1) / (met * photographs**2)
    low, high = np.quantile(again, (0.025, 0.975)).tolist()
    yield "bootstrap, percentiles", (low, high)
    spread = float(np.var(again, ddof=1)) * photographs / (photographs - 1)
    for scale, interval in _around(auc, spread, photographs - 1).items():
        yield f"bootstrap, {scale}", interval


def _tpr_methods(
    without: FloatArray, with_change: FloatArray, rng: np.random.Generator
) -> Iterator[tuple[str, Interval]]:
    """The method of ``analysis``, that of independent pairs, and the bootstrap's."""
    photographs, pairs = without.shape
    number = np.repeat(np.arange(photographs), pairs)
    found = tpr_at_fpr(without.ravel(), with_change.ravel(), number, number, FPR)
    name = "larger of jackknife and slope, logit" if found.is_by_photograph else "pairs, logit"
    yield name, (found.low, found.high)
    if photographs == 1:
        return
    alone = np.zeros_like(number)
    single = tpr_at_fpr(without.ravel(), with_change.ravel(), alone, alone, FPR)
    yield "pairs, logit", (single.low, single.high)
    if photographs > 10 or pairs > 20:
        return
    again = []
    for _ in range(RESAMPLES // 2):
        drawn = rng.integers(0, photographs, photographs)
        level = np.quantile(without[drawn], 1 - FPR, method="weibull")
        again.append(float(np.mean(with_change[drawn] > level)))
    low, high = np.quantile(again, (0.025, 0.975)).tolist()
    yield "bootstrap, percentiles", (low, high)
    spread = float(np.var(again, ddof=1)) * photographs / (photographs - 1)
    yield "bootstrap, logit", _around(found.tpr, spread, photographs - 1)["logit"]


@dataclass(slots=True, kw_only=True)
class _Tally:
    """How often intervals held the truth, and how wide they were."""

    runs: int = 0
    held: int = 0
    width: float = 0.0

    @property
    def coverage(self) -> float:
        """Share that held it."""
        return self.held / self.runs


def _tally(condition: _Condition, runs: int, *, of_tpr: bool) -> dict[str, _Tally]:
    """One condition, again and again."""
    tallies: dict[str, _Tally] = defaultdict(_Tally)
    seeds = (100 * condition.auc, 10 * condition.share, condition.photographs, condition.pairs)
    rng = np.random.default_rng([*map(round, seeds), len(condition.effect)])
    truth = condition.tpr if of_tpr else condition.auc
    for _ in range(runs):
        scores = condition.draw(rng)
        for name, (low, high) in (_tpr_methods if of_tpr else _methods)(*scores, rng):
            found = tallies[name]
            found.runs += 1
            found.held += low <= truth <= high
            found.width += high - low
    return tallies


def _study(record: Recorder, runs: int, *, of_tpr: bool) -> None:
    """All conditions: a row for each of the chosen method, and what each method does over all."""
    what = "TPR" if of_tpr else "AUC"
    over: dict[tuple[str, int], list[float]] = defaultdict(list)
    record.say(f"{what}: coverage in % (mean width) at AUC {', '.join(map(str, AUCS))}")
    for (effect, share), photographs, pairs in product(EFFECTS, PHOTOGRAPHS, PAIRS):
        cells = []
        for auc in AUCS:
            condition = _Condition(
                effect=effect, share=share, photographs=photographs, pairs=pairs, auc=auc
            )
            tallies = _tally(condition, runs, of_tpr=of_tpr)
            for name, found in tallies.items():
                alone = ", photographs differ" if photographs == 1 and share else ""
                over[name + alone, photographs].append(found.coverage)
            chosen = next(iter(tallies.values()))
            cells.append(f"{100 * chosen.coverage:.1f} ({chosen.width / chosen.runs:.3f})")
        record.say(
            f"| {condition.of_photographs} | {photographs} x {pairs} | {' | '.join(cells)} |"
        )
    for (name, photographs), coverages in sorted(over.items(), key=lambda row: row[0][::-1]):
        good = np.mean([GOOD[0] <= each <= GOOD[1] for each in coverages])
        low, middle, high = np.quantile(coverages, (0, 0.5, 1)).tolist()
        record.say(
            f"| {what} | {photographs} | {name} | {100 * low:.1f} | {100 * middle:.1f} |"
            f" {100 * high:.1f} | {100 * good:.0f} % of {len(coverages)} |"
        )
        record.figure(f"{what} held at least, {name}, {photographs} photographs", 100 * low, "%")


def _few_photographs(record: Recorder, runs: int) -> None:
    """AUC of two and three photographs, by the method of ``analysis`` alone."""
    for (effect, share), photographs in product(EFFECTS, (2, 3)):
        cells = []
        number = np.repeat(np.arange(photographs), 20)
        for auc in AUCS:
            condition = _Condition(
                effect=effect, share=share, photographs=photographs, pairs=20, auc=auc
            )
            rng = np.random.default_rng([round(100 * auc), round(10 * share), photographs])
            found = _Tally()
            for _ in range(runs):
                without, with_change = condition.draw(rng)
                one = auc_interval(without.ravel(), with_change.ravel(), number, number)
                found.runs += 1
                found.held += one.low <= auc <= one.high
                found.width += one.high - one.low
            cells.append(f"{100 * found.coverage:.1f} ({found.width / found.runs:.3f})")
        record.say(f"| {condition.of_photographs} | {photographs} x 20 | {' | '.join(cells)} |")


@benchmark("numpy", "scipy")
def main(record: Recorder) -> None:
    _study(record, record.pick(1000, 20), of_tpr=False)
    _study(record, record.pick(400, 20), of_tpr=True)
    _few_photographs(record, record.pick(1000, 20))
