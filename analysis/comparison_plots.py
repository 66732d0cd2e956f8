"""Figures of a comparison: error against zoom, and the processed images side by side."""

import numpy as np
from matplotlib.figure import Figure

from analysis.reports import in_report_style, new_figure
from analysis.series import SeriesComparison, SeriesPair
from simulation import MODELS

__all__ = ["MODEL_COLOURS", "plot_error_by_zoom", "plot_processed"]

MODEL_COLOURS: dict[str, str] = {
    "bicubic": "#CC79A7",
    "paper": "#D55E00",
    "matched": "#0072B2",
    "lmmse": "#009E73",
}
_MARKERS = {"bicubic": "s", "paper": "^", "matched": "o", "lmmse": "D"}


@in_report_style
def plot_error_by_zoom(comparison: SeriesComparison) -> Figure:
    """Plot the mean squared error of every model against the measured zoom-out."""
    figure = new_figure(6.4, 3.4)
    axes = figure.subplots()
    targets = sorted({(p.reference.target, p.reference.orientation_deg) for p in comparison.pairs})
    for number, (target, turn) in enumerate(targets):
        pairs = [
            p
            for p in comparison.pairs
            if (p.reference.target, p.reference.orientation_deg) == (target, turn)
        ]
        for model in MODELS:
            axes.plot(
                [p.comparison.registration.zoom for p in pairs],
                [p.comparison.metrics[model].mse_dn2 for p in pairs],
                color=MODEL_COLOURS[model],
                marker=_MARKERS[model],
                linestyle=("-", "--", ":", "-.")[number % 4],
                label=f"{model}, {target}",
            )
    axes.set(
        yscale="log",
        xlabel="zoom-out z (ratio of the distances)",
        ylabel="mean squared error / DN\N{SUPERSCRIPT TWO}, full scale 255",
    )
    axes.legend(fontsize=8)
    return figure


@in_report_style
def plot_processed(pair: SeriesPair, crop_px: int = 140) -> Figure:
    """Show the middle of the processed capture beside every model's, differences below."""
    captured = pair.comparison.captured
    rows, cols = captured.shape
    side = min(crop_px, rows, cols)
    top, left = (rows - side) // 2, (cols - side) // 2
    window = np.s_[top : top + side, left : left + side]
    figure = new_figure(8.0, 3.7)
    grid = figure.subplots(2, len(MODELS) + 1)
    reach = float(np.percentile(np.abs(captured[window]), 99.5))
    shown = {"captured": captured} | {str(m): i for m, i in pair.comparison.simulated.items()}
    differences = [pair.comparison.simulated[m][window] - captured[window] for m in MODELS]
    spread = float(np.percentile(np.abs(differences), 99.5))
    for axes, (name, image) in zip(grid[0], shown.items(), strict=True):
        axes.imshow(image[window], cmap="gray", vmin=-reach, vmax=reach)
        axes.set_title(name)
    grid[1, 0].axis("off")
    grid[1, 0].text(0.5, 0.5, f"minus captured\n±{spread:.1f} of 255", ha="center", va="center")
    for axes, difference in zip(grid[1, 1:], differences, strict=True):
        axes.imshow(difference, cmap="RdBu", vmin=-spread, vmax=spread)
    for axes in grid.flat:
        axes.set(xticks=[], yticks=[])
        axes.grid(visible=False)
    return figure
