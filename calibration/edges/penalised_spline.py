"""A smooth curve through unbinned samples: a P-spline, flat at both ends, solved in its band.

Cubic B-splines on equal knots with a penalty on the third differences of the coefficients
(Eilers and Marx, "Flexible smoothing with B-splines and penalties", Statistical Science 11,
1996). The weight of the penalty is the one with the least generalised cross-validation score
(Craven and Wahba, "Smoothing noisy data with spline functions", Numerische Mathematik 31, 1979).
The normal equations and the penalty have three off-diagonals: a banded Cholesky factor solves
them, and gives the trace of the hat matrix without a full inverse (Hutchinson and de Hoog,
"Smoothing noisy data with spline functions", Numerische Mathematik 47, 1985).
"""

from math import log

import numpy as np
from numba import njit

from simulation.arrays import FloatArray

DEGREE = 3
_BAND = 4  # the diagonal and three beside it
_PENALTY = (-1.0, 3.0, -3.0, 1.0)  # third difference
_LIGHTEST_LOG = log(1e-9)
_HEAVIEST_LOG = log(1e6)
_GOLDEN = 0.6180339887498949
_COARSE_STEPS = 12
_FINE_STEPS = 10


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
    positions: FloatArray, values: FloatArray, weights: FloatArray, count: int
) -> tuple[FloatArray, FloatArray]:
    band = np.zeros((count, _BAND))
    right = np.zeros(count)
    basis = np.zeros(4)
    for i in range(positions.size):
        if weights[i] == 0.0:
            continue
        first = _basis(positions[i], basis)
        for j in range(4):
            row = _tied(first + j, count)
            right[row] += weights[i] * basis[j] * values[i]
            for k in range(4):
                col = _tied(first + k, count)
                if col <= row:
                    band[row, row - col] += weights[i] * basis[j] * basis[k]
    return band, right


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


@njit(cache=True)
def _factor(band: FloatArray) -> FloatArray:
    """Lower Cholesky factor in the band; its first column is 0 where there is none."""
    count = band.shape[0]
    factor = np.zeros_like(band)
    for i in range(count):
        for d in range(min(_BAND - 1, i), -1, -1):
            j = i - d
            total = band[i, d]
            for m in range(max(0, i - _BAND + 1), j):
                if j - m < _BAND:
                    total -= factor[i, i - m] * factor[j, j - m]
            if d == 0:
                if total <= 0.0:
                    factor[0, 0] = 0.0
                    return factor
                factor[i, 0] = np.sqrt(total)
            else:
                factor[i, d] = total / factor[j, 0]
    return factor


@njit(cache=True)
def band_solve(factor: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with the banded Cholesky factor that ``fit_penalised_spline`` returns."""
    count = right.size
    out = right.copy()
    for i in range(count):
        for d in range(1, min(_BAND, i + 1)):
            out[i] -= factor[i, d] * out[i - d]
        out[i] /= factor[i, 0]
    for i in range(count - 1, -1, -1):
        for d in range(1, min(_BAND, count - i)):
            out[i] -= factor[i + d, d] * out[i + d]
        out[i] /= factor[i, 0]
    return out


@njit(cache=True)
def _inverse_band(factor: FloatArray) -> FloatArray:
    """Elements of the inverse inside the band, from the last row upwards."""
    count = factor.shape[0]
    inverse = np.zeros_like(factor)
    for i in range(count - 1, -1, -1):
        pivot = factor[i, 0]
        for d in range(min(_BAND - 1, count - 1 - i), -1, -1):
            j = i + d
            total = 1.0 / (pivot * pivot) if d == 0 else 0.0
            for m in range(i + 1, min(i + _BAND, count)):
                low, high = min(m, j), max(m, j)
                if high - low < _BAND:
                    total -= factor[m, m - i] / pivot * inverse[high, high - low]
            inverse[j, d] = total
    return inverse


@njit(cache=True)
def _score(
    log_weight: float,
    data: FloatArray,
    right: FloatArray,
    penalty: FloatArray,
    squares: float,
    samples: float,
) -> tuple[float, FloatArray, FloatArray, float]:
    """Cross-validation score, coefficients, factor, effective number of parameters."""
    factor = _factor(data + np.exp(log_weight) * penalty)
    if factor[0, 0] == 0.0:
        return np.inf, right, factor, 0.0
    coefficients = band_solve(factor, right)
    inverse = _inverse_band(factor)
    used = 0.0
    fitted2 = 0.0
    for i in range(right.size):
        used += inverse[i, 0] * data[i, 0]
        fitted2 += coefficients[i] * data[i, 0] * coefficients[i]
        for d in range(1, min(_BAND, i + 1)):
            used += 2.0 * inverse[i, d] * data[i, d]
            fitted2 += 2.0 * coefficients[i] * data[i, d] * coefficients[i - d]
    cross = 0.0
    for i in range(right.size):
        cross += coefficients[i] * right[i]
    left = max(squares - 2.0 * cross + fitted2, 1e-13 * squares)
    free = max(samples - used, 1.0)
    return samples * left / (free * free), coefficients, factor, left / free


@njit(cache=True)
def fit_penalised_spline(
    positions: FloatArray, values: FloatArray, weights: FloatArray, stiffness: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Fit the coefficients of a curve that is flat at and beyond both its ends.

    Parameters
    ----------
    positions
        Positions of the samples in knots, from 0 to ``count + 1`` with ``count`` coefficients.
    values, weights
        Levels there and their weights, shape ``(n,)``; 0 leaves a sample out.
    stiffness
        Weight of each third difference relative to the others, shape ``(count + 3,)``; the
        one at k lies ``k - 0.5`` knots from the left end.

    Returns
    -------
    coefficients, factor, residual variance
        ``factor`` is the banded Cholesky factor of the penalised normal equations, for
        ``band_solve``; its first element is 0 where they cannot be solved.
    """
    data, right = _assemble(positions, values, weights, stiffness.size - 3)
    penalty = _penalty_band(stiffness)
    squares = np.sum(weights * values * values)
    samples = float(np.count_nonzero(weights))
    step = (_HEAVIEST_LOG - _LIGHTEST_LOG) / (_COARSE_STEPS - 1)
    best, least = 0, np.inf
    for k in range(_COARSE_STEPS):
        score = _score(_LIGHTEST_LOG + k * step, data, right, penalty, squares, samples)[0]
        if score < least:
            best, least = k, score
    low = _LIGHTEST_LOG + (best - 1) * step
    high = _LIGHTEST_LOG + (best + 1) * step
    for _ in range(_FINE_STEPS):
        first = high - _GOLDEN * (high - low)
        second = low + _GOLDEN * (high - low)
        if (
            _score(first, data, right, penalty, squares, samples)[0]
            < _score(second, data, right, penalty, squares, samples)[0]
        ):
            high = second
        else:
            low = first
    _, coefficients, factor, variance = _score(
        0.5 * (low + high), data, right, penalty, squares, samples
    )
    return coefficients, factor, variance


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
