"""A straight or slightly curved edge as the sensor sees it, fitted to raw pixels.

Two edge shapes share one parametrisation, with ``d`` the signed distance of a pixel centre
from the edge and ``E(d)`` rising from 0 to 1:

- *plain*: ``E = Phi(d / sigma)``, an edge sampled at points; sigma is the **total** width.
- *pixel square*: the same edge averaged over the unit pixel, whose projection on the edge
  normal is a trapezium with ``a = |cos|`` and ``b = |sin|`` of the normal's angle; sigma is
  the **optical** width. With ``G2(x) = ((x^2 + s^2) Phi(x/s) + x s phi(x/s)) / 2``,
  ``E = [G2(d+(a+b)/2) - G2(d+(a-b)/2) - G2(d-(a-b)/2) + G2(d-(a+b)/2)] / (a b)``.

Shading is a slope of either level *along* the edge. A slope across it would be confounded
with the tails of the PSF: on a real photograph it moves sigma by 2 % either way with the
width of the band, where the model without it stays within 0.3 %.

The loops are compiled: one pass over the pixels evaluates the model, its derivatives and the
normal equations together. ``benchmarks/bench_edge_fit.py`` says what that earns.
"""

from math import erfc, exp, pi, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = [
    "CURVATURE",
    "FLAT_PARAMETERS",
    "HIGH",
    "LOG_SIGMA",
    "LOW",
    "OFFSET",
    "SHADED_PARAMETERS",
    "TURN",
    "edge_profile",
    "edge_values",
    "levenberg_marquardt",
]

Array = NDArray[np.float64]

# Places in the parameter vector. Lengths are in units of the half length h of the edge, so
# that all columns of the Jacobian have the same scale.
TURN, OFFSET, CURVATURE, LOG_SIGMA, LOW, HIGH = range(6)
FLAT_PARAMETERS = 6
SHADED_PARAMETERS = 8  # the slopes of the low and the high level along the edge follow

_SQRT_HALF = sqrt(0.5)
_INV_SQRT_2PI = 1.0 / sqrt(2.0 * pi)
_TAIL = 8.0  # standard deviations beyond which Phi is 0 or 1 to 1e-15
_NARROWEST = 2e-3  # side of the trapezium below which its one-dimensional form is exact to 2e-7
_LOG_SIGMA_MIN = -3.5  # 0.03 px: narrower than anything a pixel can tell apart
_LOG_SIGMA_MAX = 4.0


@njit(cache=True)
def _phi_cumulative(x: float) -> float:
    return 0.5 * erfc(-x * _SQRT_HALF)


@njit(cache=True)
def _edge(d: float, s: float, a: float, b: float, is_square: bool) -> tuple[float, float, float]:
    """Value, derivative by ``d`` and derivative by ``log s`` of the unit edge."""
    reach = _TAIL * s + (0.5 * (a + b) if is_square else 0.0)
    if d > reach:
        return 1.0, 0.0, 0.0
    if d < -reach:
        return 0.0, 0.0, 0.0
    if not is_square:
        x = d / s
        density = _INV_SQRT_2PI * exp(-0.5 * x * x)
        return _phi_cumulative(x), density / s, -density * x
    wide, narrow = (a, b) if a > b else (b, a)
    if narrow < _NARROWEST:
        value = slope = by_s = 0.0
        for sign in (1.0, -1.0):
            u = d + sign * 0.5 * wide
            x = u / s
            cumulative = _phi_cumulative(x)
            density = _INV_SQRT_2PI * exp(-0.5 * x * x)
            value += sign * (u * cumulative + s * density)
            slope += sign * cumulative
            by_s += sign * density
        return value / wide, slope / wide, s * by_s / wide
    value = slope = by_s = 0.0
    for k in range(4):
        sign = 1.0 if k in (0, 3) else -1.0
        shift = 0.5 * (wide + narrow) if k in (0, 3) else 0.5 * (wide - narrow)
        u = d + (shift if k < 2 else -shift)
        x = u / s
        cumulative = _phi_cumulative(x)
        density = _INV_SQRT_2PI * exp(-0.5 * x * x)
        value += sign * 0.5 * ((u * u + s * s) * cumulative + u * s * density)
        slope += sign * (u * cumulative + s * density)
        by_s += sign * cumulative
    area = wide * narrow
    return value / area, slope / area, s * s * by_s / area


@njit(cache=True)
def _distance(
    x: float, y: float, parameters: Array, angle: float, half_length: float
) -> tuple[float, float, float]:
    """Signed distance, its derivative by TURN, and the place along the edge (both over h)."""
    c = np.cos(angle)
    s = np.sin(angle)
    along = (-s * x + c * y) / half_length
    across = c * x + s * y
    bend = parameters[CURVATURE]
    d = across - parameters[OFFSET] - bend * along * along
    by_turn = along + 2.0 * bend * along * across / half_length**2
    return d, by_turn, along


@njit(cache=True)
def _normal_equations(
    x: Array,
    y: Array,
    values: Array,
    weights: Array,
    parameters: Array,
    normal_angle: float,
    half_length: float,
    is_square: bool,
    hessian: Array,
    gradient: Array,
) -> float:
    """Fill ``hessian`` = J'WJ and ``gradient`` = J'Wr; return the weighted sum of squares."""
    count = parameters.size
    hessian[:] = 0.0
    gradient[:] = 0.0
    row = np.zeros(count)
    angle = normal_angle + parameters[TURN] / half_length
    a = abs(np.cos(angle))
    b = abs(np.sin(angle))
    sigma = np.exp(parameters[LOG_SIGMA])
    total = 0.0
    for i in range(x.size):
        w = weights[i]
        if w == 0.0:
            continue
        d, by_turn, along = _distance(x[i], y[i], parameters, angle, half_length)
        edge, slope, by_log_sigma = _edge(d, sigma, a, b, is_square)
        low = parameters[LOW]
        step = parameters[HIGH] - low
        if count == SHADED_PARAMETERS:
            low += parameters[6] * along
            step += (parameters[7] - parameters[6]) * along
            row[6] = along * (1.0 - edge)
            row[7] = along * edge
        row[TURN] = step * slope * by_turn
        row[OFFSET] = -step * slope
        row[CURVATURE] = -step * slope * along * along
        row[LOG_SIGMA] = step * by_log_sigma
        row[LOW] = 1.0 - edge
        row[HIGH] = edge
        residual = values[i] - low - step * edge
        total += w * residual * residual
        for j in range(count):
            wj = w * row[j]
            if wj != 0.0:
                gradient[j] += wj * residual
                for k in range(j + 1):
                    hessian[j, k] += wj * row[k]
    for j in range(count):
        for k in range(j):
            hessian[k, j] = hessian[j, k]
    return total


@njit(cache=True)
def levenberg_marquardt(
    x: Array,
    y: Array,
    values: Array,
    weights: Array,
    start: Array,
    normal_angle: float,
    half_length: float,
    is_square: bool,
    max_steps: int,
) -> tuple[Array, Array, float, int]:
    """Minimise the weighted squares from ``start``.

    Coordinates are in px relative to the middle of the edge; ``normal_angle`` is that of the
    normal from the low to the high side, in radians.

    Returns
    -------
    parameters, hessian, sum of squares, steps
        ``hessian`` is J'WJ at the minimum: its inverse is the covariance of the parameters
        where the weights are inverse variances. ``steps`` is -1 where none was found.
    """
    count = start.size
    best = start.copy()
    hessian = np.zeros((count, count))
    gradient = np.zeros(count)
    trial_hessian = np.zeros((count, count))
    trial_gradient = np.zeros(count)
    squares = _normal_equations(
        x, y, values, weights, best, normal_angle, half_length, is_square, hessian, gradient
    )
    damping = 1e-4
    for step in range(max_steps):
        moved = False
        for _ in range(12):
            damped = hessian.copy()
            for j in range(count):
                damped[j, j] = damped[j, j] * (1.0 + damping) + 1e-300
            change = np.linalg.solve(damped, gradient)
            trial = best + change
            trial[LOG_SIGMA] = min(max(trial[LOG_SIGMA], _LOG_SIGMA_MIN), _LOG_SIGMA_MAX)
            trial_squares = _normal_equations(
                x,
                y,
                values,
                weights,
                trial,
                normal_angle,
                half_length,
                is_square,
                trial_hessian,
                trial_gradient,
            )
            if trial_squares <= squares:
                moved = True
                break
            damping *= 10.0
        if not moved:
            return best, hessian, squares, step
        gain = squares - trial_squares
        geometry = max(
            abs(change[TURN]), abs(change[OFFSET]), abs(change[CURVATURE]), abs(change[LOG_SIGMA])
        )
        best = trial
        squares = trial_squares
        hessian[:] = trial_hessian
        gradient[:] = trial_gradient
        damping *= 0.1
        if geometry < 1e-7 or gain <= 1e-9 * squares:
            return best, hessian, squares, step + 1
    return best, hessian, squares, -1


@njit(cache=True)
def edge_values(
    x: Array,
    y: Array,
    parameters: Array,
    normal_angle: float,
    half_length: float,
    is_square: bool,
) -> tuple[Array, Array, Array]:
    """Model level, signed distance in px and unit edge at each pixel."""
    levels = np.empty(x.size)
    distances = np.empty(x.size)
    edges = np.empty(x.size)
    angle = normal_angle + parameters[TURN] / half_length
    a = abs(np.cos(angle))
    b = abs(np.sin(angle))
    sigma = np.exp(parameters[LOG_SIGMA])
    for i in range(x.size):
        d, _, along = _distance(x[i], y[i], parameters, angle, half_length)
        edge, _, _ = _edge(d, sigma, a, b, is_square)
        low = parameters[LOW]
        step = parameters[HIGH] - low
        if parameters.size == SHADED_PARAMETERS:
            low += parameters[6] * along
            step += (parameters[7] - parameters[6]) * along
        levels[i] = low + step * edge
        distances[i] = d
        edges[i] = edge
    return levels, distances, edges


@njit(cache=True)
def _profile(d: Array, sigma: float, a: float, b: float, is_square: bool) -> Array:
    out = np.empty(d.size)
    for i in range(d.size):
        out[i] = _edge(d[i], sigma, a, b, is_square)[0]
    return out


def edge_profile(
    distances_px: Array, sigma_px: float, normal_angle_rad: float | None = None
) -> Array:
    """Unit edge (0 to 1) at signed distances from it.

    Parameters
    ----------
    distances_px
        Shape ``(n,)``.
    sigma_px
        Total width where no angle is given, optical width with one.
    normal_angle_rad
        Angle of the edge normal to the pixel rows: the pixel square is integrated exactly.
    """
    distances = np.ascontiguousarray(distances_px, dtype=np.float64)
    if normal_angle_rad is None:
        return np.asarray(_profile(distances, sigma_px, 1.0, 0.0, False))
    a, b = abs(float(np.cos(normal_angle_rad))), abs(float(np.sin(normal_angle_rad)))
    return np.asarray(_profile(distances, sigma_px, a, b, True))
