"""Radial distortion of a lens, its inverse, and a homography seen through it; compiled.

An ideal point at the radius ``r`` from the lens's centre is seen at ``r (1 + k1 r^2 + k2 r^4)``;
negative is barrel. Barrel distortion folds: beyond some radius, seen radii decrease again, and the
lens shows nothing from there. The formula is followed beyond the fold as long as its result is
outside the frame; points that it would bring back into the frame are put far outside.

The warp between two images of one lens goes from a seen point of the follow-up to its ideal one, by
the homography to the ideal point in the reference, and on to where that is seen; its derivative is
the product of the three. ``lens`` is ``k1`` in 1/px^2 and the centres of the distortion: x and y in
the follow-up, x and y in the reference.
"""

from math import hypot, inf, isinf, sqrt

import numpy as np

from simulation.arrays import FloatArray
from simulation.compiled import compiled, compiled_part
from simulation.pose.homography import project, projection_slopes

DISTORTION_MAX = 0.12
"""Largest relative distortion at the frame's corner. Barrel distortion of strength s shows nothing
beyond the radius ``2 / sqrt(27 s)``: from 4/27 on that is inside the corner."""

_FOLD_MARGIN = 0.9
_FAR = 1e9

_SERIES_MAX = 0.05
"""Distortion up to which the inverse's series is within 1e-4: two of Newton's steps make it exact
to the last bits. The series is Lagrange's, 1 - k + 3 k^2 - 12 k^3 + 55 k^4 - ..."""

_ITERATIONS = 100
_CONVERGED = 1e-8
"""Relative step: the remaining error of Newton's method is of the order of its square."""


def lens_of(
    distortion_k1: float,
    reference: tuple[int, int],
    follow_up: tuple[int, int],
    origin_px: tuple[float, float] | None = None,
) -> FloatArray:
    """Return the ``lens`` of one camera that took both frames.

    Parameters
    ----------
    distortion_k1
        Relative distortion at the corner of the reference's frame; negative is barrel.
    reference, follow_up
        ``(rows, cols)``.
    origin_px
        Position ``(x, y)`` of the follow-up's pixel (0, 0) in the camera's frame; by default, the
        follow-up is centred in the frame.
    """
    x, y = (reference[1] - 1) / 2, (reference[0] - 1) / 2
    followup_x, followup_y = (follow_up[1] - 1) / 2, (follow_up[0] - 1) / 2
    if origin_px is not None:
        followup_x, followup_y = x - origin_px[0], y - origin_px[1]
    return np.array([distortion_k1 / max(hypot(x, y), 0.5) ** 2, followup_x, followup_y, x, y])


def refuse_folding(distortion_k1: float, lens: FloatArray, follow_up: tuple[int, int]) -> None:
    """Raise if a lens does not show all of a follow-up of ``(rows, cols)``.

    Raises
    ------
    ValueError
        If the distortion is not finite, or so large that the frame folds, or if the follow-up is
        so much larger than the reference that it folds.
    """
    if not abs(distortion_k1) <= DISTORTION_MAX:
        raise ValueError(
            f"the distortion k1 must be between -{DISTORTION_MAX} and {DISTORTION_MAX}, "
            f"got {distortion_k1}"
        )
    k1, centre_x, centre_y = lens[:3].tolist()
    farthest_px = hypot(
        max(centre_x, follow_up[1] - 1 - centre_x) + 0.5,
        max(centre_y, follow_up[0] - 1 - centre_y) + 0.5,
    )
    if -27 * k1 * farthest_px**2 / 4 > _FOLD_MARGIN:
        raise ValueError(
            f"a lens with the distortion k1 {distortion_k1} cannot show the corners of a "
            f"follow-up of {follow_up[1]} x {follow_up[0]} px"
        )


@compiled_part()
def _fold_square(k1: float, k2: float) -> float:
    """Square of the ideal radius at which seen radii stop increasing; infinite if they do not."""
    # The first positive zero of the derivative 1 + 3 k1 q + 5 k2 q^2, without taking a difference.
    discriminant = 9 * k1 * k1 - 20 * k2
    if discriminant < 0 or (k1 >= 0 and k2 >= 0):
        return inf
    if k1 > 0:
        return -(3 * k1 + sqrt(discriminant)) / (10 * k2)
    return 2 / (sqrt(discriminant) - 3 * k1)


@compiled_part()
def _ideal_factor(k1: float, k2: float) -> float:
    """Ideal radius for the seen radius 1: bracketed Newton's method, up to the fold.

    A seen radius without an ideal one gets that of the fold.
    """
    if k2 == 0 and abs(k1) < _SERIES_MAX:
        factor = 1 - k1 * (1 - k1 * (3 - k1 * (12 - 55 * k1)))
        for _ in range(2):
            square = factor * factor
            factor -= (factor * (1 + k1 * square) - 1) / (1 + 3 * k1 * square)
        return factor
    low, high = 0.0, sqrt(_fold_square(k1, k2))
    if isinf(high):
        high = 1.0
        while high * (1 + high * high * (k1 + high * high * k2)) < 1:
            high *= 2
    elif high * (1 + high * high * (k1 + high * high * k2)) < 1:
        return high
    factor = min(1.0, high)
    for _ in range(_ITERATIONS):
        square = factor * factor
        excess = factor * (1 + square * (k1 + square * k2)) - 1
        if excess > 0:
            high = factor
        else:
            low = factor
        better = factor - excess / (1 + square * (3 * k1 + 5 * square * k2))
        if not low <= better <= high:
            better = (low + high) / 2
        elif abs(better - factor) <= _CONVERGED * factor:
            return better
        factor = better
    return factor


@compiled_part()
def _seen_factor(k1: float, k2: float, square: float, frame: float) -> float:
    """Factor from an ideal point, its radius squared, to the seen one; infinite if far outside."""
    factor = 1 + square * (k1 + square * k2)
    # With k2 above 0 seen radii may increase again further out.
    is_folded = 1 + square * (3 * k1 + 5 * square * k2) <= 0 or (
        k2 > 0 and square > _fold_square(k1, k2)
    )
    return inf if is_folded and factor * sqrt(square) < frame else factor


@compiled()
def ideal_factors(k1: float, k2: float, squares: FloatArray) -> FloatArray:
    """Factors from seen points to ideal ones.

    Parameters
    ----------
    k1, k2
        Distortion at the radius 1.
    squares
        Squared radii of the seen points, shape (n,). A point beyond all that the lens shows is
        taken to the fold.
    """
    factors = np.empty_like(squares)
    for i in range(len(squares)):
        factors[i] = _ideal_factor(k1 * squares[i], k2 * squares[i] * squares[i])
    return factors


@compiled()
def seen_factors(k1: float, k2: float, squares: FloatArray, frame: float) -> FloatArray:
    """Factors from ideal points to seen ones.

    Parameters
    ----------
    k1, k2
        Distortion at the radius 1.
    squares
        Squared radii of the ideal points, shape (n,).
    frame
        Radius of a circle about the lens's centre that contains the frame.
    """
    factors = np.empty_like(squares)
    for i in range(len(squares)):
        factor = _seen_factor(k1, k2, squares[i], frame)
        factors[i] = _FAR / sqrt(squares[i]) if isinf(factor) else factor
    return factors


@compiled()
def ideal_points(lens: FloatArray, points_px: FloatArray) -> FloatArray:
    """Ideal points of seen points of the follow-up; both of shape (n, 2), order (x, y)."""
    ideal = np.empty_like(points_px)
    for i in range(len(points_px)):
        dx, dy = points_px[i, 0] - lens[1], points_px[i, 1] - lens[2]
        factor = _ideal_factor(lens[0] * (dx * dx + dy * dy), 0.0)
        ideal[i, 0], ideal[i, 1] = lens[1] + factor * dx, lens[2] + factor * dy
    return ideal


@compiled_part()
def _distortion_slopes(k1: float, x: float, y: float) -> tuple[float, float, float]:
    """Derivative xx, xy, yy of the seen point by the ideal one, both about the centre."""
    factor = 1 + k1 * (x * x + y * y)
    return factor + 2 * k1 * x * x, 2 * k1 * x * y, factor + 2 * k1 * y * y


@compiled_part()
def warp(
    matrix: FloatArray, lens: FloatArray, col: float, row: float
) -> tuple[float, float, float, float, float, float]:
    """Reference coordinates (x, y) of a follow-up point, and the derivative (a, b; c, d) there."""
    k1 = lens[0]
    if k1 == 0:
        x, y = project(matrix, col, row)
        a, b, c, d = projection_slopes(matrix, col, row)
        return x, y, a, b, c, d
    dx, dy = col - lens[1], row - lens[2]
    factor = _ideal_factor(k1 * (dx * dx + dy * dy), 0.0)
    dx, dy = factor * dx, factor * dy
    xx, xy, yy = _distortion_slopes(k1, dx, dy)
    determinant = xx * yy - xy * xy
    p, q, r = yy / determinant, -xy / determinant, xx / determinant
    x, y = project(matrix, lens[1] + dx, lens[2] + dy)
    a, b, c, d = projection_slopes(matrix, lens[1] + dx, lens[2] + dy)
    a, b, c, d = a * p + b * q, a * q + b * r, c * p + d * q, c * q + d * r
    dx, dy = x - lens[3], y - lens[4]
    square = dx * dx + dy * dy
    # The outermost pixels' squares end half a pixel beyond their centres.
    factor = _seen_factor(k1, 0.0, square, hypot(lens[3] + 1, lens[4] + 1))
    if isinf(factor):
        away = _FAR / sqrt(square)
        return lens[3] + away * dx, lens[4] + away * dy, 1.0, 0.0, 0.0, 1.0
    p, q, r = _distortion_slopes(k1, dx, dy)
    return (
        lens[3] + factor * dx,
        lens[4] + factor * dy,
        p * a + q * c,
        p * b + q * d,
        q * a + r * c,
        q * b + r * d,
    )


@compiled()
def warped(matrix: FloatArray, lens: FloatArray, points_px: FloatArray) -> FloatArray:
    """Reference points of follow-up points; both of shape (n, 2), order (x, y)."""
    found = np.empty_like(points_px)
    k1, frame = lens[0], hypot(lens[3] + 1, lens[4] + 1)
    for i in range(len(points_px)):
        if k1 == 0:
            found[i, 0], found[i, 1] = project(matrix, points_px[i, 0], points_px[i, 1])
            continue
        # As in warp, without the derivative.
        dx, dy = points_px[i, 0] - lens[1], points_px[i, 1] - lens[2]
        factor = _ideal_factor(k1 * (dx * dx + dy * dy), 0.0)
        x, y = project(matrix, lens[1] + factor * dx, lens[2] + factor * dy)
        dx, dy = x - lens[3], y - lens[4]
        square = dx * dx + dy * dy
        factor = _seen_factor(k1, 0.0, square, frame)
        if isinf(factor):
            factor = _FAR / sqrt(square)
        found[i, 0], found[i, 1] = lens[3] + factor * dx, lens[4] + factor * dy
    return found
