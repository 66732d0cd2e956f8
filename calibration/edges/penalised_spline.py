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

from calibration.edges.banded_cholesky import (
    BAND,
    backward_solved,
    band_factor,
    column_products,
    forward_solved,
    log_of_diagonal,
    lower_factor,
    lower_solved,
)
from simulation.arrays import FloatArray
from simulation.compiled import compiled_part

DEGREE = 3
_PENALTY = (-1.0, 3.0, -3.0, 1.0)  # third difference
_LIGHTEST_LOG = log(1e-9)
_HEAVIEST_LOG = log(1e6)
_STEPS = 11  # of a decade and a half: over one the smoothing length changes by three quarters
_FALLEN = 2.0  # errors then hold what a lens that is no Gaussian differs by, for 2 % more noise
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


@compiled_part()
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


@compiled_part()
def _tied(number: int, count: int) -> int:
    """Coefficient of B-spline ``number``: the first three share one, and the last three."""
    return min(max(number - 2, 0), count - 1)


@compiled_part()
def _assemble(
    positions: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    terms: FloatArray,
    count: int,
) -> _Equations:
    band = np.zeros((count, BAND))
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


@compiled_part()
def _penalty_band(stiffness: FloatArray) -> FloatArray:
    count = stiffness.size - 3
    band = np.zeros((count, BAND))
    # Outside, the curve goes on flat: differences that reach over an end count too.
    for first in range(-3, count):
        for j in range(4):
            row = min(max(first + j, 0), count - 1)
            for k in range(4):
                col = min(max(first + k, 0), count - 1)
                if col <= row:
                    band[row, row - col] += stiffness[first + 3] * _PENALTY[j] * _PENALTY[k]
    return band


class _Reduced(NamedTuple):
    """The system without its spline: the terms' factor and right side; void if not ``is_found``.

    ``sides`` are the spline's factor's solutions for each term and for the levels, shape
    ``(n, m + 1)``; ``likelihood`` is twice the restricted logarithm, up to a constant.
    """

    is_found: bool
    likelihood: float
    scale: float
    factor: FloatArray
    sides: FloatArray
    border: FloatArray
    right: FloatArray


@compiled_part()
def _reduced(equations: _Equations, penalty: FloatArray, weight: float) -> _Reduced:
    """Eliminate the spline at a penalty's weight."""
    count, several = equations.cross.shape
    factor = band_factor(equations.band, penalty, weight)
    if factor[0, 0] == 0.0:
        none = np.empty((1, 0))
        return _Reduced(False, -np.inf, 0.0, factor, none, none, none)
    sides = np.empty((count, several + 1))
    for i in range(count):
        for m in range(several):
            sides[i, m] = equations.cross[i, m]
        sides[i, several] = equations.right[i]
    sides = forward_solved(factor, sides)
    products = column_products(sides, sides)
    square, right = np.empty((several, several)), np.empty((several, 1))
    for m in range(several):
        for k in range(several):
            square[m, k] = equations.terms[m, k] - products[m, k]
        square[m, m] = max(square[m, m], 0.0) + _RIDGE * equations.terms[m, m]
        right[m, 0] = equations.terms_right[m] - products[m, several]
    border = lower_factor(square)
    right = lower_solved(border, right)
    left = equations.squares - products[several, several]
    for m in range(several):
        left -= right[m, 0] * right[m, 0]
    freedom = max(equations.samples - several - 1, 1)
    scale = left / freedom
    # Only what is surely more than the weights say is taken from so few samples.
    if scale < 1.0 + _SURPRISING * sqrt(2.0 / freedom):
        scale = 1.0
    likelihood = (count - 1) * log(weight) - left
    likelihood -= 2.0 * log_of_diagonal(factor)
    for m in range(several):
        likelihood -= 2.0 * log(border[m, m])
    return _Reduced(True, likelihood, scale, factor, sides, border, right)


@compiled_part()
def _solved(reduced: _Reduced) -> SplineFit:
    """Go back from the terms to the spline."""
    several = reduced.border.shape[0]
    if not reduced.is_found:
        none = np.empty((1, 0))
        return SplineFit(False, none[0], none[0], reduced.factor, none, none, 0.0)
    border, terms = reduced.border, np.empty(several)
    for i in range(several - 1, -1, -1):
        terms[i] = reduced.right[i, 0]
        for j in range(i + 1, several):
            terms[i] -= border[j, i] * terms[j]
        terms[i] /= border[i, i]
    count = reduced.sides.shape[0]
    cross, left = np.empty((count, several)), np.empty(count)
    for i in range(count):
        left[i] = reduced.sides[i, several]
        for m in range(several):
            cross[i, m] = reduced.sides[i, m]
            left[i] -= cross[i, m] * terms[m]
    coefficients = backward_solved(reduced.factor, left)
    return SplineFit(True, coefficients, terms, reduced.factor, cross, border, reduced.scale)


@compiled_part()
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
    unit = log(np.mean(weights)) + _LIGHTEST_LOG
    step = (_HEAVIEST_LOG - _LIGHTEST_LOG) / (_STEPS - 1)
    at = step * _lightest_likely(equations, penalty, unit, step)
    return _solved(_reduced(equations, penalty, np.exp(unit + at)))


@compiled_part()
def _lightest_likely(
    equations: _Equations, penalty: FloatArray, lightest: float, step: float
) -> float:
    """Step at which twice the log likelihood has fallen so far below its maximum, to the light.

    At the maximum itself, what single samples add to the curve's detail would be smoothed away as
    often as not, and no error would say so. Every other step is looked at, and those between them
    where it matters.
    """
    likelihood = np.empty(_STEPS)
    best = 0
    for k in range(0, _STEPS, 2):
        likelihood[k] = _reduced(equations, penalty, np.exp(lightest + k * step)).likelihood
        # Until it is known, a step counts as the one before.
        likelihood[min(k + 1, _STEPS - 1)] = likelihood[k]
        if likelihood[k] > likelihood[best]:
            best = k
    for k in range(best - 1, best + 2, 2):
        if 0 < k < _STEPS:
            likelihood[k] = _reduced(equations, penalty, np.exp(lightest + k * step)).likelihood
    best = int(np.argmax(likelihood))
    lowest = likelihood[best] - _FALLEN
    k = best - best % 2
    while k > 0 and likelihood[k] > lowest:
        k -= 2
    if likelihood[k] > lowest:
        return 0.0
    if k + 1 < best - 1:
        middle = _reduced(equations, penalty, np.exp(lightest + (k + 1) * step)).likelihood
        likelihood[k + 1] = middle
    if likelihood[k + 1] <= lowest:
        k += 1
    rise = likelihood[k + 1] - likelihood[k]
    return float(k + 1 - (likelihood[k + 1] - lowest) / rise)


@compiled_part()
def variances(fit: SplineFit, by_coefficient: FloatArray, by_term: FloatArray) -> FloatArray:
    """Posterior variances of what depends so on the coefficients and on the terms.

    Parameters
    ----------
    fit
        A fit that was found.
    by_coefficient, by_term
        Derivatives, shapes ``(count, k)`` and ``(m, k)`` for k quantities.
    """
    inner = forward_solved(fit.factor, by_coefficient)
    outer = column_products(fit.cross, inner)
    for m in range(outer.shape[0]):
        for k in range(outer.shape[1]):
            outer[m, k] = by_term[m, k] - outer[m, k]
    outer = lower_solved(fit.border, outer)
    out = np.zeros(by_coefficient.shape[1])
    for k in range(out.size):
        for i in range(inner.shape[0]):
            out[k] += inner[i, k] * inner[i, k]
        for m in range(outer.shape[0]):
            out[k] += outer[m, k] * outer[m, k]
        out[k] *= fit.scale
    return out


@compiled_part()
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
