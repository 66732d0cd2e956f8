"""Figures that a notebook shows inline, whether or not pyplot was imported."""

from collections.abc import Callable
from io import BytesIO
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


class InlineFigure(Figure):
    """A figure that belongs to no window and has a picture of itself."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:  # noqa: ANN401 - as of Figure
        super().__init__(*args, **kwargs)
        FigureCanvasAgg(self)

    def _repr_png_(self) -> bytes:
        data = BytesIO()
        self.savefig(data, format="png")
        return data.getvalue()


def drawn(
    draw: Callable[[Axes], object],
    ax: Axes | None,
    size_in: tuple[float, float] = (6.4, 3.6),
) -> Figure:
    """Draw into axes that are given, or into a figure of its own; return the figure."""
    if ax is None:
        ax = InlineFigure(figsize=size_in, layout="constrained").subplots()
    draw(ax)
    return figure_of(ax)


def figure_of(ax: Axes) -> Figure:
    """Return the figure that axes lie in, at whatever depth."""
    found: Any = ax.figure
    while not isinstance(found, Figure):
        found = found.figure
    return found
