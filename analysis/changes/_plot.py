"""Figure of the changes: follow-up, plain difference, unexplained difference, significance."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import AbstractPathEffect, withStroke

from acquisition.photographs import on_screen, white_level_dn
from simulation.arrays import AnyArray
from simulation.figures import InlineFigure, figure_of
from simulation.palette import VERMILION

if TYPE_CHECKING:
    from analysis.changes._filter import ChangeResult

_NUMBERED = 50
_DRAWN_PX = 1500
"""Longest side of what is drawn: a panel has some 700 pixels."""


def changes_figure(
    found: "ChangeResult", colours_dn: AnyArray | None = None, ax: Axes | None = None
) -> Figure:
    """Show the follow-up with its changes outlined, both differences and the significance.

    ``colours_dn``: the follow-up in colour, shape ``(rows, cols, 3)``, linear in light; None shows
    it in grey. ``ax``: draw the follow-up with its changes here, and no other panel.
    """
    if ax is not None:
        _draw_changes(ax, found, colours_dn)
        return figure_of(ax)
    rows, cols = found.valid.shape
    figure = InlineFigure(figsize=(9.0, 0.8 + 7.2 * rows / cols), layout="constrained")
    panels = figure.subplots(2, 2)
    step = -(-max(rows, cols) // _DRAWN_PX)
    extent = (-0.5, cols - 0.5, rows - 0.5, -0.5)
    threshold = found.summary.threshold_sd
    reach = max(float(np.percentile(np.abs(found.plain_difference_dn[found.valid]), 99.5)), 1e-6)
    _draw_changes(panels[0, 0], found, colours_dn)
    for axes, image, title, span, label in (
        (panels[0, 1], found.plain_difference_dn, "plain difference", reach, "DN"),
        (panels[1, 0], found.difference_dn, "not explained by the pose", reach, "DN"),
        (
            panels[1, 1],
            found.significance,
            f"significance, threshold {threshold:.1f}",
            2 * threshold,
            "standard deviations",
        ),
    ):
        drawn = image[::step, ::step]
        shown = axes.imshow(drawn, cmap="RdBu_r", vmin=-span, vmax=span, extent=extent)
        axes.set_title(title)
        figure.colorbar(shown, ax=axes, label=label, shrink=0.8)
    for axes in panels.flat:
        axes.set(xticks=[], yticks=[])
        axes.grid(visible=False)
    return figure


def _draw_changes(axes: Axes, found: "ChangeResult", colours_dn: AnyArray | None) -> None:
    """Draw the follow-up with its changes outlined and numbered."""
    rows, cols = found.valid.shape
    step = -(-max(rows, cols) // _DRAWN_PX)
    _draw_followup(axes, found, colours_dn, step, (-0.5, cols - 0.5, rows - 0.5, -0.5))
    # On a photograph that has the colour of the marks, they would not be seen.
    halo: list[AbstractPathEffect] = (
        [] if colours_dn is None else [withStroke(linewidth=2.5, foreground="white")]
    )
    if found.is_change.any():
        # Of blocks, lest a change of one pixel is stepped over.
        changed = np.maximum.reduceat(
            np.maximum.reduceat(found.is_change, np.arange(0, rows, step), axis=0),
            np.arange(0, cols, step),
            axis=1,
        )
        outlines = axes.contour(
            np.arange(changed.shape[1]) * step,
            np.arange(changed.shape[0]) * step,
            changed,
            levels=[0.5],
            colors=VERMILION,
            linewidths=1.0,
        )
        outlines.set_path_effects(halo)
    for number, change in enumerate(found.summary.changes[:_NUMBERED], 1):
        axes.annotate(
            str(number),
            (change.x_px, change.y_px),
            (4, 4),
            textcoords="offset points",
            color=VERMILION,
            fontsize=8,
            path_effects=halo,
        )
    count = len(found.summary.changes)
    changes = f"{count} change{'' if count == 1 else 's'}"
    axes.set_title(f"follow-up, {changes}, {found.summary.changed_px} px changed")
    axes.set(xticks=[], yticks=[])
    axes.grid(visible=False)


def _draw_followup(
    axes: Axes,
    found: "ChangeResult",
    colours_dn: AnyArray | None,
    step: int,
    extent: tuple[float, float, float, float],
) -> None:
    if colours_dn is None:
        axes.imshow(found.followup_dn[::step, ::step], cmap="gray", extent=extent)
        return
    drawn, valid = colours_dn[::step, ::step], found.valid[::step, ::step]
    white_dn = white_level_dn(drawn[valid] if valid.any() else drawn)
    axes.imshow(on_screen(drawn, white_dn), extent=extent)
