"""The map of what a comparison would have found."""

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.ticker import LogLocator, ScalarFormatter

from analysis.changes import ChangeResult
from analysis.detection_limits import size_text
from analysis.reports.changes.pictures import NOT_COMPARED
from analysis.reports.page import ReportFigure, new_figure

_DRAWN_PX = 900
_ENDS_PERCENT = (0.5, 99.5)
_LEAST_RATIO = 1.5
"""Of the ends of the scale: noise alone makes the limit vary by a few per cent."""


def limit_figure(found: ChangeResult) -> ReportFigure | None:
    """Draw the detection limit over the follow-up; None if nothing was compared."""
    limit = found.summary.detection_limit
    if limit is None or not found.valid.any():
        return None
    rows, cols = found.limit_dn.shape
    step = -(-max(rows, cols) // _DRAWN_PX)
    drawn = np.ma.masked_invalid(found.limit_dn[::step, ::step])
    low, high = np.percentile(found.limit_dn[found.valid], _ENDS_PERCENT)
    middle, ratio = np.sqrt(low * high), max(np.sqrt(high / low), _LEAST_RATIO**0.5)
    width_in = 6.0
    figure = new_figure(width_in, 0.3 + (width_in - 1.0) * rows / cols)
    axes = figure.subplots()
    axes.set_facecolor(NOT_COMPARED)
    image = axes.imshow(
        drawn,
        cmap="cividis",
        norm=LogNorm(middle / ratio, middle * ratio),
        extent=(-0.5, cols - 0.5, rows - 0.5, -0.5),
        interpolation="nearest",
    )
    axes.set(xticks=[], yticks=[])
    axes.grid(visible=False)
    bar = figure.colorbar(image, ax=axes, label="limit / DN", shrink=0.9)
    bar.ax.yaxis.set_major_locator(LogLocator(subs=(1, 1.5, 2, 3, 5, 7)))
    bar.ax.yaxis.set_major_formatter(ScalarFormatter())
    bar.ax.yaxis.set_minor_locator(LogLocator(subs=()))
    caption = (
        f"Amplitude at which a spot of {size_text(limit.mapped, limit)} is found "
        f"{100 * limit.power:.0f} times of 100. Grey: not compared."
    )
    return ReportFigure.of(figure, caption, form="png")
