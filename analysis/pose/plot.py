"""Figures of a pose's quality and of the allowed movement."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from analysis.detectability import draw_curve
from analysis.screen import on_screen, white_level_dn
from calibration.psf import luma_plane
from simulation.arrays import AnyArray

if TYPE_CHECKING:
    from analysis.pose.limits import PoseLimits
    from analysis.pose.quality import PoseQuality


_BLUE, _RED = "#0072B2", "#D55E00"
_DRAWN_PX = 1500
"""Longest side of a photograph in colour: a panel has some 700 pixels."""


def pose_figure(followup: AnyArray, quality: "PoseQuality") -> Figure:
    """Show d' over the follow-up, with the border of what is below the threshold.

    The map lies on grey levels: on colours, its own would be others. A follow-up in colour is shown
    beside it with the same border.

    Parameters
    ----------
    followup
        Shape ``(rows, cols)``, or ``(rows, cols, 3)`` in colour, linear in light.
    quality
        Of its pose.
    """
    rows, cols = followup.shape[:2]
    panels = 2 if followup.ndim == 3 else 1
    width_in = (6.0, 10.8)[panels - 1]
    figure = Figure(figsize=(width_in, 1.0 + 4.6 * rows / cols), layout="constrained")
    *beside, axes = figure.subplots(1, panels, squeeze=False)[0]
    axes.imshow(luma_plane(followup) if beside else followup, cmap="gray")
    extent = (-0.5, cols - 0.5, rows - 0.5, -0.5)
    top = max(float(np.nanmax(quality.d_prime)), quality.min_d_prime)
    shown = axes.imshow(
        quality.d_prime, extent=extent, cmap="viridis", vmin=0, vmax=top, alpha=0.55
    )
    for coloured in beside:
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
                colors=_RED,
            )
            if panel is not axes:
                border.set_path_effects([withStroke(linewidth=3, foreground="white")])
    figure.colorbar(shown, ax=axes, label="local d′ (upper bound)", shrink=0.85)
    verdict = "accepted" if quality.is_accepted else "rejected"
    axes.set(
        title=(
            f"{verdict}: {quality.criterion} d′ {quality.decisive_d_prime:.2f}, "
            f"threshold {quality.min_d_prime:g}\n"
            f"{quality.decision.verdict}: {_primed(quality.decision.probability_text)}"
        ),
        xlabel="follow-up x / px",
        ylabel="follow-up y / px",
    )
    axes.grid(visible=False)
    return figure


def limits_figure(limits: "PoseLimits") -> Figure:
    """Plot d' against zoom with the threshold, and the allowed zoom against the tilt.

    Dots are what was computed.
    """
    curve = limits.curve
    figure = Figure(figsize=(8.4, 3.4), layout="constrained")
    against_zoom, against_tilt = figure.subplots(1, 2)
    line = draw_curve(against_zoom, curve, _BLUE)
    line.set(marker="o", markersize=3, label=f"{curve.model} {curve.observer}")
    against_zoom.axhline(limits.min_d_prime, color=_RED, linestyle="--", label="threshold")
    against_zoom.axvline(limits.zoom, color="0.4", linestyle=":", label=f"limit {limits.zoom:.3g}")
    against_zoom.set(
        xlabel="zoom-out z (ratio of the distances)", ylabel="detectability d′ (upper bound)"
    )
    against_zoom.set_ylim(bottom=0)
    against_zoom.legend(fontsize=8)
    known = [(tilt, zoom) for tilt, zoom in limits.zoom_by_tilt if zoom is not None]
    if limits.tilt_deg is not None and all(tilt != limits.tilt_deg for tilt, _ in known):
        known = sorted([*known, (limits.tilt_deg, 1.0)])
    tilts, zooms = [t for t, _ in known], [z for _, z in known]
    against_tilt.plot(tilts, zooms, color=_BLUE, marker="o", markersize=3)
    against_tilt.fill_between(tilts, 1.0, zooms, color=_BLUE, alpha=0.15, lw=0)
    against_tilt.set(
        xlabel="tilt of the follow-up / degrees",
        ylabel="allowed zoom-out z",
        title="shaded: allowed",
    )
    return figure


def _primed(text: str) -> str:
    return text.replace("d'", "d′")
