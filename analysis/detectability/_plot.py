"""Figures 4 and 5: d' against zoom, for several noises and for several contrasts."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from simulation.figures import InlineFigure, figure_of
from simulation.palette import BLUE, GREEN, ORANGE, PURPLE, SKY_BLUE, VERMILION

if TYPE_CHECKING:
    from analysis.detectability._curves import DetectabilityCurve


MODEL_COLOURS: dict[str, str] = {
    "bicubic": PURPLE,
    "paper": VERMILION,
    "matched": BLUE,
    "lmmse": GREEN,
    "kernelgan": ORANGE,
    "gaussian-kernelgan": SKY_BLUE,
}

_OBSERVER_NAMES = {
    "npw": "non-prewhitening",
    "hotelling": "Hotelling",
    "cho": "channelised Hotelling",
    "changes": "comparison (standoff changes)",
    "detector": "your own detector",
}
_OBSERVERS = tuple(_OBSERVER_NAMES)
_STYLES: Final[tuple[Literal["-", "--", ":", "-."], ...]] = ("-", "--", ":", "-.")
_WIDTHS = {"paper": 3.2, "lmmse": 2.2}
"""Models whose curves nearly coincide with that of ``matched`` show beneath it."""

_DRAWN = 200
"""Points drawn along a curve that bends between the zooms computed."""

_NAMES = {"noise_dn": "noise", "contrast_dn": "contrast"}


def draw_curve(axes: Axes, curve: "DetectabilityCurve", colour: str) -> Line2D:
    """Draw d' and its interval, interpolated between the zooms computed, which have markers."""
    zoom = np.union1d(curve.zoom, np.linspace(curve.zoom[0], curve.zoom[-1], _DRAWN))
    low, d_prime, high = (
        curve.between(values, zoom)
        for values in (curve.dprime_low, curve.dprime, curve.dprime_high)
    )
    computed = np.flatnonzero(np.isin(zoom, curve.zoom)).tolist()
    axes.fill_between(zoom, low, high, color=colour, alpha=0.15, lw=0)
    [line] = axes.plot(zoom, d_prime, color=colour, markevery=computed)
    return line


def _draw_legend(figure: Figure, handles: "Sequence[Line2D]") -> None:
    """Draw the legend below the panels, in as many columns as the figure has room for."""
    for columns in range(min(4, len(handles)), 0, -1):
        legend = figure.legend(
            handles=handles, loc="outside lower center", ncols=columns, fontsize=8
        )
        figure.draw_without_rendering()
        if legend.get_window_extent().width <= figure.bbox.width or columns == 1:
            return
        legend.remove()


def _held(curve: "DetectabilityCurve") -> str:
    """What a band holds."""
    if curve.uncertainty is None:
        return "over images and positions"
    unknown = curve.uncertainty.sources.unknown
    return "all sources" if not unknown else f"without {', '.join(unknown)} (not known)"


def curves_figure(
    curves: "Sequence[DetectabilityCurve]",
    varied: Literal["noise_dn", "contrast_dn"],
    ax: Axes | None = None,
) -> Figure:
    """Plot d' against zoom: a panel for each observer, a colour for each model.

    ``curves``: equal in contrast if the noise is varied, and vice versa. ``varied``: what the line
    styles distinguish: ``noise_dn`` is Figure 4, ``contrast_dn`` Figure 5. ``ax``: draw all
    observers here instead, each curve with its name.
    """
    if ax is not None:
        for curve in curves:
            draw_curve(ax, curve, MODEL_COLOURS[curve.model]).set(
                label=curve.name, linestyle=_STYLES[_OBSERVERS.index(curve.observer) % 4]
            )
        ax.set(
            xlabel="zoom-out z (ratio of the distances)", ylabel="detectability d′ (upper bound)"
        )
        ax.set_ylim(bottom=0)
        ax.legend(fontsize=8)
        return figure_of(ax)
    observers = list(dict.fromkeys(curve.observer for curve in curves))
    models = list(dict.fromkeys(curve.model for curve in curves))
    values = sorted({float(getattr(curve, varied)) for curve in curves})
    fixed: Literal["noise_dn", "contrast_dn"] = (
        "contrast_dn" if varied == "noise_dn" else "noise_dn"
    )
    size_in = max(2.6 * len(observers) + 1.6, 4.6), 3.5
    figure = InlineFigure(figsize=size_in, layout="constrained")
    panels = figure.subplots(1, len(observers), sharey=True, squeeze=False)[0]
    for axes, observer in zip(panels, observers, strict=True):
        for curve in curves:
            if curve.observer != observer:
                continue
            colour = MODEL_COLOURS[curve.model]
            width = _WIDTHS.get(curve.model, 1.2)
            style = _STYLES[values.index(float(getattr(curve, varied))) % len(_STYLES)]
            line = draw_curve(axes, curve, colour)
            line.set(linestyle=style, linewidth=width, zorder=3 - width / 4)
        axes.set(title=_OBSERVER_NAMES[observer], xlabel="zoom-out z (ratio of the distances)")
        axes.set_ylim(bottom=0)
    panels[0].set_ylabel("detectability d′ (upper bound)")
    handles = [
        Line2D([], [], color=MODEL_COLOURS[model], linewidth=_WIDTHS.get(model, 1.2), label=model)
        for model in models
    ]
    handles += [
        Line2D(
            [],
            [],
            color="0.3",
            linestyle=_STYLES[index % len(_STYLES)],
            label=f"{_NAMES[varied]} {value:.4g} DN",
        )
        for index, value in enumerate(values)
    ]
    _draw_legend(figure, handles)
    level = float(getattr(curves[0], fixed))
    figure.suptitle(f"{_NAMES[fixed]} {level:.4g} DN\nbands: 95 %, {_held(curves[0])}", fontsize=9)
    return figure
