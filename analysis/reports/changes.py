"""Picture of what changed: follow-up, plain difference, what is left of it, significance."""

import numpy as np
from matplotlib.figure import Figure

from analysis.change_roc import Roc
from analysis.changes import ChangeResult, FloatArray
from analysis.reports.page import in_report_style, new_figure

__all__ = ["plot_change_roc", "plot_changes"]

_COLOURS = ("#D55E00", "#0072B2", "#009E73")


@in_report_style
def plot_changes(followup_dn: FloatArray, found: ChangeResult) -> Figure:
    """Show the follow-up with its changes outlined, both differences and the significance."""
    rows, cols = followup_dn.shape
    figure = new_figure(9.0, 0.8 + 7.2 * rows / cols)
    panels = figure.subplots(2, 2)
    reach = max(float(np.percentile(np.abs(found.plain_difference_dn[found.valid]), 99.5)), 1e-6)
    panels[0, 0].imshow(followup_dn, cmap="gray")
    if found.is_change.any():
        panels[0, 0].contour(found.is_change, levels=[0.5], colors="#D55E00", linewidths=1.0)
    panels[0, 0].set_title(f"follow-up, {int(found.is_change.sum())} px changed")
    for axes, image, title, span, label in (
        (panels[0, 1], found.plain_difference_dn, "plain difference", reach, "DN"),
        (panels[1, 0], found.difference_dn, "what the pose does not explain", reach, "DN"),
        (
            panels[1, 1],
            found.significance,
            f"significance, threshold {found.threshold:.1f}",
            2 * found.threshold,
            "standard deviations",
        ),
    ):
        shown = axes.imshow(image, cmap="RdBu", vmin=-span, vmax=span)
        axes.set_title(title)
        figure.colorbar(shown, ax=axes, label=label, shrink=0.8)
    for axes in panels.flat:
        axes.set(xticks=[], yticks=[])
        axes.grid(visible=False)
    return figure


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
