"""How often chance exceeds a significance, in pixels and in peaks, and how often a spot does.

Of three planes together the square of the whitened vector is chi-squared with three degrees of
freedom. Its significance is that of the normal value which chance exceeds as often, either way: one
threshold means one rate of false pixels, in colour as in grey.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from math import log, pi, sqrt

import numpy as np
from scipy.optimize import brentq
from scipy.special import log_ndtr, ndtr, ndtri_exp
from scipy.stats import ncx2

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


SPREAD_ERR = 0.03
"""Relative standard deviation, over the frame, of the true spread about the one worked out: what
the calibration of the variance and the neighbours' correlation leave open."""

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(15)
_SHARES = _WEIGHTS / _WEIGHTS.sum()
_LEAST_SPREAD = 0.05

_TAIL_NODES, _TAIL_WEIGHTS = np.polynomial.laguerre.laggauss(24)

_LATTICE_NODES, _LATTICE_WEIGHTS = np.polynomial.legendre.leggauss(4)
_OFF_PX2 = np.add.outer(_LATTICE_NODES**2, _LATTICE_NODES**2).ravel() / 4
_OFF_SHARES = np.multiply.outer(_LATTICE_WEIGHTS, _LATTICE_WEIGHTS).ravel() / 4
"""Squared distances of a peak from its nearest sample, and their shares."""

_HIGHEST_SD = 40.0
_NEVER = 1e-300


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterWidth:
    """A Gaussian behind which changes are looked for.

    ``width_px``: its width; white noise behind it has the correlation ``exp(-d^2 / (4
    width_px^2))``. ``step_px``: distance of its samples. ``spread_err``: relative standard
    deviation of the true spread about the one worked out. ``allowance``: standard deviations to one
    of significance. ``planes``: 1 for levels, 3 for colours: the significance is then that of the
    three together.
    """

    width_px: float
    step_px: int = 1
    spread_err: float = SPREAD_ERR
    allowance: float = 1.0
    planes: int = 1

    @property
    def spreads(self) -> FloatArray:
        """Spreads that the significance may have in truth, for the shares ``_SHARES``."""
        return np.maximum(1 + self.spread_err * _NODES, _LEAST_SPREAD) / self.allowance

    def exceeded_share(self, threshold_sd: float) -> float:
        """Share of pixels without change beyond a significance, either way."""
        if self.planes == PLANES:
            return float(_SHARES @ joint_share(norm_at(threshold_sd) / self.spreads))
        return float(_SHARES @ (2 * ndtr(-threshold_sd / self.spreads)))

    def scale_at(self, significance: FloatArray | float) -> FloatArray:
        """Standard deviations by which a place with this significance stands out."""
        if self.planes == PLANES:
            return norm_at(significance)
        return np.asarray(significance)


def equally_strict(widths: Sequence[FilterWidth], share: float) -> tuple[FilterWidth, ...]:
    """Set the allowances so that chance exceeds a threshold behind each width equally often.

    ``widths``: the first keeps its allowance of 1. ``share``: share of the pixels that chance flags
    behind any of them, for which this is exact.
    """
    plain = [replace(width, allowance=1.0) for width in widths]
    # Roughly: for the allowances it hardly matters how much the widths agree.
    threshold = significance_threshold(share / len(widths), plain[:1])
    if not threshold:
        return tuple(widths)
    own = plain[0].exceeded_share(threshold)
    return tuple(
        replace(
            width,
            allowance=float(width.scale_at(significance_threshold(own, (width,))))
            / float(width.scale_at(threshold)),
        )
        for width in plain
    )


def exceeded_share(threshold_sd: float, widths: Sequence[FilterWidth]) -> float:
    """Share of pixels without change beyond a significance, either way, behind any of the widths.

    The sum over the widths, less what neighbouring ones exceed together: Hunter's bound, which is
    exact where each width depends on its neighbours alone.

    References
    ----------
    D. Hunter, "An upper bound for the probability of a union", J. Appl. Prob. 13 (1976), 597-603.
    """
    shares = [width.exceeded_share(threshold_sd) for width in widths]
    both = sum(
        min(own, other) * _agreement(threshold_sd, narrow, wide)
        for (own, other), (narrow, wide) in zip(pairwise(shares), pairwise(widths), strict=True)
    )
    return sum(shares) - both


def _agreement(threshold_sd: float, narrow: FilterWidth, wide: FilterWidth) -> float:
    """Probability that noise beyond a threshold behind one width is so behind the other."""
    ratio = wide.width_px / narrow.width_px
    correlation = 2 * ratio / (1 + ratio**2)
    threshold = max(threshold_sd, 1.0)
    if narrow.planes == PLANES:
        return _joint_agreement(float(norm_at(threshold)), correlation)
    beyond = _TAIL_NODES / threshold
    weight = _TAIL_WEIGHTS * np.exp(-(beyond**2) / 2)
    passed = ndtr((correlation * (threshold + beyond) - threshold) / sqrt(1 - correlation**2))
    return float(weight @ passed / weight.sum())


def _joint_agreement(norm: float, correlation: float) -> float:
    """The same of the length of a vector, of which the wider filter leaves its share of noise."""
    lengths = norm + _TAIL_NODES / norm
    weight = _TAIL_WEIGHTS * (lengths / norm) ** 2 * np.exp(-((_TAIL_NODES / norm) ** 2) / 2)
    left = 1 - correlation**2
    passed = ncx2.sf(norm**2 / left, PLANES, (correlation * lengths) ** 2 / left)
    return float(weight @ passed / weight.sum())


def significance_threshold(share: float, widths: Sequence[FilterWidth]) -> float:
    """Significance that this share of the unchanged pixels exceeds behind any of the widths."""

    def excess(threshold_sd: float) -> float:
        return log(max(exceeded_share(threshold_sd, widths), _NEVER) / share)

    if excess(0.0) <= 0:
        return 0.0
    return float(brentq(excess, 0.0, _HIGHEST_SD))


def expected_peaks(
    significance: FloatArray, area_px: int, widths: Sequence[FilterWidth]
) -> FloatArray:
    """How many peaks of either sign chance lifts beyond a significance, in a frame.

    The expected Euler characteristic of the set beyond it, which at 3 standard deviations and more
    is the number of its peaks; each is seen in the sample nearest to it, and so a little lower. A
    peak behind several widths counts for each. ``significance``: any shape.

    References
    ----------
    R. J. Adler, The Geometry of Random Fields (1981), theorem 5.3.1; with the mean curvature of a
    high peak, as in theorem 6.8.1, for what its sample misses. Of colours, K. J. Worsley, "Local
    maxima and the expected Euler characteristic of excursion sets of chi-squared, F and t fields",
    Adv. Appl. Prob. 26 (1994), 13-42, theorem 3.2.
    """
    total = np.zeros(np.shape(significance))
    for width in widths:
        lowered = np.exp(-_OFF_PX2 * width.step_px**2 / (4 * width.width_px**2))
        scale = width.scale_at(significance)
        height = scale[..., None, None] / (width.spreads[:, None] * lowered)
        density = height * np.exp(-(height**2) / 2) / ((2 * pi) ** 1.5 * 2 * width.width_px**2)
        if width.planes == PLANES:
            density = density * (height**2 - (PLANES - 1))
        total += 2 * area_px * np.einsum("...ij,i,j->...", density, _SHARES, _OFF_SHARES)
    return total


POWER = 0.95
"""Of a detection limit."""

_SEARCHED = 1.0
"""Degrees of freedom of the search for the highest significance, beside a spot's own noise.

In white noise it is 2 to 2.5, two for the place and the rest for the width; what the fit between
photographs takes of each spot is worth one.
"""

_MEAN_OFF_PX2 = 1 / 6
"""Mean squared distance of a spot from the nearest pixel's centre."""


def detection_power(height: FloatArray, threshold_sd: float, planes: int = 1) -> FloatArray:
    """Probability that a spot is found.

    Its significance is searched over places and widths: the square of the highest one is that of
    ``height`` and its own noise, and chi-squared for what the search adds. ``height``: significance
    that the spot has by itself at its place, any shape. ``threshold_sd``: significance beyond which
    a place counts as changed. ``planes``: 1 for levels, 3 for colours, of which the noise of all
    adds.
    """
    if planes == PLANES:
        beyond = float(norm_at(threshold_sd)) ** 2
        return np.asarray(ncx2.sf(beyond, PLANES + _SEARCHED, np.square(height)))
    return np.asarray(ncx2.sf(threshold_sd**2, 1 + _SEARCHED, np.square(height)))


def height_for(power: float, threshold_sd: float, planes: int = 1) -> float:
    """Significance that a spot must have by itself to be found with this probability."""

    def excess(height: float) -> float:
        return float(detection_power(np.array(height), threshold_sd, planes)) - power

    return float(brentq(excess, 0.0, threshold_sd + 20.0))


def response(spot_sigma_px: FloatArray, width: FilterWidth) -> FloatArray:
    """Peak that a spot of peak 1 has behind a filter, at the sample nearest to it.

    ``spot_sigma_px``: of the spot before the filter, in the grid's pixels, any shape.
    """
    own = np.square(spot_sigma_px)
    wide = own + width.width_px**2
    return np.asarray(own / wide * np.exp(-_MEAN_OFF_PX2 * width.step_px**2 / (2 * wide)))
