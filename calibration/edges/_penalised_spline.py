"""A smooth deviation from a few known shapes: a P-spline beside free terms, solved in its band.

Cholesky factors of a band and of a few terms beside it, and what is solved with them. All is
written out: LAPACK's routines take longer to compile for so small systems than to run.

Cubic B-splines on equal knots with a penalty on the third differences of the coefficients (Eilers
and Marx, "Flexible smoothing with B-splines and penalties", Statistical Science 11, 1996), flat at
both ends, beside a few unpenalised terms. As a mixed model the penalty is a prior on the deviation;
its weight has the greatest restricted likelihood (Wood, "Fast stable restricted maximum likelihood
and marginal likelihood estimation of semiparametric generalized linear models", JRSS B 73, 2011),
and the posterior covariance holds what the smoothing takes away as well as the noise (Wahba,
"Bayesian confidence intervals for the cross-validated smoothing spline", JRSS B 45, 1983). The
spline's normal equations have three off-diagonals: a banded Cholesky factor solves them, and the
terms are a border of the system.
"""

from math import log, sqrt
from typing import NamedTuple

import numpy as np

from simulation.arrays import FloatArray
from simulation.compiled import compiled_part

BAND = 4  # the diagonal and three beside it


@compiled_part()
def _band_factor(data: FloatArray, penalty: FloatArray, weight: float) -> FloatArray:
    """Lower Cholesky factor in the band; its first element is 0 where there is none."""
    count = data.shape[0]
    factor = np.zeros((count + BAND - 1, BAND))  # three rows of zeros come before the first
    inverse3 = inverse2 = inverse1 = 0.0  # of the diagonal in the rows before
    for i in range(count):
        k = i + BAND - 1
        third = (data[i, 3] + weight * penalty[i, 3]) * inverse3
        second = data[i, 2] + weight * penalty[i, 2] - third * factor[k - 2, 1]
        second *= inverse2
        first = data[i, 1] + weight * penalty[i, 1]
        first -= third * factor[k - 1, 2] + second * factor[k - 1, 1]
        first *= inverse1
        pivot = data[i, 0] + weight * penalty[i, 0]
        pivot -= first * first + second * second + third * third
        if not pivot > 0.0:
            factor[BAND - 1, 0] = 0.0
            break
        root = np.sqrt(pivot)
        inverse3, inverse2, inverse1 = inverse2, inverse1, 1.0 / root
        factor[k, 0], factor[k, 1], factor[k, 2], factor[k, 3] = root, first, second, third
    return factor[BAND - 1 :]


@compiled_part()
def _forward_solved(factor: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with the lower factor for columns of right sides, shape ``(n, k)``."""
    out = right.copy()
    for i in range(out.shape[0]):
        first, second, third = factor[i, 1], factor[i, 2], factor[i, 3]
        scale = 1.0 / factor[i, 0]
        # What lies before the first row has factors of 0.
        one, two, three = max(i - 1, 0), max(i - 2, 0), max(i - 3, 0)
        for k in range(out.shape[1]):
            left = first * out[one, k] + second * out[two, k] + third * out[three, k]
            out[i, k] = (out[i, k] - left) * scale
    return out


@compiled_part()
def _backward_solved(factor: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with the transposed factor."""
    out = right.copy()
    count = out.size
    for i in range(count - 1, -1, -1):
        for d in range(1, min(BAND, count - i)):
            out[i] -= factor[i + d, d] * out[i + d]
        out[i] /= factor[i, 0]
    return out


@compiled_part()
def _lower_factor(square: FloatArray) -> FloatArray:
    """Lower Cholesky factor of the few terms."""
    factor = np.zeros_like(square)
    for i in range(square.shape[0]):
        for j in range(i + 1):
            total = square[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            factor[i, j] = np.sqrt(max(total, 0.0)) if i == j else total / factor[j, j]
    return factor


@compiled_part()
def _lower_solved(factor: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with a small lower factor for columns of right sides, shape ``(m, k)``."""
    out = np.empty_like(right)
    for i in range(factor.shape[0]):
        for k in range(out.shape[1]):
            left = right[i, k]
            for j in range(i):
                left -= factor[i, j] * out[j, k]
            out[i, k] = left / factor[i, i]
    return out


@compiled_part()
def _column_products(left: FloatArray, right: FloatArray) -> FloatArray:
    """Products of the columns, ``left.T @ right``."""
    out = np.zeros((left.shape[1], right.shape[1]))
    for i in range(left.shape[0]):
        for j in range(left.shape[1]):
            for k in range(right.shape[1]):
                out[j, k] += left[i, j] * right[i, k]
    return out


@compiled_part()
def _log_of_diagonal(factor: FloatArray) -> float:
    """Logarithm of the product of the diagonal, in parts that do not overflow."""
    total, product = 0.0, 1.0
    for i in range(factor.shape[0]):
        product *= factor[i, 0]
        if not 1e-100 < product < 1e100:
            total += log(product)
            product = 1.0
    return total + log(product)


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

    With n coefficients and m terms: ``coefficients`` (n,), ``terms`` (m,), and the factors
    ``factor`` (n, 4), ``cross`` (n, m) and ``border`` (m, m) whose inverse times ``scale``, by how
    much the samples scatter more than weighted, is the posterior covariance.
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

    ``sides``, shape ``(n, m + 1)``, are the spline's solutions for terms and levels; ``likelihood``
    is twice the restricted logarithm, up to a constant.
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
    factor = _band_factor(equations.band, penalty, weight)
    if factor[0, 0] == 0.0:
        none = np.empty((1, 0))
        return _Reduced(False, -np.inf, 0.0, factor, none, none, none)
    sides = np.empty((count, several + 1))
    for i in range(count):
        for m in range(several):
            sides[i, m] = equations.cross[i, m]
        sides[i, several] = equations.right[i]
    sides = _forward_solved(factor, sides)
    products = _column_products(sides, sides)
    square, right = np.empty((several, several)), np.empty((several, 1))
    for m in range(several):
        for k in range(several):
            square[m, k] = equations.terms[m, k] - products[m, k]
        square[m, m] = max(square[m, m], 0.0) + _RIDGE * equations.terms[m, m]
        right[m, 0] = equations.terms_right[m] - products[m, several]
    border = _lower_factor(square)
    right = _lower_solved(border, right)
    left = equations.squares - products[several, several]
    for m in range(several):
        left -= right[m, 0] * right[m, 0]
    freedom = max(equations.samples - several - 1, 1)
    scale = left / freedom
    # Only what is surely more than the weights say is taken from so few samples.
    if scale < 1.0 + _SURPRISING * sqrt(2.0 / freedom):
        scale = 1.0
    likelihood = (count - 1) * log(weight) - left
    likelihood -= 2.0 * _log_of_diagonal(factor)
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
    coefficients = _backward_solved(reduced.factor, left)
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

    Positions are in knots, 0 to ``count + 1`` with ``count`` coefficients; ``terms`` has shape
    ``(n, m)``, ``precision`` is the inverse variance of each term's prior about 0. The stiffness,
    shape ``(count + 3,)``, weighs third differences; that at k lies ``k - 0.5`` knots from the
    left.
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
    often as not. Every other step is looked at, and those between where it matters.
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
    """Posterior variances of k quantities with derivatives ``(count, k)`` and ``(m, k)``."""
    inner = _forward_solved(fit.factor, by_coefficient)
    outer = _column_products(fit.cross, inner)
    for m in range(outer.shape[0]):
        for k in range(outer.shape[1]):
            outer[m, k] = by_term[m, k] - outer[m, k]
    outer = _lower_solved(fit.border, outer)
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


@compiled_part()
def curve_slopes(positions: FloatArray, count: int) -> FloatArray:
    """Derivatives of the curve at positions in knots by its coefficients, ``(count, k)``."""
    out = np.zeros((count, positions.size))
    basis = np.zeros(4)
    for i in range(positions.size):
        first = _basis(positions[i], basis)
        for j in range(4):
            out[_tied(first + j, count), i] += basis[j]
    return out
