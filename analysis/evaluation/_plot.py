"""Figures of an evaluation: AUC against zoom with its bound, ROC and FROC."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from simulation.figures import InlineFigure, figure_of
from simulation.palette import PALETTE

if TYPE_CHECKING:
    from analysis.evaluation._document import Evaluation, EvaluationCurve


_PANEL_IN = 3.4
_ASIDE = 0.008
"""Of the axis of zooms, what the bars of two tilts are apart."""


def auc_figure(evaluation: "Evaluation", ax: Axes | None = None) -> Figure:
    """Plot the AUC against zoom: a panel for each noise and contrast, a colour for each tilt.

    Bars are the 95 % interval over photographs, the dashed line is the ideal linear observer. Into
    axes that are given, all curves are drawn.
    """
    if ax is not None:
        _draw_aucs(ax, evaluation.curves)
        ax.set(xlabel="zoom", ylabel="AUC", ylim=_span_of(evaluation.curves))
        ax.legend(fontsize=8, loc="lower left")
        return figure_of(ax)
    groups: dict[tuple[float, float], list[EvaluationCurve]] = {}
    for curve in evaluation.curves:
        groups.setdefault((curve.noise_dn, curve.contrast_dn), []).append(curve)
    figure = InlineFigure(figsize=(max(_PANEL_IN * len(groups), 5.2), 3.6), layout="constrained")
    panels = figure.subplots(1, len(groups), sharey=True, squeeze=False)[0]
    for axes, ((noise_dn, contrast_dn), curves) in zip(panels, groups.items(), strict=True):
        _draw_aucs(axes, curves)
        axes.set(
            title=f"noise {noise_dn:g} DN, contrast {contrast_dn:g}",
            xlabel="zoom",
            ylim=_span_of(evaluation.curves),
        )
    panels[0].set(ylabel="AUC")
    panels[-1].legend(fontsize=8, loc="lower left")
    return figure


def _span_of(curves: "Sequence[EvaluationCurve]") -> tuple[float, float]:
    """From a coin's AUC to 1, and as far below as the intervals reach."""
    return min(0.45, *(low - 0.02 for curve in curves for low in curve.auc_low)), 1.02


def _draw_aucs(axes: Axes, curves: "Sequence[EvaluationCurve]") -> None:
    for number, curve in enumerate(curves):
        aside = _ASIDE * (number - (len(curves) - 1) / 2) * (curve.zoom[-1] - 1)
        _draw_auc(axes, curve, PALETTE[number % len(PALETTE)], aside)


def _draw_auc(axes: Axes, curve: "EvaluationCurve", colour: str, aside: float) -> None:
    zoom, auc = np.array(curve.zoom) + aside, np.array(curve.auc)
    reach = np.abs(np.array([curve.auc_low, curve.auc_high]) - auc)
    axes.errorbar(
        zoom, auc, yerr=reach, fmt="o-", markersize=4, linewidth=1.2, capsize=2, color=colour,
        label=f"{curve.detector}, tilt {curve.tilt_deg:g}°",
    )  # fmt: skip
    if any(value is not None for value in curve.auc_bound):
        bound = np.array([np.nan if value is None else value for value in curve.auc_bound])
        axes.plot(
            zoom, bound, "--", linewidth=1, color=colour,
            label="ideal linear observer" if curve.tilt_deg == 0 else None,
        )  # fmt: skip


def roc_figure(curve: "EvaluationCurve") -> Figure:
    """Plot the ROC, and the FROC where the detector gives maps, a colour for each zoom."""
    count = 1 + bool(curve.froc)
    figure = InlineFigure(figsize=(3.2 * count + 0.4, 3.3), layout="constrained")
    panels = figure.subplots(1, count, squeeze=False)[0]
    shades = [f"C{number}" for number in range(len(curve.zoom))]
    for points, shade in zip(curve.roc, shades, strict=True):
        panels[0].plot(points.fpr, points.tpr, color=shade, label=f"zoom {points.zoom:g}")
    panels[0].plot([0, 1], [0, 1], ":", color="0.6", linewidth=1)
    panels[0].set(xlabel="false alarms", ylabel="changes found", xlim=(0, 1), ylim=(0, 1.01))
    panels[0].legend(fontsize=8, loc="lower right")
    if curve.froc:
        for marked in curve.froc:
            shade = shades[curve.zoom.index(marked.zoom)]
            panels[1].plot(marked.false_marks, marked.found, color=shade)
        panels[1].set(xlabel="false marks a pair", ylabel="changes marked", ylim=(0, 1.01))
        panels[1].set_xscale("symlog", linthresh=0.1)
        panels[1].set_xlim(0, None)
    return figure
