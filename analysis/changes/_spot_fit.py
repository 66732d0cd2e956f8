"""Place, peak and width of a change before the smoothing that found it.

A change is fitted as a Gaussian, round or else elliptic, seen through the smoothing: the smoothed
difference has noise whose neighbours agree, with the correlation ``exp(-d^2 / (4 s^2))`` of white
noise behind a Gaussian of width s, and the fit is by generalised least squares. Other changes
within reach are fitted along, so that none takes another's light.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import ceil, exp, log, pi, sqrt
from typing import Final, Self

import numpy as np

from analysis.changes._comparison import Comparison
from analysis.changes._levels import DetectionLevel
from simulation.arrays import BoolArray, FloatArray, FloatImage, IntArray

_REACH = 7.0
"""Radius of the fitted disc over the smoothing: holds all but 1 % of a spot three times as wide."""

NEIGHBOUR_REACH = 10.0
"""Distance over the smoothing within which another change may have light in the disc."""

_OWN_VARIANCE = 0.01
"""Variance of errors that are each pixel's own, over that of the noise: interpolation and the like.
A spot as narrow as the smoothing loses nothing by it."""

_SHAPE_ERR = 0.01
"""Of a peak: how far a change is from a Gaussian, which counts as each pixel's own error too."""

_NARROWEST_PX2: Final = 1 / 12
"""Variance of the pixel alone."""

_WIDEST = 6.0
"""Width over the smoothing beyond which the disc holds no end of the change."""

_START_WIDTHS = (0.5, 1.0, 2.0, 4.0)
_STEPS = 30
_CONVERGED = 1e-6
_MOST_DAMPING = 1e6
_LEAST_TOLD = 1e-10
_WANDERED = 5.0
_MOST_SPOTS = 4
_MOST_ADDED = 0.2
_UNEXPLAINED = 5.0
"""Standard deviations of what a fit leaves in a pixel beyond which there is another spot."""

_UNEXPLAINED_COST = 1.5
"""Cost of a fit over that of the noise alone beyond which the change is of another shape: the
noise of photographs is not quite that of the model either."""

_PEAK_BIAS = 1.5
"""Relative bias of a fitted peak over its squared relative error, in white noise: the fit prefers
the places and widths at which noise adds. From Box, "Bias in nonlinear estimation", J. R. Statist.
Soc. B 33 (1971), equation (2.24), for a round Gaussian in the plane."""

_PER_SPOT = 6
"""Parameters of a spot: amplitude, y, x, logarithm of the area's square root, two elongations.

Its covariance is ``exp(l) (sqrt(1 + a^2 + b^2) I + [[a, b], [b, -a]])``, of determinant
``exp(2 l)``; rows are y.
"""

_ROUND = np.array([True, True, True, True, False, False])
_LONGEST = 20.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedSpot:
    """A change as a Gaussian: its centre, its peak with the standard error, its width.

    ``area_px`` is that of a flat change: of a Gaussian, that with its peak and its light.
    ``is_whole`` says that it alone is the change, and no part of a longer or another one.
    """

    y_px: float
    x_px: float
    amplitude_dn: float
    amplitude_err_dn: float
    sigma_px: float
    area_px: float
    is_whole: bool = False


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SmoothedField:
    """A difference behind a Gaussian, sampled about once a width of it.

    ``step_px``: pixels of the grid from one sample to the next; the first sample is the first
    pixel. ``smoothing``: width of the Gaussian over the step. ``difference_dn, sd_dn``: at the
    samples, shape ``(rows, cols)``, with the plain standard deviation.
    """

    step_px: int
    smoothing: float
    difference_dn: FloatImage
    sd_dn: FloatImage
    valid: BoolArray

    @classmethod
    def of(cls, level: DetectionLevel) -> Self:
        """Take samples of a level that lie about a width of it apart."""
        every = max(round(level.width_px / level.step_px), 1)
        part = np.s_[::every, ::every]
        return cls(
            step_px=level.step_px * every,
            smoothing=level.width_px / (level.step_px * every),
            difference_dn=level.difference_dn[part],
            sd_dn=level.sd_dn[part] / np.float32(level.filter_width.allowance),
            valid=level.valid[part],
        )

    @classmethod
    def of_comparison(cls, compared: Comparison) -> Self:
        """Take every pixel of the difference itself."""
        return cls(
            step_px=1,
            smoothing=compared.smoothing_px,
            difference_dn=compared.difference_dn,
            sd_dn=compared.sd_dn,
            valid=compared.valid,
        )

    @property
    def width_px(self) -> float:
        """Width of the Gaussian in pixels of the grid."""
        return self.smoothing * self.step_px


def fit_spot(seen: SmoothedField, peak: tuple[int, int], others: IntArray) -> FittedSpot | None:
    """Fit the change whose strongest pixel is ``peak``; None where it is no such spot.

    ``others``: strongest pixels of the changes near it, nearest first, shape ``(n, 2)``.
    """
    last = np.subtract(seen.valid.shape, 1)
    at, beside = (
        np.minimum(np.rint(np.asarray(place) / seen.step_px).astype(np.int64), last)
        for place in (peak, others.reshape(-1, 2))
    )
    if not seen.valid[at[0], at[1]]:
        return None
    disc = _Disc.around((int(at[0]), int(at[1])), seen)
    starts = [disc.start(place) for place in (at, *beside[: _MOST_SPOTS - 1].tolist())]
    fit = _fitted(disc, np.concatenate(starts), np.tile(_ROUND, len(starts)))
    while fit.is_near(at, _WANDERED * seen.smoothing) and fit.is_alone(disc):
        left = np.abs(disc.data - _model(fit.parameters, disc)[0])
        worst = int(np.argmax(left))
        if left[worst] < disc.most_left and fit.cost < disc.most_cost:
            return fit.first_spot(seen.step_px, is_whole=len(fit.free) == _PER_SPOT * len(starts))
        refined = fit.refined(disc, disc.pixel(worst))
        if not refined:
            break
        fit = min(refined, key=lambda trial: trial.cost)
    return None


@dataclass(frozen=True, slots=True, eq=False)
class _Disc:
    """Pixels around a peak, in standard deviations; the weights are their inverse correlation."""

    y: FloatArray
    x: FloatArray
    data: FloatArray
    sd: FloatArray
    weights: FloatArray
    smoothing_2: float
    most_left: float
    most_cost: float

    @classmethod
    def around(cls, peak: tuple[int, int], seen: SmoothedField) -> Self:
        height = float(seen.difference_dn[peak] / seen.sd_dn[peak])
        # In steps of 4, so that the weights of few kinds of disc are needed.
        wrong = max((_SHAPE_ERR * height) ** 2 / _OWN_VARIANCE, 1.0)
        steps = ceil(log(wrong) / log(4))
        own = _OWN_VARIANCE * 4.0**steps
        y, x, weights = _lattice(seen.smoothing, own)
        rows, cols = peak[0] + y, peak[1] + x
        inside = (rows >= 0) & (rows < seen.valid.shape[0])
        inside &= (cols >= 0) & (cols < seen.valid.shape[1])
        inside[inside] = seen.valid[rows[inside], cols[inside]]
        if not inside.all():
            rows, cols = rows[inside], cols[inside]
            weights = _inverse_correlation(rows, cols, seen.smoothing, own)
        expected = max(len(rows) - own * float(np.trace(weights)), 0.0)
        sd = np.asarray(seen.sd_dn[rows, cols], dtype=np.float64)
        return cls(
            y=rows.astype(np.float64),
            x=cols.astype(np.float64),
            data=seen.difference_dn[rows, cols] / sd,
            sd=sd,
            weights=weights,
            smoothing_2=seen.smoothing**2,
            most_left=_UNEXPLAINED * sqrt(1 + own),
            most_cost=_UNEXPLAINED_COST * expected + 3 * sqrt(2 * expected),
        )

    def pixel(self, index: int) -> tuple[int, int]:
        return int(self.y[index]), int(self.x[index])

    def start(self, at: Sequence[int]) -> FloatArray:
        """Parameters of the width that alone fits best there."""
        found, best = np.zeros(_PER_SPOT), -np.inf
        for width in _START_WIDTHS:
            trial = np.array([1.0, *at, np.log(width**2 * self.smoothing_2), 0.0, 0.0])
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
    free: BoolArray
    cost: float

    def refined(self, disc: _Disc, unexplained: tuple[int, int]) -> list["_Fit"]:
        """Fits with the first spot elongated, and with a spot more."""
        fits = []
        if not self.free[_PER_SPOT - 1]:
            free = self.free.copy()
            free[:_PER_SPOT] = True
            fits.append(_fitted(disc, self.parameters, free))
        if len(self.parameters) < _MOST_SPOTS * _PER_SPOT:
            starts = np.append(self.parameters, disc.start(unexplained))
            fits.append(_fitted(disc, starts, np.append(self.free, _ROUND)))
        return fits

    def is_alone(self, disc: _Disc) -> bool:
        """Whether the other spots are no part of the first: they add little at its centre."""
        others = self.parameters.copy()
        others[0] = 0.0
        near = replace(disc, y=self.parameters[1:2], x=self.parameters[2:3], sd=np.ones(1))
        added = abs(float(_model(others, near)[0][0]))
        return added < _MOST_ADDED * abs(float(self.parameters[0]))

    def is_near(self, peak: IntArray, most: float) -> bool:
        """Whether the first spot is a change at the peak."""
        amplitude, y, x = self.parameters[:3]
        is_sure = amplitude**2 > self.variance[0]
        is_wide = not self.free[_PER_SPOT - 1] and bool(np.isinf(self.variance[3]))
        return bool(
            is_sure
            and not (is_wide and self.parameters[3] > 0)
            and np.hypot(y - peak[0], x - peak[1]) < most
        )

    def first_spot(self, step_px: int, *, is_whole: bool) -> FittedSpot:
        amplitude, y, x, log_size = self.parameters[:4].tolist()
        variance_px2 = step_px**2 * exp(log_size)
        return FittedSpot(
            y_px=y * step_px,
            x_px=x * step_px,
            amplitude_dn=amplitude / (1 + _PEAK_BIAS * float(self.variance[0]) / amplitude**2),
            amplitude_err_dn=float(np.sqrt(self.variance[0])),
            sigma_px=sqrt(variance_px2),
            area_px=2 * pi * variance_px2,
            is_whole=is_whole,
        )


def _fitted(disc: _Disc, starts: FloatArray, free: BoolArray) -> _Fit:
    """Levenberg and Marquardt's steps; widths stay between those of a pixel and of the disc."""
    low, high = np.full(starts.size, -np.inf), np.full(starts.size, np.inf)
    low[3::_PER_SPOT] = np.log(_NARROWEST_PX2)
    high[3::_PER_SPOT] = np.log(_WIDEST**2 * disc.smoothing_2)
    for elongation in (4, 5):
        low[elongation::_PER_SPOT], high[elongation::_PER_SPOT] = -_LONGEST, _LONGEST
    parameters = np.clip(starts, low, high)
    model, slopes = _model(parameters, disc)
    cost = _cost(disc, model)
    damping = 1e-3
    for _ in range(_STEPS):
        weighted = disc.weights @ slopes[:, free]
        normal, right = slopes[:, free].T @ weighted, weighted.T @ (disc.data - model)
        scale = np.maximum(np.diag(normal), 1e-6 * normal.max() + 1e-30)
        trial = parameters.copy()
        trial[free] += np.linalg.solve(normal + damping * np.diag(scale), right)
        trial = np.clip(trial, low, high)
        trial_model, trial_slopes = _model(trial, disc)
        trial_cost = _cost(disc, trial_model)
        gained = cost - trial_cost
        if gained < 0:
            damping *= 10
            if damping > _MOST_DAMPING:
                break
            continue
        damping = max(damping / 10, 1e-6)
        parameters, model, slopes, cost = trial, trial_model, trial_slopes, trial_cost
        if gained < _CONVERGED:
            break
    inner = np.flatnonzero(free & (parameters > low) & (parameters < high))
    variance = np.full(len(parameters), np.inf)
    variance[inner] = _variances(slopes[:, inner].T @ disc.weights @ slopes[:, inner])
    return _Fit(parameters, variance, free, cost)


def _variances(normal: FloatArray) -> FloatArray:
    """Diagonal of the inverse; infinite for what the pixels do not tell."""
    own = np.sqrt(np.maximum(np.diag(normal), 0.0))
    told = own > _LEAST_TOLD * own.max(initial=0.0)
    variance = np.full(len(own), np.inf)
    scaled = normal[np.ix_(told, told)] / own[told] / own[told][:, None]
    scaled[np.diag_indices_from(scaled)] += _LEAST_TOLD
    with np.errstate(over="ignore", divide="ignore"):
        variance[told] = np.diag(np.linalg.inv(scaled)) / own[told] ** 2
    return variance


def _cost(disc: _Disc, model: FloatArray) -> float:
    left = disc.data - model
    return float(left @ disc.weights @ left)


def _model(parameters: FloatArray, disc: _Disc) -> tuple[FloatArray, FloatArray]:
    """Smoothed spots in standard deviations, shape (n,), and the derivatives, (n, parameters)."""
    total = np.zeros(len(disc.y))
    slopes = np.empty((len(disc.y), len(parameters)))
    for first in range(0, len(parameters), _PER_SPOT):
        amplitude, y, x, log_size, a, b = parameters[first : first + _PER_SPOT].tolist()
        size, even = exp(log_size), sqrt(1 + a * a + b * b)
        down, right = disc.y - y, disc.x - x
        # Of the smoothed spot: covariance, its inverse, and that times the distance.
        yy, xx, yx = size * (even + a), size * (even - a), size * b
        wide_yy, wide_xx = yy + disc.smoothing_2, xx + disc.smoothing_2
        area2 = wide_yy * wide_xx - yx * yx
        inv_yy, inv_xx, inv_yx = wide_xx / area2, wide_yy / area2, -yx / area2
        pull_y, pull_x = inv_yy * down + inv_yx * right, inv_yx * down + inv_xx * right
        height = size / sqrt(area2)
        unit = height * np.exp(-(down * pull_y + right * pull_x) / 2) / disc.sd
        spot = amplitude * unit
        # Derivatives of the logarithm by the elements of the covariance; yx counts twice.
        by_yy, by_xx, by_yx = (pull_y**2 - inv_yy) / 2, (pull_x**2 - inv_xx) / 2, pull_y * pull_x
        by_yx -= inv_yx
        slopes[:, first] = unit
        slopes[:, first + 1] = spot * pull_y
        slopes[:, first + 2] = spot * pull_x
        slopes[:, first + 3] = spot * (1 + by_yy * yy + by_xx * xx + by_yx * yx)
        round_part = by_yy + by_xx
        slopes[:, first + 4] = spot * size * (round_part * a / even + by_yy - by_xx)
        slopes[:, first + 5] = spot * size * (round_part * b / even + by_yx)
        total += spot
    return total, slopes


@lru_cache(maxsize=32)
def _lattice(smoothing_px: float, own_variance: float) -> tuple[IntArray, IntArray, FloatArray]:
    """Rows and columns of a whole disc around 0, and its weights."""
    most = ceil(_REACH * smoothing_px)
    y, x = np.mgrid[-most : most + 1, -most : most + 1]
    inside = y**2 + x**2 <= (_REACH * smoothing_px) ** 2
    y, x = y[inside], x[inside]
    return y, x, _inverse_correlation(y, x, smoothing_px, own_variance)


def _inverse_correlation(
    y: IntArray, x: IntArray, smoothing_px: float, own_variance: float
) -> FloatArray:
    square = np.subtract.outer(y, y) ** 2.0 + np.subtract.outer(x, x) ** 2.0
    correlation = np.exp(-square / (4 * smoothing_px**2))
    correlation[np.diag_indices_from(correlation)] += own_variance
    return np.asarray(np.linalg.inv(correlation))
