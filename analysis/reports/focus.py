"""Figure of a focus sweep."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from acquisition.focus import FocusPeak
from analysis.reports.page import in_report_style, new_figure
from calibration.sharpness import NORMAL_95
from simulation.arrays import FloatArray
from simulation.figures import figure_of
from simulation.palette import BLUE, INK, VERMILION


@in_report_style
def plot_focus_sweep(
    heights_mm: FloatArray,
    values: FloatArray,
    errs: FloatArray,
    peak: FocusPeak | None,
    measure: str,
    ax: Axes | None = None,
) -> Figure:
    """Plot focus values by height, with the fitted curve and the peak where there is one."""
    axes = new_figure(6.4, 3.4).subplots() if ax is None else ax
    axes.errorbar(
        heights_mm, values, yerr=errs, fmt="o", markersize=4, linewidth=0.9, color=BLUE,
        label="measured",
    )  # fmt: skip
    if peak is not None:
        line = np.linspace(heights_mm.min(), heights_mm.max(), 400)
        axes.plot(line, peak.curve(line), color=INK, linewidth=1, label=f"fit, {peak.shape}")
        half = NORMAL_95 * peak.err_mm
        axes.axvspan(
            peak.height_mm - half, peak.height_mm + half, color=VERMILION, alpha=0.25, linewidth=0,
            label="peak, 95 %",
        )  # fmt: skip
        axes.axvline(peak.height_mm, color=VERMILION, linewidth=1)
        axes.set(title=f"sharpest at {peak.height_mm:.3f} ± {half:.3f} mm (95 %)")
    axes.set(xlabel="height / mm", ylabel=f"focus value ({measure})")
    axes.margins(y=0.15)
    axes.legend(loc="best", fontsize=8)
    return figure_of(axes)
