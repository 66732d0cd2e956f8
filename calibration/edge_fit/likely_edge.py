"""What the fit of an edge finds: two shapes, and what the pixels beside them say."""

from typing import NamedTuple

import numpy as np

from calibration.edge_fit.model import FLAT_PARAMETERS
from calibration.edge_fit.residuals import ProfileFigures
from calibration.edge_fit.rounding import Rounding
from simulation.arrays import FloatArray
from simulation.compiled import compiled_part


class WidthFit(NamedTuple):
    """One edge shape fitted to the pixels; valid only if ``is_found``.

    The parameters are in the order of ``calibration.edge_fit.model``, the width as log sigma.
    """

    is_found: bool
    parameters: FloatArray
    log_sigma_variance: float


class LikelyEdge(NamedTuple):
    """The fitted edges: plain (total width) and behind pixel squares (optical width).

    If ``total`` is not found, the rest is not valid. ``is_square`` tells whether the optical edge
    fits better; ``chi2_reduced`` is that of the better one, in terms of the weights. In a
    ``is_censored`` fit the clipped pixels are bounds, else levels like the others.
    ``rounding`` tells of rounding errors that noise does not make random.
    """

    total: WidthFit
    optical: WidthFit
    is_square: bool
    chi2_reduced: float
    noise_dn: float
    clipped_fraction: float
    is_censored: bool
    has_outliers: bool
    is_shaded: bool
    profile: ProfileFigures
    rounding: Rounding


@compiled_part()
def no_edge() -> LikelyEdge:
    """Return the result where no edge fits."""
    void = WidthFit(False, np.zeros(FLAT_PARAMETERS), 0.0)
    profile = ProfileFigures(0.0, 0.0, 0.0, 0.0, 0, 0)
    none = Rounding(0.0, 0.0, 0.0, 0.0)
    return LikelyEdge(void, void, False, 0.0, 0.0, 0.0, False, False, False, profile, none)
