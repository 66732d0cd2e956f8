"""ROC of a change detector: unchanged pixels flagged against changed ones found."""

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from analysis.reports import in_report_style, new_figure
from simulation.arrays import FloatArray

__all__ = ["Roc", "plot_change_roc", "roc_of"]

_COLOURS = ("#D55E00", "#0072B2", "#009E73")


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
