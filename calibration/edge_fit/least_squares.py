"""Least squares of an edge on raw pixels: the normal equations, and the steps to their minimum.

The model and its derivatives are evaluated in one compiled pass over the pixels, the products of
the normal equations in another, whose sums run in parallel lanes. ``benchmarks/bench_edge_fit.py``
shows what that gains.
"""

from typing import NamedTuple

import numpy as np

from calibration.edge_fit.model import (
    CURVATURE,
    HIGH,
    LOG_SIGMA,
    LOW,
    OFFSET,
    SHADED_PARAMETERS,
    TURN,
    unit_edge,
)
from calibration.edge_search import BandPixels
from simulation.arrays import FloatArray
from simulation.compiled import compiled_part

_LOG_SIGMA_MIN = -3.5  # 0.03 px: narrower than a pixel can resolve
_LOG_SIGMA_MAX = 4.0
_MAX_STEPS = 40
_MAX_DAMPINGS = 12  # tenfold each


class _NormalEquations(NamedTuple):
    """``hessian`` J'WJ, ``gradient`` J'Wr and the weighted sum of squares."""

    hessian: FloatArray
    gradient: FloatArray
    squares: float


@compiled_part()
def _normal_equations(
    pixels: BandPixels, weights: FloatArray, parameters: FloatArray, is_square: bool
) -> _NormalEquations:
    x, y, values, half_length = pixels.x, pixels.y, pixels.values, pixels.half_length_px
    count = parameters.size
    residuals = np.empty(x.size)
    # A row a parameter, as the products below run over the pixels.
    slopes = np.zeros((count, x.size))
    angle = pixels.normal_rad + parameters[TURN] / half_length
    cosine, sine = np.cos(angle), np.sin(angle)
    a, b = abs(cosine), abs(sine)
    sigma = np.exp(parameters[LOG_SIGMA])
    bend = parameters[CURVATURE]
    per_length = 1.0 / half_length
    is_shaded = count == SHADED_PARAMETERS
    for i in range(x.size):
        along = (-sine * x[i] + cosine * y[i]) * per_length
        across = cosine * x[i] + sine * y[i]
        d = across - parameters[OFFSET] - bend * along * along
        edge, slope, by_log_sigma = unit_edge(d, sigma, a, b, is_square)
        low, high = parameters[LOW], parameters[HIGH]
        if is_shaded:
            low += parameters[6] * along
            high += parameters[7] * along
            slopes[6, i] = along * (1.0 - edge)
            slopes[7, i] = along * edge
        residuals[i] = values[i] - low - (high - low) * edge
        slopes[LOW, i] = 1.0 - edge
        slopes[HIGH, i] = edge
        if slope == 0.0:  # far from the edge
            continue
        across_step = (high - low) * slope
        slopes[TURN, i] = across_step * (along + 2.0 * bend * along * across * per_length**2)
        slopes[OFFSET, i] = -across_step
        slopes[CURVATURE, i] = -across_step * along * along
        slopes[LOG_SIGMA, i] = (high - low) * by_log_sigma
    return _products(slopes, residuals, weights)


@compiled_part(fastmath={"reassoc", "contract"})
def _products(slopes: FloatArray, residuals: FloatArray, weights: FloatArray) -> _NormalEquations:
    """Weighted products of the derivatives and of the residuals.

    The order of the sums is free: they run in parallel lanes.
    """
    count, size = slopes.shape
    hessian, gradient = np.empty((count, count)), np.empty(count)
    weighted = np.empty(size)
    for j in range(count):
        for i in range(size):
            weighted[i] = weights[i] * slopes[j, i]
        total = 0.0
        for i in range(size):
            total += weighted[i] * residuals[i]
        gradient[j] = total
        for k in range(j + 1):
            total = 0.0
            for i in range(size):
                total += weighted[i] * slopes[k, i]
            hessian[j, k] = hessian[k, j] = total
    squares = 0.0
    for i in range(size):
        squares += weights[i] * residuals[i] * residuals[i]
    return _NormalEquations(hessian, gradient, squares)


class Minimum(NamedTuple):
    """Minimum of the weighted squares; valid only if ``is_found``.

    ``hessian`` is J'WJ there: its inverse is the covariance of the parameters where the weights
    are inverse variances.
    """

    is_found: bool
    parameters: FloatArray
    hessian: FloatArray
    squares: float


@compiled_part()
def levenberg_marquardt(
    pixels: BandPixels, weights: FloatArray, start: FloatArray, is_square: bool, tolerance: float
) -> Minimum:
    """Minimise the weighted squares from ``start``.

    A step below ``tolerance`` (px, and parts of sigma) is the last one; what is left is smaller by
    far, as the steps shrink fast.
    """
    best = start.copy()
    here = _normal_equations(pixels, weights, best, is_square)
    damping = 1e-4
    for _ in range(_MAX_STEPS):
        moved = False
        trial, there = best, here
        for _ in range(_MAX_DAMPINGS):
            change = solved(here.hessian, here.gradient, damping)
            trial = np.empty(best.size)
            largest = gain = 0.0
            for k in range(best.size):
                trial[k] = best[k] + change[k]
                gain += change[k] * here.gradient[k]
                if k < LOW and not abs(change[k]) <= largest:
                    largest = abs(change[k])
            trial[LOG_SIGMA] = min(max(trial[LOG_SIGMA], _LOG_SIGMA_MIN), _LOG_SIGMA_MAX)
            if largest < tolerance:
                # What so small a step gains follows from the equations that it solves.
                gain = min(max(gain, 0.0), here.squares)
                return _minimum(trial, here.hessian, here.squares - gain)
            there = _normal_equations(pixels, weights, trial, is_square)
            if there.squares <= here.squares:
                moved = True
                break
            damping *= 10.0
        if not moved:
            return _minimum(best, here.hessian, here.squares)
        gain = here.squares - there.squares
        best, here = trial, there
        damping *= 0.1
        if gain <= 1e-9 * here.squares:
            return _minimum(best, here.hessian, here.squares)
    return Minimum(False, best, here.hessian, here.squares)


@compiled_part()
def solved(hessian: FloatArray, gradient: FloatArray, damping: float) -> FloatArray:
    """Solve for a step, the diagonal damped in proportion; NaN where that is not positive.

    By Cholesky: for so few unknowns that is faster than a call of LAPACK, and raises nothing.
    """
    count = len(gradient)
    scale, factor = np.empty(count), np.empty((count, count))
    step = np.empty(count)
    for j in range(count):
        scale[j] = np.sqrt(abs(hessian[j, j]) * (1.0 + damping) + 1e-300)
    for j in range(count):
        for k in range(j + 1):
            value = 1.0 if j == k else hessian[j, k] / (scale[j] * scale[k])
            for m in range(k):
                value -= factor[j, m] * factor[k, m]
            if j > k:
                factor[j, k] = value / factor[k, k]
            elif value > 0.0:
                factor[j, j] = np.sqrt(value)
            else:
                step[:] = np.nan
                return step
    for j in range(count):
        value = gradient[j] / scale[j]
        for m in range(j):
            value -= factor[j, m] * step[m]
        step[j] = value / factor[j, j]
    for j in range(count - 1, -1, -1):
        for m in range(j + 1, count):
            step[j] -= factor[m, j] * step[m]
        step[j] /= factor[j, j]
    for j in range(count):
        step[j] /= scale[j]
    return step


@compiled_part()
def inverse_element(hessian: FloatArray, index: int) -> float:
    """Diagonal element of the inverse; NaN where the matrix is not positive."""
    unit = np.zeros(len(hessian))
    unit[index] = 1.0
    return float(solved(hessian, unit, 1e-14)[index])


@compiled_part()
def _minimum(parameters: FloatArray, hessian: FloatArray, squares: float) -> Minimum:
    is_finite = True
    for value in parameters:
        is_finite &= bool(np.isfinite(value))
    return Minimum(is_finite, parameters, hessian, squares)
