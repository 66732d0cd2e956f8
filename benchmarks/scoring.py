"""How answers are scored: errors of estimates, shares, and pixels that a detector flags."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import nan

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter
from scipy.stats import binomtest

from analysis.reports import in_report_style, new_figure
from simulation.arrays import BoolArray, FloatArray

_Z95 = 1.959964
_COLOURS = ("#D55E00", "#0072B2", "#009E73")


@dataclass(slots=True)
class Errors:
    """Errors of estimates over their standard errors (or a bound) and over the truth."""

    scaled: list[float] = field(default_factory=list)
    relative: list[float] = field(default_factory=list)
    held: int = 0
    missed: int = 0

    def add(
        self, found: float | None, err: float | None, truth: float, bound: float | None = None
    ) -> None:
        """Count an estimate; without a value or a standard error it is missed."""
        if found is None or err is None:
            self.missed += 1
            return
        error = found - truth
        self.scaled.append(error / (bound or err))
        self.relative.append(error / truth)
        self.held += abs(error) <= _Z95 * err

    @property
    def rms(self) -> float:
        """RMS of the scaled errors; NaN of none."""
        return float(np.sqrt(np.mean(np.square(self.scaled)))) if self.scaled else nan

    @property
    def most(self) -> float:
        """Largest of the scaled errors; NaN of none."""
        return float(np.abs(self.scaled).max()) if self.scaled else nan

    @property
    def coverage(self) -> float:
        """Share of the 95 % intervals that hold the truth, in %."""
        return 100 * self.held / len(self.scaled) if self.scaled else 0.0

    @property
    def worst(self) -> float:
        """Largest relative error in %."""
        return 100 * float(np.abs(self.relative).max())


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """A share in %, with its 95 % interval by Wilson."""

    percent: float
    low: float
    high: float

    @classmethod
    def of(cls, hits: int, total: int) -> "Share":
        """Of so many; NaN of none."""
        if total == 0:
            return cls(percent=nan, low=nan, high=nan)
        interval = binomtest(hits, total).proportion_ci(method="wilson")
        return cls(percent=100 * hits / total, low=100 * interval.low, high=100 * interval.high)

    def __str__(self) -> str:
        return f"{self.percent:5.1f} [{self.low:4.1f}, {self.high:5.1f}]"


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Roc:
    """Receiver operating characteristic of a score; both rates rise as the threshold falls."""

    true_positive_rate: FloatArray
    false_positive_rate: FloatArray
    negatives: int

    def false_at(self, true_positive_rate: float) -> int:
        """Pixels without a change that are flagged where at least this share is found."""
        index = int(np.searchsorted(self.true_positive_rate, true_positive_rate - 1e-12))
        return round(float(self.false_positive_rate[index]) * self.negatives)


def roc_of(with_change: FloatArray, without: FloatArray) -> Roc:
    """Compute the curve from scores of pixels with and without a change; both have to be there."""
    if not with_change.size or not without.size:
        raise ValueError("scores with and without a change are needed")
    levels = np.unique(np.concatenate([with_change.ravel(), without.ravel()]))[::-1]
    hits = np.searchsorted(np.sort(with_change.ravel()), levels, side="left")
    alarms = np.searchsorted(np.sort(without.ravel()), levels, side="left")
    return Roc(
        true_positive_rate=np.concatenate([[0.0], 1 - hits / with_change.size]),
        false_positive_rate=np.concatenate([[0.0], 1 - alarms / without.size]),
        negatives=without.size,
    )


def changed_and_clear(change: FloatArray, valid: BoolArray) -> tuple[BoolArray, BoolArray]:
    """Pixels in the core of a spot, and those that hold nothing of one."""
    peak = change.max()
    clear = gaussian_filter(change, 1.0) < 0.005 * peak
    return valid & (change > 0.5 * peak), valid & clear


@dataclass(slots=True)
class PixelScores:
    """A detector's scores in spots and elsewhere, one array a frame."""

    inside: list[FloatArray] = field(default_factory=list)
    outside: list[FloatArray] = field(default_factory=list)

    def add(self, score: FloatArray, core: BoolArray, clear: BoolArray) -> None:
        """Add a frame."""
        self.inside.append(score[core])
        self.outside.append(score[clear])

    def roc(self) -> Roc:
        """Of all frames together."""
        return roc_of(np.concatenate(self.inside), np.concatenate(self.outside))

    def false_a_frame(self, rates: Sequence[float]) -> list[float]:
        """False pixels a frame where these shares are found."""
        roc = self.roc()
        return [roc.false_at(rate) / len(self.inside) for rate in rates]


@in_report_style
def plot_change_roc(rocs: dict[str, Roc]) -> Figure:
    """Plot true against false positives, the latter on a logarithmic axis, by name."""
    figure = new_figure(5.2, 3.6)
    axes = figure.subplots()
    for (name, roc), colour in zip(rocs.items(), _COLOURS, strict=False):
        # A rate below one pixel cannot be measured.
        rate = np.maximum(roc.false_positive_rate, 0.5 / roc.negatives)
        axes.plot(rate, roc.true_positive_rate, color=colour, label=name, drawstyle="steps-post")
    axes.set(
        xscale="log",
        xlim=(min(0.5 / roc.negatives for roc in rocs.values()), 1.0),
        ylim=(0.0, 1.02),
        xlabel="false positives / pixels without a change",
        ylabel="true positives / pixels with one",
    )
    axes.legend(loc="lower left")
    return figure
