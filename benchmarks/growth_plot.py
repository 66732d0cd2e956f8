"""The figure of how cost grows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from analysis.reports import in_report_style, new_figure, png_bytes
from simulation.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Growth:
    """Times of one piece of work for several sizes, ascending, and its peer's where it has one."""

    what: str
    label: str
    sizes: tuple[float, ...]
    times_s: tuple[float, ...]
    peer: str | None = None
    peer_s: tuple[float, ...] = ()

    @property
    def exponent(self) -> float:
        """Slope of the logarithm of the time over that of the size, by least squares."""
        return float(np.polyfit(np.log(self.sizes), np.log(self.times_s), 1)[0])


@in_report_style
def plot_growths(growths: Sequence[Growth]) -> bytes:
    """Draw one panel for each; a dotted line through the last point has exponent 1."""
    columns = 3
    rows = -(-len(growths) // columns)
    figure = new_figure(9.0, 2.9 * rows)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, growth in zip(panels, growths, strict=False):
        sizes = np.array(growth.sizes)
        times_ms = 1e3 * np.array(growth.times_s)
        axes.plot(sizes, times_ms, "-o", color="#0072B2", markersize=3, label="standoff")
        if growth.exponent > 0:
            axes.plot(sizes, times_ms[-1] * sizes / sizes[-1], ":", color="#8a8f98")
        if growth.peer_s:
            peer_ms = 1e3 * np.array(growth.peer_s)
            axes.plot(sizes, peer_ms, "--s", color="#1b1f24", markersize=3, label=growth.peer)
            axes.legend(fontsize=7.5)
        axes.set(xscale="log", yscale="log", xlabel=growth.label, ylabel="time / ms")
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xticks(sizes, _readable(sizes))
        # Less than two decades hold too few powers of ten to read a time off.
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _place: f"{value:g}"))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.set_title(f"{growth.what}\nexponent {growth.exponent:.2f}")
    for axes in panels[len(growths) :]:
        axes.set_axis_off()
    return png_bytes(figure)


def _readable(sizes: FloatArray) -> list[str]:
    """Names of the sizes, without those that would run into the one before."""
    apart = 0.11 * np.log(sizes[-1] / sizes[0])
    names, last = [], -np.inf
    for size in sizes:
        is_shown = np.log(size) - last > apart
        last = np.log(size) if is_shown else last
        names.append(f"{size:g}" if is_shown else "")
    return names
