"""Sampling a quintic spline along a warp, with a different Gaussian blur at every position.

The compiled kernel behind ``simulation.pose.simulate``. The warp is a homography between ideal
images of a lens with radial distortion. Per output pixel the kernel takes the missing blur
``B = A Sigma A^T - Sigma`` (A the derivative of the warp), subtracts the part that the
spline's coefficients already hold, and sums the coefficients with the weights of the quintic
B-spline after a Gaussian blur. A correlated rest is the mean of several such sums along a line.
Measured by ``benchmarks/bench_pose.py``.
"""

from math import ceil, exp, floor, log1p, pi, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from simulation.arrays import BoolArray, FloatArray, FloatImage
from simulation.pose.lens import warp
from simulation.resampling import LEVELS_PER_LOG, PHASES, SplineGaussianTable

BORDER_PX = 0.5 + 1e-6
"""How far outside the outermost pixel centres a position still counts as inside."""

NEARER_TOLERANCE_PX2 = 1e-3
"""A smaller surplus of variance changes the contrast at Nyquist by less than 0.5 %."""

_UNCORRELATED_PX2 = 1e-4
"""Smaller covariances of the rest are neglected: 0.1 % of contrast at Nyquist in both axes."""

_THREE_POINTS_PX, _FIVE_POINTS_PX = 0.22, 0.45
"""The remainder theta^2n n! / (2n)! of n points is below 1e-3 at theta = pi times these."""

_ALIAS_RAD = 3.7
"""exp(-3.7^2 / 2) = 1e-3: how far the first alias of the points stays from Nyquist."""

_LINE_SIGMAS = 3.5

_POINTS_MAX = 128
"""Enough for a line of 46 px standard deviation, sqrt(2) times the widest blur of the table."""


class BlurredWarp(NamedTuple):
    """Positions of a follow-up's pixels in the reference, and the PSF of either image.

    Parameters
    ----------
    matrix
        Homography from ideal follow-up to ideal reference pixels.
    lens
        As in ``simulation.pose.lens``.
    psf
        Polynomial coefficients of the covariance, shape ``(3, n)``.
    frame
        The polynomials' centre x, y and 1 / radius, and the position x, y of the follow-up's pixel
        (0, 0) in their frame.
    """

    matrix: FloatArray
    lens: FloatArray
    psf: FloatArray
    frame: FloatArray


class SplineWindow(NamedTuple):
    """A part of the reference as spline coefficients, including those beyond its border.

    Parameters
    ----------
    coefficients
        Element (0, 0) belongs to the reference pixel ``origin`` (row, col).
    held_px2
        Blur (xx, xy, yy) that they already hold.
    size
        Rows and columns of the whole reference.
    """

    coefficients: FloatImage
    origin: tuple[int, int]
    held_px2: tuple[float, float, float]
    size: tuple[int, int]


class Tile(NamedTuple):
    """A part of the follow-up; where it looks past the reference, 0 and not nearer."""

    image: FloatImage
    nearer: BoolArray
    outside: BoolArray


# Sums may be reordered, which vectorises them; NaN and infinity keep their meaning.
_FAST = {"reassoc", "contract", "nsz"}
_compiled = njit(cache=True, fastmath=_FAST, error_model="numpy")
# By itself, the compiler inlines or not after any change nearby: up to 20 % of the time.
_inlined = njit(cache=True, fastmath=_FAST, error_model="numpy", forceinline=True)


@_compiled
def _covariance(
    psf: FloatArray, frame: FloatArray, x_px: float, y_px: float
) -> tuple[float, float, float]:
    """Elements xx, xy, yy of a field; ``frame`` begins with its centre x, y and 1 / radius."""
    count = psf.shape[1]
    if count == 1:
        return psf[0, 0], psf[1, 0], psf[2, 0]
    u, v = (x_px - frame[0]) * frame[2], (y_px - frame[1]) * frame[2]
    xx = xy = yy = 0.0
    total = power = 0
    for k in range(count):
        monomial = u ** (total - power) * v**power
        xx += psf[0, k] * monomial
        xy += psf[1, k] * monomial
        yy += psf[2, k] * monomial
        power += 1
        if power > total:
            total, power = total + 1, 0
    return xx, xy, yy


@_compiled
def _missing_blur(
    matrix: FloatArray,
    lens: FloatArray,
    psf: FloatArray,
    frame: FloatArray,
    col: float,
    row: float,
) -> tuple[float, float, float, float, float]:
    """Reference position (x, y) of a follow-up pixel, and the blur (xx, xy, yy) missing there."""
    x, y, a, b, c, d = warp(matrix, lens, col, row)
    xx, xy, yy = _covariance(psf, frame, col + frame[3], row + frame[4])
    own_xx, own_xy, own_yy = _covariance(psf, frame, x, y)
    return (
        x,
        y,
        a * a * xx + 2 * a * b * xy + b * b * yy - own_xx,
        a * c * xx + (a * d + b * c) * xy + b * d * yy - own_xy,
        c * c * xx + 2 * c * d * xy + d * d * yy - own_yy,
    )


@_compiled
def _positive_part(xx: float, xy: float, yy: float) -> tuple[float, float, float, float]:
    """Set negative eigenvalues to 0; the original least eigenvalue is returned as well."""
    mean, half = (xx + yy) / 2, (xx - yy) / 2
    radius = sqrt(half * half + xy * xy)
    least, largest = mean - radius, mean + radius
    if least >= 0:
        return xx, xy, yy, least
    if largest <= 0:
        return 0.0, 0.0, 0.0, least
    # largest e e^T, from the matrix less the part of the other eigenvector.
    share = largest / (2 * radius)
    return share * (radius + half), share * xy, share * (radius - half), least


@_compiled
def survey(view: BlurredWarp, rows: FloatArray, cols: FloatArray) -> FloatArray:
    """(x, y, xx, xy, yy) of the missing blur at ``[i, j]`` of a lattice; it may be indefinite."""
    matrix, lens, psf, frame = view
    seen = np.empty((len(rows), len(cols), 5))
    for i in range(len(rows)):
        for j in range(len(cols)):
            x, y, xx, xy, yy = _missing_blur(matrix, lens, psf, frame, cols[j], rows[i])
            seen[i, j, 0], seen[i, j, 1] = x, y
            seen[i, j, 2], seen[i, j, 3], seen[i, j, 4] = xx, xy, yy
    return seen


@_inlined
def _level(variance_px2: float, table: FloatImage) -> tuple[int, float]:
    """Level of the table below a variance, and the weight of the next one."""
    level = min(int(log1p(sqrt(variance_px2)) * LEVELS_PER_LOG), table.shape[0] - 2)
    low, high = exp(level / LEVELS_PER_LOG) - 1, exp((level + 1) / LEVELS_PER_LOG) - 1
    return level, min((variance_px2 - low * low) / (high * high - low * low), 1.0)


@_inlined
def _weights(
    position_px: float, blur: tuple[int, float], table: FloatImage, radius: int, out: FloatImage
) -> int:
    """Fill ``out`` with the weights of ``2 radius`` coefficients; return the first one's index.

    ``blur`` is a level of the table, and the weight of the next one.
    """
    level, upper = blur
    whole = floor(position_px)
    phase = (position_px - whole) * PHASES
    step = min(int(phase), PHASES - 1)
    behind = phase - step
    w00, w01 = (1 - upper) * (1 - behind), (1 - upper) * behind
    w10, w11 = upper * (1 - behind), upper * behind
    first = table.shape[2] // 2 - radius
    last = first + 2 * radius
    t00, t01 = table[level, step, first:last], table[level, step + 1, first:last]
    t10, t11 = table[level + 1, step, first:last], table[level + 1, step + 1, first:last]
    for m in range(2 * radius):
        out[m] = w00 * t00[m] + w01 * t01[m] + w10 * t10[m] + w11 * t11[m]
    return int(whole) - radius + 1


@_inlined
def _sum(
    coefficients: FloatImage,
    first: tuple[int, int],
    radii: tuple[int, int],
    along_y: FloatImage,
    along_x: FloatImage,
) -> float:
    """Sum of the coefficients from ``first`` (row, col) on, ``2 radii`` of them, with weights."""
    top, left = first
    high, wide = 2 * radii[0], 2 * radii[1]
    total = 0.0
    for i in range(high):
        row = coefficients[top + i, left : left + wide]
        part = along_y[0] * 0
        for j in range(0, wide, 4):
            part += (along_x[j] * row[j] + along_x[j + 1] * row[j + 1]) + (
                along_x[j + 2] * row[j + 2] + along_x[j + 3] * row[j + 3]
            )
        total += along_y[i] * part
    return total


@_compiled
def render(
    view: BlurredWarp,
    window: SplineWindow,
    table: SplineGaussianTable,
    first: tuple[int, int],
    shape: tuple[int, int],
) -> Tile:
    """Tile of the follow-up whose first pixel is ``first``, both as (row, col).

    A missing variance below ``-NEARER_TOLERANCE_PX2`` marks it ``nearer``.
    """
    # Unpacked here, as every access to an array in a tuple costs a reference count.
    matrix, lens, psf, frame = view
    coefficients, origin, held, size = window
    weights, radii = table
    dtype = coefficients.dtype
    image = np.zeros(shape, dtype)
    nearer, outside = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
    along_y, along_x = np.empty(weights.shape[2], dtype), np.empty(weights.shape[2], dtype)
    points, shares = np.empty(_POINTS_MAX), np.empty(_POINTS_MAX)
    for i in range(shape[0]):
        for j in range(shape[1]):
            x, y, xx, xy, yy = _missing_blur(matrix, lens, psf, frame, first[1] + j, first[0] + i)
            is_inside = (
                -BORDER_PX <= x <= size[1] - 1 + BORDER_PX
                and -BORDER_PX <= y <= size[0] - 1 + BORDER_PX
            )
            outside[i, j] = not is_inside
            if not is_inside:
                continue
            xx, xy, yy, least = _positive_part(xx, xy, yy)
            nearer[i, j] = least < -NEARER_TOLERANCE_PX2
            xx, xy, yy, _ = _positive_part(xx - held[0], xy - held[1], yy - held[2])
            x -= origin[1]
            y -= origin[0]
            count = 0
            sx = sy = 0.0
            if abs(xy) >= _UNCORRELATED_PX2:
                # diag(xx, yy) + s s^T, with the shortest s that leaves xx and yy positive.
                sx2 = min(max(abs(xy), xy * xy / yy), xx)
                sx = sqrt(sx2)
                sy = xy / sx
                count = _points(sqrt(sx2 + sy * sy), points, shares)
                xx, yy = max(xx - sx2, 0.0), max(yy - sy * sy, 0.0)
            blur_y, blur_x = _level(yy, weights), _level(xx, weights)
            high, wide = radii[blur_y[0] + 1], radii[blur_x[0] + 1]
            if count == 0:
                top = _weights(y, blur_y, weights, high, along_y)
                left = _weights(x, blur_x, weights, wide, along_x)
                image[i, j] = _sum(coefficients, (top, left), (high, wide), along_y, along_x)
                continue
            value = 0.0
            for k in range(-count, count + 1):
                shift = points[k] if k >= 0 else -points[-k]
                top = _weights(y + shift * sy, blur_y, weights, high, along_y)
                left = _weights(x + shift * sx, blur_x, weights, wide, along_x)
                part = _sum(coefficients, (top, left), (high, wide), along_y, along_x)
                value += shares[abs(k)] * part
            image[i, j] = value
    return Tile(image, nearer, outside)


@_compiled
def _points(length_px: float, nodes: FloatArray, shares: FloatArray) -> int:
    """Fill in the points 0 to n of a symmetric rule for a normal variable; return n.

    Gauss-Hermite of 3 or 5 points while that is exact to 1e-3 up to Nyquist for a line of this
    standard deviation, then the trapezoidal rule, its variance made 1.
    """
    nodes[0] = 0.0
    if length_px < _THREE_POINTS_PX:
        nodes[1] = sqrt(3.0)
        shares[0], shares[1] = 2 / 3, 1 / 6
        return 1
    if length_px < _FIVE_POINTS_PX:
        root = sqrt(10.0)
        nodes[1], nodes[2] = sqrt(5 - root), sqrt(5 + root)
        shares[0], shares[1], shares[2] = 8 / 15, (7 + 2 * root) / 60, (7 - 2 * root) / 60
        return 2
    step = 2 * pi / (pi * length_px + _ALIAS_RAD)
    count = min(ceil(_LINE_SIGMAS / step), len(nodes) - 1)
    norm, second = 1.0, 0.0
    shares[0] = 1.0
    for k in range(1, count + 1):
        nodes[k] = k * step
        shares[k] = exp(-(nodes[k] ** 2) / 2)
        norm += 2 * shares[k]
        second += 2 * shares[k] * nodes[k] ** 2
    for k in range(count + 1):
        nodes[k] /= sqrt(second / norm)
        shares[k] /= norm
    return count
