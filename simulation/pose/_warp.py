"""A homography seen through a distorting lens, and the blur that a reference lacks; compiled.

An ideal point at the radius ``r`` from the lens's centre is seen at ``r (1 + k1 r^2 + k2 r^4)``;
negative is barrel. Barrel distortion folds: beyond some radius, seen radii decrease again, and the
lens shows nothing from there. The formula is followed beyond the fold as long as its result is
outside the frame; points that it would bring back into the frame are put far outside.

The warp between two images of one lens goes from a seen point of the follow-up to its ideal one, by
the homography to the ideal point in the reference, and on to where that is seen; its derivative is
the product of the three. ``lens`` is ``k1`` in 1/px^2 and the centres of the distortion: x and y in
the follow-up, x and y in the reference. ``matrix`` has the shape (3, 3) and takes ``(x, y, 1)`` to
the image's coordinates times their depth.

With covariance Sigma of the PSF in either image and A the derivative of the warp, the reference
lacks the blur ``A Sigma_far A^T - Sigma_near``; where that has a negative eigenvalue the follow-up
is the sharper one in that direction.
"""

from math import hypot, inf, isinf, sqrt
from typing import NamedTuple, TypeVar

import numpy as np

from simulation.arrays import FloatArray
from simulation.compiled import compiled, compiled_part

_FLAT = 1e-12
"""Least singular value over the largest: what inverting leaves of double precision."""

_SMALLEST, _LARGEST = 1e-8, 1e8
"""Of the area that a follow-up pixel covers of the reference, in px2."""

_Coordinate = TypeVar("_Coordinate", float, FloatArray)


@compiled_part()
def projection_depth(matrix: FloatArray, x: _Coordinate, y: _Coordinate) -> _Coordinate:
    """Denominator of the homography: positive in front of the camera, 0 on the horizon."""
    depth: _Coordinate = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
    return depth


@compiled_part()
def project(matrix: FloatArray, x: _Coordinate, y: _Coordinate) -> tuple[_Coordinate, _Coordinate]:
    """Coordinates (x, y) to which the homography maps a point."""
    depth = projection_depth(matrix, x, y)
    return (
        (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]) / depth,
        (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]) / depth,
    )


@compiled_part()
def projection_slopes(
    matrix: FloatArray, x: _Coordinate, y: _Coordinate
) -> tuple[_Coordinate, _Coordinate, _Coordinate, _Coordinate]:
    """Derivative of the homography at a point: dx'/dx, dx'/dy, dy'/dx, dy'/dy."""
    depth = projection_depth(matrix, x, y)
    to_x, to_y = project(matrix, x, y)
    return (
        (matrix[0, 0] - to_x * matrix[2, 0]) / depth,
        (matrix[0, 1] - to_x * matrix[2, 1]) / depth,
        (matrix[1, 0] - to_y * matrix[2, 0]) / depth,
        (matrix[1, 1] - to_y * matrix[2, 1]) / depth,
    )


def homography_fault(
    matrix: FloatArray, centre_px: tuple[float, float] | None = None
) -> str | None:
    """Say why no camera before a plane has a homography; None if nothing speaks against it.

    ``centre_px`` is the middle ``(x, y)`` of the follow-up, not mirrored and of no absurd scale;
    None if it is not known, or may be mirrored.
    """
    if matrix.shape != (3, 3) or not np.all(np.isfinite(matrix)):
        return f"expected 3 x 3 finite numbers, got shape {matrix.shape}"
    size = np.linalg.svd(matrix, compute_uv=False)
    if not size[2] > _FLAT * size[0]:
        return (
            "expected a matrix that can be inverted; this one maps the plane to a line or a point"
        )
    if centre_px is None:
        return None
    if projection_depth(matrix, *centre_px) == 0:
        return "the plane's horizon goes through the middle of the follow-up"
    a, b, c, d = projection_slopes(matrix, *centre_px)
    area = a * d - b * c
    if area < 0:
        return "it mirrors the scene, which no camera does; reverse the columns of one of the two"
    if not _SMALLEST < area < _LARGEST:
        return f"a follow-up pixel covers {area:.3g} px2 of the reference; is it scaled wrongly?"
    return None


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
    """The ``lens`` of one camera that took frames of ``(rows, cols)``.

    ``distortion_k1`` is the relative distortion at the corner of the reference's frame; negative is
    barrel. ``origin_px`` is the position ``(x, y)`` of the follow-up's pixel (0, 0) in the camera's
    frame; by default, the follow-up is centred in the frame.
    """
    x, y = (reference[1] - 1) / 2, (reference[0] - 1) / 2
    followup_x, followup_y = (follow_up[1] - 1) / 2, (follow_up[0] - 1) / 2
    if origin_px is not None:
        followup_x, followup_y = x - origin_px[0], y - origin_px[1]
    return np.array([distortion_k1 / max(hypot(x, y), 0.5) ** 2, followup_x, followup_y, x, y])


def refuse_folding(distortion_k1: float, lens: FloatArray, follow_up: tuple[int, int]) -> None:
    """Raise if a lens does not show all of a follow-up of ``(rows, cols)``, as its frame folds."""
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
def ideal_factor(k1: float, k2: float) -> float:
    """Ideal radius for the seen radius 1, by bracketed Newton's method up to the fold."""
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
def seen_factor(k1: float, k2: float, square: float, frame: float) -> float:
    """Factor from an ideal point, its radius squared, to the seen one; infinite if far outside."""
    factor = 1 + square * (k1 + square * k2)
    # With k2 above 0 seen radii may increase again further out.
    is_folded = 1 + square * (3 * k1 + 5 * square * k2) <= 0 or (
        k2 > 0 and square > _fold_square(k1, k2)
    )
    return inf if is_folded and factor * sqrt(square) < frame else factor


@compiled()
def ideal_factors(k1: float, k2: float, squares: FloatArray) -> FloatArray:
    """Factors from seen points to ideal ones, by squared radii, shape (n,), up to the fold."""
    factors = np.empty_like(squares)
    for i in range(len(squares)):
        factors[i] = ideal_factor(k1 * squares[i], k2 * squares[i] * squares[i])
    return factors


@compiled()
def seen_factors(k1: float, k2: float, squares: FloatArray, frame: float) -> FloatArray:
    """Factors from ideal points to seen ones, by squared radii, shape (n,), with k of the radius 1.

    ``frame`` is the radius of a circle about the lens's centre that contains the frame.
    """
    factors = np.empty_like(squares)
    for i in range(len(squares)):
        factor = seen_factor(k1, k2, squares[i], frame)
        factors[i] = _FAR / sqrt(squares[i]) if isinf(factor) else factor
    return factors


@compiled()
def ideal_points(lens: FloatArray, points_px: FloatArray) -> FloatArray:
    """Ideal points of seen points of the follow-up; both of shape (n, 2), order (x, y)."""
    ideal = np.empty_like(points_px)
    for i in range(len(points_px)):
        dx, dy = points_px[i, 0] - lens[1], points_px[i, 1] - lens[2]
        factor = ideal_factor(lens[0] * (dx * dx + dy * dy), 0.0)
        ideal[i, 0], ideal[i, 1] = lens[1] + factor * dx, lens[2] + factor * dy
    return ideal


@compiled_part()
def _distortion_slopes(k1: float, x: float, y: float) -> tuple[float, float, float]:
    """Derivative xx, xy, yy of the seen point by the ideal one, both about the centre."""
    factor = 1 + k1 * (x * x + y * y)
    return factor + 2 * k1 * x * x, 2 * k1 * x * y, factor + 2 * k1 * y * y


@compiled_part()
def _warp(
    matrix: FloatArray, lens: FloatArray, col: float, row: float
) -> tuple[float, float, float, float, float, float]:
    """Reference coordinates (x, y) of a follow-up point, and the derivative (a, b; c, d) there."""
    k1 = lens[0]
    if k1 == 0:
        x, y = project(matrix, col, row)
        a, b, c, d = projection_slopes(matrix, col, row)
        return x, y, a, b, c, d
    dx, dy = col - lens[1], row - lens[2]
    factor = ideal_factor(k1 * (dx * dx + dy * dy), 0.0)
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
    factor = seen_factor(k1, 0.0, square, hypot(lens[3] + 1, lens[4] + 1))
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
        factor = ideal_factor(k1 * (dx * dx + dy * dy), 0.0)
        x, y = project(matrix, lens[1] + factor * dx, lens[2] + factor * dy)
        dx, dy = x - lens[3], y - lens[4]
        square = dx * dx + dy * dy
        factor = seen_factor(k1, 0.0, square, frame)
        if isinf(factor):
            factor = _FAR / sqrt(square)
        found[i, 0], found[i, 1] = lens[3] + factor * dx, lens[4] + factor * dy
    return found


BORDER_PX = 0.5 + 1e-6
"""How far outside the outermost pixel centres a position still counts as inside."""

NEARER_TOLERANCE_PX2 = 1e-3
"""A smaller surplus of variance changes the contrast at Nyquist by less than 0.5 %."""


class BlurredWarp(NamedTuple):
    """Positions of a follow-up's pixels in the reference, and the PSF of either image.

    ``matrix`` takes ideal follow-up to ideal reference pixels, ``psf`` are polynomial coefficients
    of the covariance, shape ``(3, n)``. ``frame`` holds the polynomials' centre x, y and 1 /
    radius, and the position x, y of the follow-up's pixel (0, 0) in their frame.
    """

    matrix: FloatArray
    lens: FloatArray
    psf: FloatArray
    frame: FloatArray


@compiled_part(nogil=True, forceinline=True)
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
        monomial = 1.0
        for _ in range(total - power):
            monomial *= u
        for _ in range(power):
            monomial *= v
        xx += psf[0, k] * monomial
        xy += psf[1, k] * monomial
        yy += psf[2, k] * monomial
        power += 1
        if power > total:
            total, power = total + 1, 0
    return xx, xy, yy


@compiled_part(nogil=True, forceinline=True)
def _missing_blur(
    matrix: FloatArray,
    lens: FloatArray,
    psf: FloatArray,
    frame: FloatArray,
    col: float,
    row: float,
) -> tuple[float, float, float, float, float, float, float]:
    """Position (x, y), its derivative along the row, and the blur (xx, xy, yy) missing there."""
    x, y, a, b, c, d = _warp(matrix, lens, col, row)
    xx, xy, yy = _covariance(psf, frame, col + frame[3], row + frame[4])
    own_xx, own_xy, own_yy = _covariance(psf, frame, x, y)
    return (
        x,
        y,
        a,
        c,
        a * a * xx + 2 * a * b * xy + b * b * yy - own_xx,
        a * c * xx + (a * d + b * c) * xy + b * d * yy - own_xy,
        c * c * xx + 2 * c * d * xy + d * d * yy - own_yy,
    )


@compiled_part(nogil=True, forceinline=True)
def surveyed(
    matrix: FloatArray,
    lens: FloatArray,
    psf: FloatArray,
    frame: FloatArray,
    col: float,
    row: float,
) -> tuple[float, float, float, float, float]:
    """Position (x, y), its derivative along the row, and the missing blur's least eigenvalue."""
    x, y, a, c, xx, xy, yy = _missing_blur(matrix, lens, psf, frame, col, row)
    half = (xx - yy) / 2
    return x, y, a, c, (xx + yy) / 2 - sqrt(half * half + xy * xy)


@compiled(nogil=True)
def survey(view: BlurredWarp, rows: FloatArray, cols: FloatArray) -> FloatArray:
    """(x, y, xx, xy, yy) of the missing blur at ``[i, j]`` of a lattice; it may be indefinite."""
    matrix, lens, psf, frame = view
    seen = np.empty((len(rows), len(cols), 5))
    for i in range(len(rows)):
        for j in range(len(cols)):
            x, y, _, _, xx, xy, yy = _missing_blur(matrix, lens, psf, frame, cols[j], rows[i])
            seen[i, j, 0], seen[i, j, 1] = x, y
            seen[i, j, 2], seen[i, j, 3], seen[i, j, 4] = xx, xy, yy
    return seen


@compiled(nogil=True)
def derivatives(
    matrix: FloatArray, lens: FloatArray, points_px: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Images ``(n, 2)`` of points ``(n, 2)``, order (x, y), and the warp's derivatives there."""
    images, slopes = np.empty_like(points_px), np.empty((len(points_px), 2, 2))
    for i in range(len(points_px)):
        x, y, a, b, c, d = _warp(matrix, lens, points_px[i, 0], points_px[i, 1])
        images[i, 0], images[i, 1] = x, y
        slopes[i, 0, 0], slopes[i, 0, 1], slopes[i, 1, 0], slopes[i, 1, 1] = a, b, c, d
    return images, slopes
