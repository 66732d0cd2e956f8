"""A straight or slightly curved edge as the sensor sees it, and its least-squares fit.

Two edge shapes share one parametrisation, with ``d`` the signed distance of a pixel centre from the
edge and ``E(d)`` rising from 0 to 1:

- *plain*: ``E = Phi(d / sigma)``, an edge sampled at points; sigma is the **total** width.
- *pixel square*: the same edge averaged over the unit pixel, whose projection on the edge
  normal is a trapezium with ``a = |cos|`` and ``b = |sin|`` of the normal's angle; sigma is
  the **optical** width. With ``G2(x) = ((x^2 + s^2) Phi(x/s) + x s phi(x/s)) / 2``,
  ``E = [G2(d+(a+b)/2) - G2(d+(a-b)/2) - G2(d-(a-b)/2) + G2(d-(a+b)/2)] / (a b)``.

Shading is a slope of either level *along* the edge. A slope across it would be confounded with the
tails of the PSF: on a real photograph it moves sigma by 2 % either way with the width of the band,
where the model without it stays within 0.3 %.

Least squares of an edge on raw pixels: the normal equations, and the steps to their minimum. The
model and its derivatives are evaluated in one compiled pass over the pixels, the products of the
normal equations in another, whose sums run in parallel lanes. ``benchmarks/speed/edge_fit.py``
shows what that gains.
"""

from math import cos, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from calibration.edges._segments import BandPixels
from simulation.arrays import FloatArray
from simulation.compiled import compiled, compiled_part

# Indices into the parameter vector. Lengths are in units of the half length h of the edge, so
# that all columns of the Jacobian have the same scale.
TURN, OFFSET, CURVATURE, LOG_SIGMA, LOW, HIGH = range(6)
FLAT_PARAMETERS = 6
SHADED_PARAMETERS = 8  # the slopes of the low and the high level along the edge follow

_INV_SQRT_2PI = 1.0 / sqrt(2.0 * pi)
_TAIL = 6.0  # standard deviations beyond which Phi is taken as 0 or 1: 1e-9
_STEPS = 128  # per standard deviation, in the table of Phi
_NARROWEST = 2e-3  # side of the trapezium below which its one-dimensional form is exact to 2e-7


def _normal_table() -> FloatArray:
    """Cubics through Phi and its slope over steps of the range that the lookup takes."""
    last = int(_TAIL + 2) * _STEPS
    x = np.arange(-last, last + 1) / _STEPS
    value, slope = ndtr(x), _INV_SQRT_2PI * np.exp(-0.5 * x * x) / _STEPS
    rise, left, right = np.diff(value), slope[:-1], slope[1:]
    return np.column_stack([value[:-1], left, 3 * rise - 2 * left - right, left + right - 2 * rise])


_NORMAL = _normal_table()
_NORMAL_LAST = len(_NORMAL) // 2 / _STEPS


@compiled_part()
def _normal(x: float) -> tuple[float, float]:
    """Phi and its density: cubics in steps, off by 6e-12 and 3e-9 at most."""
    if x < -_NORMAL_LAST:
        return 0.0, 0.0
    if x >= _NORMAL_LAST:
        return 1.0, 0.0
    position = (x + _NORMAL_LAST) * _STEPS
    k = int(position)
    t = position - k
    first, second, third = _NORMAL[k, 1], _NORMAL[k, 2], _NORMAL[k, 3]
    cumulative = _NORMAL[k, 0] + t * (first + t * (second + t * third))
    return cumulative, (first + t * (2.0 * second + t * 3.0 * third)) * _STEPS


@compiled_part()
def _unit_edge(
    d: float, s: float, a: float, b: float, is_square: bool
) -> tuple[float, float, float]:
    """Value, derivative by ``d`` and derivative by ``log s`` of the unit edge."""
    reach = _TAIL * s + (0.5 * (a + b) if is_square else 0.0)
    if d > reach:
        return 1.0, 0.0, 0.0
    if d < -reach:
        return 0.0, 0.0, 0.0
    per_s = 1.0 / s
    if not is_square:
        x = d * per_s
        cumulative, density = _normal(x)
        return cumulative, density * per_s, -density * x
    wide, narrow = (a, b) if a > b else (b, a)
    value = slope = by_s = 0.0
    if narrow < _NARROWEST:
        for sign in (1.0, -1.0):
            u = d + sign * 0.5 * wide
            cumulative, density = _normal(u * per_s)
            value += sign * (u * cumulative + s * density)
            slope += sign * cumulative
            by_s += sign * density
        return value / wide, slope / wide, s * by_s / wide
    for k in range(4):
        sign = 1.0 if k in (0, 3) else -1.0
        shift = 0.5 * (wide + narrow) if k in (0, 3) else 0.5 * (wide - narrow)
        u = d + (shift if k < 2 else -shift)
        cumulative, density = _normal(u * per_s)
        value += sign * 0.5 * ((u * u + s * s) * cumulative + u * s * density)
        slope += sign * (u * cumulative + s * density)
        by_s += sign * cumulative
    per_area = 1.0 / (wide * narrow)
    return value * per_area, slope * per_area, s * s * by_s * per_area


@compiled_part()
def slopes_gain(
    pixels: BandPixels, weights: FloatArray, residuals: FloatArray, edges: FloatArray
) -> float:
    """Estimate how much slopes of the levels along the unit ``edges`` would reduce the squares.

    Rao's score statistic at the flat optimum, the slopes nearly orthogonal to the rest.
    """
    x, y, half_length = pixels.x, pixels.y, pixels.half_length_px
    cosine, sine = np.cos(pixels.normal_rad), np.sin(pixels.normal_rad)
    ll = lh = hh = gl = gh = 0.0
    for i in range(x.size):
        along = (-sine * x[i] + cosine * y[i]) / half_length
        low, high = along * (1.0 - edges[i]), along * edges[i]
        ll += weights[i] * low * low
        lh += weights[i] * low * high
        hh += weights[i] * high * high
        gl += weights[i] * low * residuals[i]
        gh += weights[i] * high * residuals[i]
    determinant = ll * hh - lh * lh
    if not determinant > 0:
        return 0.0
    return (hh * gl * gl - 2 * lh * gl * gh + ll * gh * gh) / determinant


class EdgeLevels(NamedTuple):
    """Model level, signed distance in px and unit edge at each pixel."""

    levels: FloatArray
    distances: FloatArray
    edges: FloatArray


@compiled_part()
def edge_values(pixels: BandPixels, parameters: FloatArray, is_square: bool) -> EdgeLevels:
    """Evaluate the model at each pixel."""
    x, y, half_length = pixels.x, pixels.y, pixels.half_length_px
    levels = np.empty(x.size)
    distances = np.empty(x.size)
    edges = np.empty(x.size)
    angle = pixels.normal_rad + parameters[TURN] / half_length
    cosine, sine = np.cos(angle), np.sin(angle)
    a, b = abs(cosine), abs(sine)
    sigma = np.exp(parameters[LOG_SIGMA])
    per_length = 1.0 / half_length
    for i in range(x.size):
        along = (-sine * x[i] + cosine * y[i]) * per_length
        across = cosine * x[i] + sine * y[i]
        d = across - parameters[OFFSET] - parameters[CURVATURE] * along * along
        edge, _, _ = _unit_edge(d, sigma, a, b, is_square)
        low = parameters[LOW]
        step = parameters[HIGH] - low
        if parameters.size == SHADED_PARAMETERS:
            low += parameters[6] * along
            step += (parameters[7] - parameters[6]) * along
        levels[i] = low + step * edge
        distances[i] = d
        edges[i] = edge
    return EdgeLevels(levels, distances, edges)


@compiled()
def _profile(d: FloatArray, sigma: float, a: float, b: float, is_square: bool) -> FloatArray:
    out = np.empty(d.size)
    for i in range(d.size):
        out[i] = _unit_edge(d[i], sigma, a, b, is_square)[0]
    return out


def edge_profile(
    distances_px: FloatArray, sigma_px: float, normal_angle_rad: float | None = None
) -> FloatArray:
    """Unit edge (0 to 1) at signed distances from it.

    The width is the total one; with the angle of the normal it is the optical one, and the pixel
    square is integrated exactly.
    """
    distances = np.ascontiguousarray(distances_px, dtype=np.float64)
    if normal_angle_rad is None:
        return np.asarray(_profile(distances, sigma_px, 1.0, 0.0, False))
    a, b = abs(float(np.cos(normal_angle_rad))), abs(float(np.sin(normal_angle_rad)))
    return np.asarray(_profile(distances, sigma_px, a, b, True))


class EdgeJacobian(NamedTuple):
    """Model level, unit edge and derivatives by the parameters at each pixel."""

    levels: FloatArray
    edges: FloatArray
    jacobian: FloatArray


@compiled_part()
def edge_jacobian(pixels: BandPixels, parameters: FloatArray, is_square: bool) -> EdgeJacobian:
    """Evaluate the model and its derivatives, shape ``(n, parameters)``, at each pixel."""
    x, y, half_length = pixels.x, pixels.y, pixels.half_length_px
    count = parameters.size
    levels, edges = np.empty(x.size), np.empty(x.size)
    jacobian = np.zeros((x.size, count))
    angle = pixels.normal_rad + parameters[TURN] / half_length
    cosine, sine = np.cos(angle), np.sin(angle)
    a, b = abs(cosine), abs(sine)
    sigma = np.exp(parameters[LOG_SIGMA])
    bend = parameters[CURVATURE]
    per_length = 1.0 / half_length
    for i in range(x.size):
        along = (-sine * x[i] + cosine * y[i]) * per_length
        across = cosine * x[i] + sine * y[i]
        d = across - parameters[OFFSET] - bend * along * along
        edge, slope, by_log_sigma = _unit_edge(d, sigma, a, b, is_square)
        low, high = parameters[LOW], parameters[HIGH]
        if count == SHADED_PARAMETERS:
            low += parameters[6] * along
            high += parameters[7] * along
            jacobian[i, 6] = along * (1.0 - edge)
            jacobian[i, 7] = along * edge
        across_step = (high - low) * slope
        levels[i] = low + (high - low) * edge
        edges[i] = edge
        jacobian[i, TURN] = across_step * (along + 2.0 * bend * along * across * per_length**2)
        jacobian[i, OFFSET] = -across_step
        jacobian[i, CURVATURE] = -across_step * along * along
        jacobian[i, LOG_SIGMA] = (high - low) * by_log_sigma
        jacobian[i, LOW] = 1.0 - edge
        jacobian[i, HIGH] = edge
    return EdgeJacobian(levels, edges, jacobian)


class EdgeShape(NamedTuple):
    """A Gaussian edge: behind a unit square whose normal's direction is given, or sampled."""

    sigma_px: float
    cosine: float
    sine: float
    is_square: bool


def edge_shape(sigma_px: float, optical_sigma_px: float | None, normal_rad: float) -> EdgeShape:
    """Return the edge behind the pixel where its optical width is known, else as sampled."""
    if optical_sigma_px is None:
        return EdgeShape(sigma_px, 0.0, 0.0, False)
    return EdgeShape(optical_sigma_px, abs(cos(normal_rad)), abs(sin(normal_rad)), True)


@compiled_part()
def shape_value(shape: EdgeShape, distance_px: float) -> float:
    """Unit edge at a signed distance."""
    return _unit_edge(distance_px, shape.sigma_px, shape.cosine, shape.sine, shape.is_square)[0]


@compiled_part()
def shape_slopes(shape: EdgeShape, distance_px: float) -> tuple[float, float, float]:
    """Unit edge at a signed distance, its slope per px and its derivative by log sigma."""
    return _unit_edge(distance_px, shape.sigma_px, shape.cosine, shape.sine, shape.is_square)


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
        edge, slope, by_log_sigma = _unit_edge(d, sigma, a, b, is_square)
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
    """Weighted products of the derivatives and of the residuals, summed in parallel lanes."""
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
    """Minimum of the weighted squares; valid only if ``is_found``; ``hessian`` is J'WJ there."""

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
    """Solve for a step by Cholesky, the diagonal damped in proportion; NaN where not positive."""
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
