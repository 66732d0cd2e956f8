"""A photograph as a figure."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.reports import new_figure
from analysis.screen import on_screen, white_level_dn
from simulation.figures import figure_of
from standoff.photographs.encoding import SRGB

if TYPE_CHECKING:
    from standoff.photographs.photograph import Photograph

_BRIGHTEST = 99.9  # percentile shown as white, so that a single hot pixel does not darken all


def photograph_figure(photograph: "Photograph", ax: Axes | None = None) -> Figure:
    """Return a figure of the photograph, encoded for a screen; axes in px of the file."""
    planes = np.asarray(photograph.linear_planes, dtype=np.float64)
    if photograph.is_colour:
        shown = on_screen(planes, white_level_dn(planes))
    else:
        dark = planes.min()
        bright = max(float(np.percentile(planes, _BRIGHTEST)), dark + 1e-9)
        shown = SRGB.encode(np.clip((planes - dark) / (bright - dark), 0.0, 1.0), 1.0)
    axes = (
        new_figure(6.4, 6.4 * shown.shape[0] / shown.shape[1] + 0.6).subplots()
        if ax is None
        else ax
    )
    axes.imshow(shown, cmap="gray", vmin=0.0, vmax=1.0)
    axes.set(title=photograph.path.name, xlabel="x / px", ylabel="y / px")
    return figure_of(axes)
