"""Figures of a pose's quality and of the allowed movement."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from acquisition.photographs import luma_plane, on_screen, white_level_dn
from analysis.choices import acceptance
from analysis.detectability import draw_curve
from simulation.arrays import AnyArray
from simulation.figures import InlineFigure, figure_of
from simulation.palette import BLUE, VERMILION

if TYPE_CHECKING:
    from analysis.pose._limits import PoseLimits
    from analysis.pose._quality import PoseQuality


_DRAWN_PX = 1500
"""Longest side of a photograph in colour: a panel has some 700 pixels."""


def pose_figure(
    followup: AnyArray | None,
    quality: "PoseQuality",
    ax: Axes | None = None,
    said: str | None = None,
) -> Figure:
    """Show d' over the follow-up, with the border of what is below the threshold.

    The map lies on grey levels: on colours, its own would be others. A follow-up in colour is shown
    beside it with the same border. ``followup``: shape ``(rows, cols)``, or ``(rows, cols, 3)`` in
    colour, linear in light; None shows the map alone. ``said``: one more line of the title.
    """
    rows, cols = (quality.d_prime if followup is None else followup).shape[:2]
    panels = 2 if ax is None and followup is not None and followup.ndim == 3 else 1
    width_in = (6.0, 10.8)[panels - 1]
    if ax is None:
        own = InlineFigure(figsize=(width_in, 1.0 + 4.6 * rows / cols), layout="constrained")
        *beside, axes = own.subplots(1, panels, squeeze=False)[0]
    else:
        beside, axes = [], ax
    figure = figure_of(axes)
    if followup is not None:
        axes.imshow(luma_plane(followup) if followup.ndim == 3 else followup, cmap="gray")
    extent = (-0.5, cols - 0.5, rows - 0.5, -0.5)
    top = max(float(np.nanmax(quality.d_prime)), quality.min_d_prime)
    shown = axes.imshow(
        quality.d_prime,
        extent=extent,
        cmap="viridis",
        vmin=0,
        vmax=top,
        alpha=1.0 if followup is None else 0.55,
    )
    for coloured in beside:
        assert followup is not None, "it is shown beside the map"
        step = -(-max(rows, cols) // _DRAWN_PX)
        drawn = followup[::step, ::step]
        coloured.imshow(on_screen(drawn, white_level_dn(drawn)), extent=extent)
        coloured.set(title="follow-up", xlabel="follow-up x / px", ylabel="follow-up y / px")
        coloured.grid(visible=False)
    low, high = np.nanmin(quality.d_prime), np.nanmax(quality.d_prime)
    if low < quality.min_d_prime <= high:
        for panel in (*beside, axes):
            border = panel.contour(
                np.linspace(0, cols - 1, quality.d_prime.shape[1]),
                np.linspace(0, rows - 1, quality.d_prime.shape[0]),
                quality.d_prime,
                levels=[quality.min_d_prime],
                colors=VERMILION,
            )
            if panel is not axes:
                border.set_path_effects([withStroke(linewidth=3, foreground="white")])
    figure.colorbar(shown, ax=axes, label="local d′ (upper bound)", shrink=0.85)
    verdict = acceptance(quality.is_accepted)
    probability = quality.decision.probability_text.replace("d'", "d′")
    axes.set(
        title=(
            f"{verdict}: {quality.criterion} d′ {quality.decisive_d_prime:.2f}, "
            f"threshold {quality.min_d_prime:g}\n"
            f"{quality.decision.verdict}: {probability}" + ("" if said is None else f"\n{said}")
        ),
        xlabel="follow-up x / px",
        ylabel="follow-up y / px",
    )
    axes.grid(visible=False)
    return figure


def limits_figure(limits: "PoseLimits", ax: Axes | None = None) -> Figure:
    """Plot d' against zoom with the threshold, and the allowed zoom against the tilt.

    Dots are what was computed. Into axes that are given, d' is drawn alone.
    """
    if ax is not None:
        _draw_limit(ax, limits)
        return figure_of(ax)
    figure = InlineFigure(figsize=(8.4, 3.4), layout="constrained")
    against_zoom, against_tilt = figure.subplots(1, 2)
    _draw_limit(against_zoom, limits)
    known = [(tilt, zoom) for tilt, zoom in limits.zoom_by_tilt if zoom is not None]
    if limits.tilt_deg is not None and all(tilt != limits.tilt_deg for tilt, _ in known):
        known = sorted([*known, (limits.tilt_deg, 1.0)])
    tilts, zooms = [t for t, _ in known], [z for _, z in known]
    against_tilt.plot(tilts, zooms, color=BLUE, marker="o", markersize=3)
    against_tilt.fill_between(tilts, 1.0, zooms, color=BLUE, alpha=0.15, lw=0)
    against_tilt.set(
        xlabel="tilt of the follow-up / degrees",
        ylabel="allowed zoom-out z",
        title="shaded: allowed",
    )
    return figure


def _draw_limit(axes: Axes, limits: "PoseLimits") -> None:
    curve = limits.curve
    line = draw_curve(axes, curve, BLUE)
    line.set(marker="o", markersize=3, label=f"{curve.model} {curve.observer}")
    axes.axhline(limits.min_d_prime, color=VERMILION, linestyle="--", label="threshold")
    axes.axvline(limits.zoom, color="0.4", linestyle=":", label=f"limit {limits.zoom:.3g}")
    axes.set(xlabel="zoom-out z (ratio of the distances)", ylabel="detectability d′ (upper bound)")
    axes.set_ylim(bottom=0)
    axes.legend(fontsize=8)
