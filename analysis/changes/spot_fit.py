"""Place, peak and width of a change before the smoothing that found it.

A change is fitted as a round Gaussian, seen through the smoothing: the smoothed difference has
noise whose neighbours agree, with the correlation ``exp(-d^2 / (4 s^2))`` of white noise behind a
Gaussian of width s, and the fit is by generalised least squares. Other changes within reach are
fitted along, so that none takes another's light.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Self

import numpy as np

from analysis.changes.comparison import Comparison
from simulation.arrays import FloatArray, IntArray

_REACH = 7.0
"""Radius of the fitted disc over the smoothing: holds all but 1 % of a spot three times as wide."""

NEIGHBOUR_REACH = 10.0
"""Distance over the smoothing within which another change may have light in the disc."""

_CORE = 2.5
"""The same for what is no spot: its level around the strongest place."""

_NUGGET = 0.01
"""Variance of errors that are each pixel's own, over that of the noise: interpolation and the like.
A spot as narrow as the smoothing loses nothing by it."""

_NARROWEST_PX2: Final = 1 / 12
"""Variance of the pixel alone."""

_WIDEST = 6.0
"""Width over the smoothing beyond which the disc holds no end of the change."""

_START_WIDTHS = (0.5, 1.0, 2.0, 4.0)
_STEPS = 30
_CONVERGED = 1e-3
_WANDERED = 5.0
_MOST_SPOTS = 4
_UNEXPLAINED_SD = 5.0
"""Standard deviations of what a fit leaves in a pixel beyond which there is another spot."""

_PEAK_BIAS = 1.5
"""Relative bias of a fitted peak over its squared relative error, in white noise: the fit prefers
the places and widths at which noise adds. From Box, "Bias in nonlinear estimation", J. R. Statist.
Soc. B 33 (1971), equation (2.24), for a round Gaussian in the plane."""

_PER_SPOT = 4  # amplitude, y, x, logarithm of the variance


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedSpot:
    """A change as a Gaussian: its centre, its peak with the standard error, its width."""

    y_px: float
    x_px: float
    amplitude_dn: float
    amplitude_err_dn: float
    sigma_px: float


def fit_spot(seen: Comparison, peak: tuple[int, int], others: IntArray) -> FittedSpot:
    """Fit the change whose strongest pixel is ``peak``.

    Parameters
    ----------
    seen
        The smoothed difference.
    peak
        Row and column.
    others
        Strongest pixels of the changes near it, nearest first.
    """
    disc = _Disc.around(peak, seen, _REACH)
    starts = [disc.start(at) for at in (peak, *others[: _MOST_SPOTS - 1])]
    while True:
        fit = _fitted(disc, np.array(starts))
        if not fit.is_near(peak, _WANDERED * seen.smoothing_px):
            break
        left = np.abs(disc.data - _model(fit.parameters, disc)[0])
        worst = int(np.argmax(left))
        if left[worst] < _UNEXPLAINED_SD:
            return fit.first_spot()
        if len(starts) == _MOST_SPOTS:
            break
        starts = [*fit.parameters.reshape(-1, _PER_SPOT), disc.start(disc.pixel(worst))]
    core = _Disc.around(peak, seen, _CORE)
    fit = _fitted(core, core.start(peak)[None])
    if fit.is_near(peak, _CORE * seen.smoothing_px):
        return fit.first_spot()
    return _level(seen, peak)


def _level(seen: Comparison, peak: tuple[int, int]) -> FittedSpot:
    """A change of no shape: what the smoothed difference shows at its strongest place."""
    return FittedSpot(
        y_px=float(peak[0]),
        x_px=float(peak[1]),
        amplitude_dn=float(seen.difference_dn[peak]),
        amplitude_err_dn=float(seen.sd_dn[peak]),
        sigma_px=_WIDEST * seen.smoothing_px,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Disc:
    """Pixels around a peak, in standard deviations; the weights are their inverse correlation."""

    y: FloatArray
    x: FloatArray
    data: FloatArray
    sd: FloatArray
    weights: FloatArray
    smoothing_px2: float

    @classmethod
    def around(cls, peak: tuple[int, int], seen: Comparison, reach: float) -> Self:
        y, x, weights = _lattice(seen.smoothing_px, reach)
        rows, cols = peak[0] + y, peak[1] + x
        inside = (rows >= 0) & (rows < seen.valid.shape[0])
        inside &= (cols >= 0) & (cols < seen.valid.shape[1])
        inside[inside] = seen.valid[rows[inside], cols[inside]]
        if not inside.all():
            rows, cols = rows[inside], cols[inside]
            weights = _inverse_correlation(rows, cols, seen.smoothing_px)
        sd = np.asarray(seen.sd_dn[rows, cols], dtype=np.float64)
        return cls(
            y=rows.astype(np.float64),
            x=cols.astype(np.float64),
            data=seen.difference_dn[rows, cols] / sd,
            sd=sd,
            weights=weights,
            smoothing_px2=seen.smoothing_px**2,
        )

    def pixel(self, index: int) -> tuple[int, int]:
        return int(self.y[index]), int(self.x[index])

    def start(self, at: Sequence[int] | IntArray) -> FloatArray:
        """Parameters of the width that alone fits best there."""
        found, best = np.zeros(_PER_SPOT), -np.inf
        for width in _START_WIDTHS:
            trial = np.array([1.0, *at, np.log(width**2 * self.smoothing_px2)])
            unit = _model(trial, self)[0]
            weighted = self.weights @ unit
            power, projected = float(unit @ weighted), float(self.data @ weighted)
            if power > 0 and projected**2 / power > best:
                best = projected**2 / power
                found = np.array([projected / power, *trial[1:]])
        return found


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    parameters: FloatArray
    variance: FloatArray

    def is_near(self, peak: tuple[int, int], most_px: float) -> bool:
        """Whether the first spot is a change at the peak."""
        amplitude, y, x = self.parameters[:3]
        is_sure = amplitude**2 > self.variance[0]
        return bool(is_sure and np.hypot(y - peak[0], x - peak[1]) < most_px)

    def first_spot(self) -> FittedSpot:
        amplitude, y, x, log_variance = self.parameters[:_PER_SPOT].tolist()
        return FittedSpot(
            y_px=y,
            x_px=x,
            amplitude_dn=amplitude / (1 + _PEAK_BIAS * float(self.variance[0]) / amplitude**2),
            amplitude_err_dn=float(np.sqrt(self.variance[0])),
            sigma_px=float(np.exp(log_variance / 2)),
        )


def _fitted(disc: _Disc, starts: FloatArray) -> _Fit:
    """Levenberg and Marquardt's steps; widths stay between those of a pixel and of the disc."""
    low, high = np.full(starts.size, -np.inf), np.full(starts.size, np.inf)
    low[3::_PER_SPOT] = np.log(_NARROWEST_PX2)
    high[3::_PER_SPOT] = np.log(_WIDEST**2 * disc.smoothing_px2)
    parameters = np.clip(starts.ravel(), low, high)
    model, slopes = _model(parameters, disc)
    cost = _cost(disc, model)
    damping = 1e-3
    for _ in range(_STEPS):
        weighted = disc.weights @ slopes
        normal, right = slopes.T @ weighted, weighted.T @ (disc.data - model)
        scale = np.diag(normal) + 1e-12 * normal.max()
        step = np.linalg.solve(normal + damping * np.diag(scale), right)
        trial = np.clip(parameters + step, low, high)
        trial_model, trial_slopes = _model(trial, disc)
        trial_cost = _cost(disc, trial_model)
        gained = cost - trial_cost
        if gained < 0:
            damping *= 10
            if damping > 1e6:
                break
            continue
        damping = max(damping / 10, 1e-9)
        parameters, model, slopes, cost = trial, trial_model, trial_slopes, trial_cost
        if gained < _CONVERGED:
            break
    free = (parameters > low) & (parameters < high)
    normal = slopes[:, free].T @ disc.weights @ slopes[:, free]
    variance = np.zeros(len(parameters))
    variance[free] = np.diag(np.linalg.pinv(normal, hermitian=True))
    return _Fit(parameters, variance)


def _cost(disc: _Disc, model: FloatArray) -> float:
    left = disc.data - model
    return float(left @ disc.weights @ left)


def _model(parameters: FloatArray, disc: _Disc) -> tuple[FloatArray, FloatArray]:
    """Smoothed spots in standard deviations, shape (n,), and the derivatives, (n, parameters)."""
    total = np.zeros(len(disc.y))
    slopes = np.empty((len(disc.y), len(parameters)))
    for first in range(0, len(parameters), _PER_SPOT):
        amplitude, y, x, log_variance = parameters[first : first + _PER_SPOT]
        variance = np.exp(log_variance)
        wide = variance + disc.smoothing_px2
        down, right = disc.y - y, disc.x - x
        square = down**2 + right**2
        unit = variance / wide * np.exp(-square / (2 * wide)) / disc.sd
        spot = amplitude * unit
        slopes[:, first] = unit
        slopes[:, first + 1] = spot * down / wide
        slopes[:, first + 2] = spot * right / wide
        slopes[:, first + 3] = spot * (
            disc.smoothing_px2 / wide + square * variance / (2 * wide**2)
        )
        total += spot
    return total, slopes


@lru_cache(maxsize=8)
def _lattice(smoothing_px: float, reach: float) -> tuple[IntArray, IntArray, FloatArray]:
    """Rows and columns of a whole disc around 0, and its weights."""
    most = int(np.ceil(reach * smoothing_px))
    y, x = np.mgrid[-most : most + 1, -most : most + 1]
    inside = y**2 + x**2 <= (reach * smoothing_px) ** 2
    y, x = y[inside], x[inside]
    return y, x, _inverse_correlation(y, x, smoothing_px)


def _inverse_correlation(y: IntArray, x: IntArray, smoothing_px: float) -> FloatArray:
    square = np.subtract.outer(y, y) ** 2.0 + np.subtract.outer(x, x) ** 2.0
    correlation = np.exp(-square / (4 * smoothing_px**2))
    correlation[np.diag_indices_from(correlation)] += _NUGGET
    return np.asarray(np.linalg.inv(correlation))
