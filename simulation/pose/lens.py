"""A homography between two images as a lens with radial distortion shows them, compiled.

An ideal place at the radius ``r`` from the frame's middle is seen at ``r (1 + s r^2)``. The warp
goes from a seen place of the follow-up to its ideal one, by the homography to the ideal place in
the reference, and on to where that is seen; its derivative is the product of the three.

``lens`` is ``s`` in 1/px^2 and the middles that distances count from: x and y in the follow-up, x
and y in the reference.
"""

from collections.abc import Callable
from math import hypot, sqrt
from typing import TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

__all__ = ["DISTORTION_MAX", "ideal_places", "lens_of", "warp"]

FloatArray = NDArray[np.float64]
Function = TypeVar("Function", bound=Callable[..., object])

DISTORTION_MAX = 0.12
"""Largest distortion, relative at the frame's corner. A barrel of strength s shows nothing beyond
the radius ``2 / sqrt(27 s)``: from 4/27 on that lies inside the corner."""

_FOLD_MARGIN = 0.9
_FAR_PX = 1e9

_NEWTON_STEPS = 20
_NEWTON_CONVERGED = 1e-14
_LEAST_SLOPE = 0.1


def lens_of(
    distortion_k1: float,
    reference: tuple[int, int],
    follow_up: tuple[int, int],
    origin_px: tuple[float, float] | None,
) -> FloatArray:
    """``lens`` of one camera that took both frames.

    Parameters
    ----------
    distortion_k1
        Relative, at the corner of the reference's frame; negative is barrel.
    reference, follow_up
        ``(rows, cols)``.
    origin_px
        Where the follow-up's pixel (0, 0) lies in the camera's frame, ``(x, y)``; None: the
        follow-up's middle is the frame's.

    Raises
    ------
    ValueError
        If the distortion is not finite, so large that the frame folds, or the follow-up is so
        much larger than the reference that it does.
    """
    if not abs(distortion_k1) <= DISTORTION_MAX:
        raise ValueError(
            f"the distortion k1 must lie between -{DISTORTION_MAX} and {DISTORTION_MAX}, "
            f"got {distortion_k1}"
        )
    x, y = (reference[1] - 1) / 2, (reference[0] - 1) / 2
    followup_x, followup_y = (follow_up[1] - 1) / 2, (follow_up[0] - 1) / 2
    if origin_px is not None:
        followup_x, followup_y = x - origin_px[0], y - origin_px[1]
    strength = distortion_k1 / max(hypot(x, y), 0.5) ** 2
    farthest_px = hypot(
        max(followup_x, follow_up[1] - 1 - followup_x) + 0.5,
        max(followup_y, follow_up[0] - 1 - followup_y) + 0.5,
    )
    if -27 * strength * farthest_px**2 / 4 > _FOLD_MARGIN:
        raise ValueError(
            f"a lens with the distortion k1 {distortion_k1} shows nothing in the corners of a "
            f"follow-up of {follow_up[1]} x {follow_up[0]} px"
        )
    return np.array([strength, followup_x, followup_y, x, y])


def _compiled(function: Function) -> Function:
    return cast("Function", njit(cache=True, error_model="numpy")(function))


@_compiled
def _distortion(strength: float, x: float, y: float) -> tuple[float, float, float, float]:
    """Factor from an ideal place about the middle to the seen one; its derivative xx, xy, yy."""
    factor = 1 + strength * (x * x + y * y)
    return (
        factor,
        factor + 2 * strength * x * x,
        2 * strength * x * y,
        factor + 2 * strength * y * y,
    )


@_compiled
def _ideal_factor(strength: float, x: float, y: float) -> float:
    """Factor from a seen place about the middle to the ideal one, by Newton's method."""
    square = strength * (x * x + y * y)
    factor = 1.0
    for _ in range(_NEWTON_STEPS):
        bent = square * factor * factor
        step = (factor * (1 + bent) - 1) / max(1 + 3 * bent, _LEAST_SLOPE)
        factor -= step
        if abs(step) < _NEWTON_CONVERGED:
            break
    return factor


@_compiled
def ideal_places(lens: FloatArray, places_px: FloatArray) -> FloatArray:
    """Ideal places of seen places of the follow-up; both of shape (n, 2), order (x, y)."""
    ideal = np.empty_like(places_px)
    for i in range(len(places_px)):
        dx, dy = places_px[i, 0] - lens[1], places_px[i, 1] - lens[2]
        factor = _ideal_factor(lens[0], dx, dy)
        ideal[i, 0], ideal[i, 1] = lens[1] + factor * dx, lens[2] + factor * dy
    return ideal


@_compiled
def warp(
    matrix: FloatArray, lens: FloatArray, col: float, row: float
) -> tuple[float, float, float, float, float, float]:
    """Reference place (x, y) of a follow-up place, and the derivative (a, b; c, d) there.

    What lies beyond the fold of a barrel is not seen: its place is far outside.
    """
    strength = lens[0]
    p, q, r = 1.0, 0.0, 1.0
    if strength != 0:
        dx, dy = col - lens[1], row - lens[2]
        factor = _ideal_factor(strength, dx, dy)
        dx, dy = factor * dx, factor * dy
        col, row = lens[1] + dx, lens[2] + dy
        _, xx, xy, yy = _distortion(strength, dx, dy)
        determinant = xx * yy - xy * xy
        p, q, r = yy / determinant, -xy / determinant, xx / determinant
    w = matrix[2, 0] * col + matrix[2, 1] * row + matrix[2, 2]
    x = (matrix[0, 0] * col + matrix[0, 1] * row + matrix[0, 2]) / w
    y = (matrix[1, 0] * col + matrix[1, 1] * row + matrix[1, 2]) / w
    a, b = (matrix[0, 0] - x * matrix[2, 0]) / w, (matrix[0, 1] - x * matrix[2, 1]) / w
    c, d = (matrix[1, 0] - y * matrix[2, 0]) / w, (matrix[1, 1] - y * matrix[2, 1]) / w
    if strength != 0:
        a, b, c, d = a * p + b * q, a * q + b * r, c * p + d * q, c * q + d * r
        dx, dy = x - lens[3], y - lens[4]
        if 1 + 3 * strength * (dx * dx + dy * dy) <= 0:
            away = _FAR_PX / sqrt(dx * dx + dy * dy)
            return lens[3] + away * dx, lens[4] + away * dy, 1.0, 0.0, 0.0, 1.0
        factor, p, q, r = _distortion(strength, dx, dy)
        x, y = lens[3] + factor * dx, lens[4] + factor * dy
        a, b, c, d = p * a + q * c, p * b + q * d, q * a + r * c, q * b + r * d
    return x, y, a, b, c, d
