"""A smooth deviation from a few known shapes: a P-spline beside free terms, solved in its band.

Cubic B-splines on equal knots with a penalty on the third differences of the coefficients
(Eilers and Marx, "Flexible smoothing with B-splines and penalties", Statistical Science 11,
1996), flat at both ends, beside a few unpenalised terms. As a mixed model the penalty is a prior on
the deviation; its weight has the greatest restricted likelihood (Wood, "Fast stable restricted
maximum likelihood and marginal likelihood estimation of semiparametric generalized linear models",
JRSS B 73, 2011), and the posterior covariance holds what the smoothing takes away as well as the
noise (Wahba, "Bayesian confidence intervals for the cross-validated smoothing spline", JRSS B 45,
1983). The spline's normal equations have three off-diagonals: a banded Cholesky factor solves them,
and the terms are a border of the system.
"""

from math import log, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from simulation.arrays import FloatArray

DEGREE = 3
_BAND = 4  # the diagonal and three beside it
_PENALTY = (-1.0, 3.0, -3.0, 1.0)  # third difference
_LIGHTEST_LOG = log(1e-9)
_HEAVIEST_LOG = log(1e6)
_GOLDEN = 0.6180339887498949
_COARSE_STEPS = 9
_FINE_STEPS = 7
_SURPRISING = 3.0
_RIDGE = 1e-12  # of each diagonal element: a term that the spline can follow exactly


class SplineFit(NamedTuple):
    """A penalised spline with its terms; valid only if ``is_found``.

    With n coefficients and m terms: ``coefficients`` (n,) and ``terms`` (m,). The inverse of the
    bordered normal equations, whose factors are ``factor`` (n, 4) for the spline, ``cross`` (n, m)
    and ``border`` (m, m), times ``scale`` is the posterior covariance: see ``variances``. The scale
    is by how much the samples scatter more than their weights say.
    """

    is_found: bool
    coefficients: FloatArray
    terms: FloatArray
    factor: FloatArray
    cross: FloatArray
    border: FloatArray
    scale: float


class _Equations(NamedTuple):
    """Normal equations: ``band`` and ``right`` of the spline, and what the terms add.

    ``squares`` is the weighted sum of the squared values, ``samples`` their number.
    """

    band: FloatArray
    right: FloatArray
    cross: FloatArray
    terms: FloatArray
    terms_right: FloatArray
    squares: float
    samples: int


@njit(cache=True)
def _basis(position: float, out: FloatArray) -> int:
    """Fill the four cubic B-splines at ``position`` (in knots); return the first one's number."""
    first = int(np.floor(position))
    t = position - first
    s = 1.0 - t
    out[0] = s * s * s / 6.0
    out[1] = (3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0
    out[2] = (3.0 * s * s * s - 6.0 * s * s + 4.0) / 6.0
    out[3] = t * t * t / 6.0
    return first


@njit(cache=True)
def _tied(number: int, count: int) -> int:
    """Coefficient of B-spline ``number``: the first three share one, and the last three."""
    return min(max(number - 2, 0), count - 1)


@njit(cache=True)
def _assemble(
    positions: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    terms: FloatArray,
    count: int,
) -> _Equations:
    band = np.zeros((count, _BAND))
    right = np.zeros(count)
    several = terms.shape[1]
    cross = np.zeros((count, several))
    square = np.zeros((several, several))
    terms_right = np.zeros(several)
    basis = np.zeros(4)
    squares = 0.0
    for i in range(positions.size):
        w = weights[i]
        squares += w * values[i] * values[i]
        first = _basis(positions[i], basis)
        for j in range(4):
            row = _tied(first + j, count)
            here = w * basis[j]
            right[row] += here * values[i]
            for m in range(several):
                cross[row, m] += here * terms[i, m]
            for k in range(4):
                col = _tied(first + k, count)
                if col <= row:
                    band[row, row - col] += here * basis[k]
        for m in range(several):
            terms_right[m] += w * terms[i, m] * values[i]
            for k in range(several):
                square[m, k] += w * terms[i, m] * terms[i, k]
    return _Equations(band, right, cross, square, terms_right, squares, positions.size)


@njit(cache=True)
def _penalty_band(stiffness: FloatArray) -> FloatArray:
    count = stiffness.size - 3
    band = np.zeros((count, _BAND))
    # Outside, the curve goes on flat: differences that reach over an end count too.
    for first in range(-3, count):
        for j in range(4):
            row = min(max(first + j, 0), count - 1)
            for k in range(4):
                col = min(max(first + k, 0), count - 1)
                if col <= row:
                    band[row, row - col] += stiffness[first + 3] * _PENALTY[j] * _PENALTY[k]
    return band


@njit(cache=True, error_model="numpy")
def _factor(data: FloatArray, penalty: FloatArray, weight: float) -> FloatArray:
    """Lower Cholesky factor in the band; its first element is 0 where there is none."""
    count = data.shape[0]
    factor = np.zeros_like(data)
    for i in range(count):
        for d in range(min(_BAND - 1, i), -1, -1):
            j = i - d
            total = data[i, d] + weight * penalty[i, d]
            for m in range(max(0, i - _BAND + 1), j):
                total -= factor[i, i - m] * factor[j, j - m]
            if d == 0:
                if not total > 0.0:
                    factor[0, 0] = 0.0
                    return factor
                factor[i, 0] = np.sqrt(total)
            else:
                factor[i, d] = total / factor[j, 0]
    return factor


@njit(cache=True, error_model="numpy")
def _forward(factor: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with the lower factor for columns of right sides, shape ``(n, k)``."""
    out = right.copy()
    for i in range(out.shape[0]):
        for d in range(1, min(_BAND, i + 1)):
            for k in range(out.shape[1]):
                out[i, k] -= factor[i, d] * out[i - d, k]
        scale = 1.0 / factor[i, 0]
        for k in range(out.shape[1]):
            out[i, k] *= scale
    return out


@njit(cache=True, error_model="numpy")
def _backward(factor: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with the transposed factor."""
    out = right.copy()
    count = out.size
    for i in range(count - 1, -1, -1):
        for d in range(1, min(_BAND, count - i)):
            out[i] -= factor[i + d, d] * out[i + d]
        out[i] /= factor[i, 0]
    return out


@njit(cache=True, error_model="numpy")
def _lower(square: FloatArray) -> FloatArray:
    """Cholesky factor of the few terms: the library's takes longer to compile than to write."""
    factor = np.zeros_like(square)
    for i in range(square.shape[0]):
        for j in range(i + 1):
            total = square[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            factor[i, j] = np.sqrt(max(total, 0.0)) if i == j else total / factor[j, j]
    return factor


@njit(cache=True, error_model="numpy")
def _lower_solved(factor: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with a small lower factor for columns of right sides, shape ``(m, k)``."""
    out = right.copy()
    for i in range(factor.shape[0]):
        for j in range(i):
            out[i] -= factor[i, j] * out[j]
        out[i] /= factor[i, i]
    return out


@njit(cache=True, error_model="numpy")
def _solved(equations: _Equations, penalty: FloatArray, weight: float) -> tuple[float, SplineFit]:
    """Twice the restricted log likelihood, up to a constant, and the fit at a penalty's weight."""
    count, several = equations.cross.shape
    factor = _factor(equations.band, penalty, weight)
    none = np.empty((1, 0))
    if factor[0, 0] == 0.0:
        return -np.inf, SplineFit(False, equations.right, none[0], factor, none, none, 0.0)
    sides = np.empty((count, several + 1))
    sides[:, :several] = equations.cross
    sides[:, several] = equations.right
    sides = _forward(factor, sides)
    products: FloatArray = np.ascontiguousarray(sides.T) @ sides
    square = equations.terms - products[:several, :several]
    for m in range(several):
        square[m, m] = max(square[m, m], 0.0) + _RIDGE * equations.terms[m, m]
    border = _lower(square)
    reduced = _lower_solved(border, (equations.terms_right - products[:several, several])[:, None])
    left = equations.squares - products[several, several] - np.sum(reduced**2)
    freedom = max(equations.samples - several - 1, 1)
    scale = left / freedom
    # Only what is surely more than the weights say is taken from so few samples.
    if scale < 1.0 + _SURPRISING * sqrt(2.0 / freedom):
        scale = 1.0
    likelihood = (count - 1) * log(weight) - left
    for i in range(count):
        likelihood -= 2.0 * log(factor[i, 0])
    for m in range(several):
        likelihood -= 2.0 * log(border[m, m])
    terms = reduced[:, 0].copy()
    for i in range(several - 1, -1, -1):
        for j in range(i + 1, several):
            terms[i] -= border[j, i] * terms[j]
        terms[i] /= border[i, i]
    cross = sides[:, :several].copy()
    coefficients = _backward(factor, sides[:, several] - cross @ terms)
    fit = SplineFit(True, coefficients, terms, factor, cross, border, scale)
    return likelihood, fit


@njit(cache=True, error_model="numpy")
def fit_penalised_spline(
    positions: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    terms: FloatArray,
    precision: FloatArray,
    stiffness: FloatArray,
) -> SplineFit:
    """Fit known terms and a smooth deviation that is flat at and beyond both its ends.

    Parameters
    ----------
    positions
        Positions of the samples in knots, from 0 to ``count + 1`` with ``count`` coefficients.
    values, weights
        Levels there and their inverse variances, shape ``(n,)``.
    terms
        The terms at the samples, shape ``(n, m)``.
    precision
        Inverse variance of each term's prior about 0, shape ``(m,)``; 0 for a free term.
    stiffness
        Weight of each third difference relative to the others, shape ``(count + 3,)``; the
        one at k lies ``k - 0.5`` knots from the left end.
    """
    equations = _assemble(positions, values, weights, terms, stiffness.size - 3)
    for m in range(precision.size):
        equations.terms[m, m] += precision[m]
    penalty = _penalty_band(stiffness)
    unit = np.mean(weights)
    step = (_HEAVIEST_LOG - _LIGHTEST_LOG) / (_COARSE_STEPS - 1)
    best, most = 0, -np.inf
    for k in range(_COARSE_STEPS):
        here = _solved(equations, penalty, unit * np.exp(_LIGHTEST_LOG + k * step))[0]
        if here > most:
            best, most = k, here
    low, high = _LIGHTEST_LOG + (best - 1) * step, _LIGHTEST_LOG + (best + 1) * step
    first, second = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    at_first = _solved(equations, penalty, unit * np.exp(first))[0]
    at_second = _solved(equations, penalty, unit * np.exp(second))[0]
    for _ in range(_FINE_STEPS):
        if at_first > at_second:
            high, second, at_second = second, first, at_first
            first = high - _GOLDEN * (high - low)
            at_first = _solved(equations, penalty, unit * np.exp(first))[0]
        else:
            low, first, at_first = first, second, at_second
            second = low + _GOLDEN * (high - low)
            at_second = _solved(equations, penalty, unit * np.exp(second))[0]
    weight = min(0.5 * (low + high), _HEAVIEST_LOG)
    return _solved(equations, penalty, unit * np.exp(weight))[1]


@njit(cache=True, error_model="numpy")
def variances(fit: SplineFit, by_coefficient: FloatArray, by_term: FloatArray) -> FloatArray:
    """Posterior variances of what depends so on the coefficients and on the terms.

    Parameters
    ----------
    fit
        A fit that was found.
    by_coefficient, by_term
        Derivatives, shapes ``(count, k)`` and ``(m, k)`` for k quantities.
    """
    inner = _forward(fit.factor, by_coefficient)
    outer = _lower_solved(fit.border, by_term - np.ascontiguousarray(fit.cross.T) @ inner)
    out = np.empty(by_coefficient.shape[1])
    for k in range(out.size):
        out[k] = np.sum(inner[:, k] ** 2) + np.sum(outer[:, k] ** 2)
    return out * fit.scale


@njit(cache=True)
def curve_values(positions: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Values of the fitted curve at positions in knots."""
    out = np.empty(positions.size)
    basis = np.zeros(4)
    for i in range(positions.size):
        first = _basis(positions[i], basis)
        out[i] = 0.0
        for j in range(4):
            out[i] += basis[j] * coefficients[_tied(first + j, coefficients.size)]
    return out
