"""The significance of three planes together, as that of one.

The square of the whitened vector is chi-squared with three degrees of freedom. Its significance is
that of the normal value which chance exceeds as often, either way: one threshold means one rate of
false pixels, in colour as in grey.
"""

from functools import lru_cache
from math import log, pi

import numpy as np
from scipy.special import log_ndtr, ndtr, ndtri_exp

from simulation.arrays import FloatArray, FloatImage

PLANES = 3

_TABLE_TO, _TABLE_STEP = 64.0, 1 / 64
"""Beyond the table, the two differ by as much as at its end, to 0.1 in thousands."""


def joint_share(norm: FloatArray) -> FloatArray:
    """Share of places without change at which the vector is longer: chi's tail, in closed form."""
    return np.asarray(2 * ndtr(-norm) + np.sqrt(2 / pi) * norm * np.exp(-(norm**2) / 2))


def as_significance(norm: FloatImage) -> FloatImage:
    """Significance of vectors of this length."""
    norms, values = _table()
    beyond = norm - np.float32(norms[-1] - values[-1])
    inside = np.interp(norm, norms, values).astype(norm.dtype)
    return np.where(norm > norms[-1], beyond, inside)


def norm_at(significance: FloatArray | float) -> FloatArray:
    """Length of the vector that has a significance, any shape."""
    norms, values = _table()
    given = np.asarray(significance, dtype=np.float64)
    beyond = given + (norms[-1] - values[-1])
    return np.asarray(np.where(given > values[-1], beyond, np.interp(given, values, norms)))


@lru_cache(maxsize=1)
def _table() -> tuple[FloatArray, FloatArray]:
    norm = np.arange(0.0, _TABLE_TO + _TABLE_STEP, _TABLE_STEP)
    with np.errstate(divide="ignore"):
        share = np.logaddexp(log(2) + log_ndtr(-norm), np.log(np.sqrt(2 / pi) * norm) - norm**2 / 2)
    return norm, np.asarray(np.maximum(-ndtri_exp(share - log(2)), 0.0))
