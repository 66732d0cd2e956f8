"""Where two black and two white squares meet, fitted to the raw pixels.

A Gaussian PSF turns the corner of a chessboard into the product of two blurred steps, one across
each of its edges. The fit takes the cross along these edges alone, where a marker cannot reach.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

__all__ = ["FittedCorners", "fit_corners"]

FloatArray = NDArray[np.float64]

_HALF_MAX_PX = 9.0
"""Beyond it the edges' curvature by lens distortion would tell."""
_BLUR_MARGIN_PX = 1.5
_ITERATIONS = 20
_CONVERGED_PX = 1e-4
_MOVE_MAX_PX = 1.5
_ERROR_FLOOR_PX = 0.001
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(2)
_PIXEL_NODES = tuple(
    (np.array([x, y]) / 2, wx * wy / 4)
    for x, wx in zip(_NODES, _WEIGHTS, strict=True)
    for y, wy in zip(_NODES, _WEIGHTS, strict=True)
)
"""Places in a pixel, and weights that sum to 1: the mean over the pixel's square."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FittedCorners:
    """Places of corners (x, y), shape (n, 2), standard error of a coordinate, and which are good.

    A corner is good if its fit settled near where it was looked for.
    """

    points_px: FloatArray
    err_px: FloatArray
    is_good: NDArray[np.bool_]


def fit_corners(
    image: FloatArray, points_px: FloatArray, axes_px: FloatArray, clear: float
) -> FittedCorners:
    """Fit every corner.

    Parameters
    ----------
    image
        Grey, shape ``(rows, cols)``.
    points_px
        About where the corners are, shape (n, 2), right to a pixel.
    axes_px
        The sides of a square in px, as columns, at each corner: shape (n, 2, 2).
    clear
        How far from an edge only the two squares beside it are seen, in sides of a square.

    Returns
    -------
    FittedCorners
        In the order of ``points_px``.
    """
    fitted, errors = points_px.copy(), np.full(len(points_px), np.inf)
    for number, (point, axes) in enumerate(zip(points_px, axes_px, strict=True)):
        found = _fit_corner(image, point, axes, clear)
        if found is not None:
            fitted[number], errors[number] = found
    return FittedCorners(points_px=fitted, err_px=errors, is_good=np.isfinite(errors))


def _fit_corner(
    image: FloatArray, point: FloatArray, axes: FloatArray, clear: float
) -> tuple[FloatArray, float] | None:
    side_px = float(np.hypot(*axes).min())
    half = int(min(_HALF_MAX_PX, 0.42 * side_px))
    col, row = (round(float(value)) for value in point)
    rows, cols = image.shape
    if half < 3 or not (half <= col < cols - half and half <= row < rows - half):
        return None
    y, x = np.mgrid[row - half : row + half + 1, col - half : col + half + 1].astype(np.float64)
    inside = np.column_stack([(x - point[0]).ravel(), (y - point[1]).ravel()])
    along = np.abs(inside @ np.linalg.inv(axes).T) * side_px
    chosen = along.min(axis=1) < max(clear * side_px - _BLUR_MARGIN_PX, 1.0)
    offsets = inside[chosen]
    values = image[row - half : row + half + 1, col - half : col + half + 1].ravel()[chosen]
    normals = np.arctan2(axes[0], -axes[1])
    # x, y, the angles of both edges' normals, width; the levels are linear.
    state = np.array([0.0, 0.0, normals[0], normals[1], 0.6])
    for _ in range(_ITERATIONS):
        design, residual, contrast = _corner_equations(offsets, values, state)
        if abs(contrast) < 1e-9 or not np.all(np.isfinite(design)):
            return None
        step, _, rank, _ = np.linalg.lstsq(design, residual, rcond=None)
        if rank < design.shape[1]:
            return None
        state = state + np.clip(step[:5], -0.5, 0.5)
        state[4] = min(max(state[4], 0.2), 4.0)
        if np.abs(step[:2]).max() < _CONVERGED_PX:
            break
    else:
        return None
    if np.hypot(*state[:2]) > _MOVE_MAX_PX:
        return None
    variance = float(residual @ residual) / max(len(residual) - design.shape[1], 1)
    spread = np.linalg.inv(design.T @ design)[:2, :2] * variance
    return point + state[:2], float(np.sqrt(np.trace(spread) / 2 + _ERROR_FLOOR_PX**2))


def _corner_equations(
    offsets: FloatArray, values: FloatArray, state: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Derivatives by the state and the levels, what is left, and the contrast."""
    x0, y0, first, second, width = state
    product = np.zeros(len(offsets))
    shape = np.zeros((len(offsets), len(state)))
    for inside_px, weight in _PIXEL_NODES:
        place = offsets - (x0, y0) + inside_px
        (a, da, sa, ga, ta), (b, db, sb, gb, tb) = (
            _blurred_step(place, angle, width) for angle in (first, second)
        )
        product += weight * sa * sb
        shape += weight * np.column_stack(
            [
                -(np.cos(a) * ga * sb + np.cos(b) * sa * gb),
                -(np.sin(a) * ga * sb + np.sin(b) * sa * gb),
                ga * ta * sb,
                sa * gb * tb,
                -(ga * da * sb + sa * gb * db) / width,
            ]
        )
    levels = np.column_stack([np.ones_like(product), offsets, product])
    amounts = np.linalg.lstsq(levels, values, rcond=None)[0]
    contrast = float(amounts[3])
    return np.column_stack([contrast * shape, levels]), values - levels @ amounts, contrast


def _blurred_step(
    place: FloatArray, angle: float, width: float
) -> tuple[float, FloatArray, FloatArray, FloatArray, FloatArray]:
    """A step from -1 to 1: angle, distance, level, steepness, and distance along it."""
    distance = place @ (np.cos(angle), np.sin(angle))
    level = 2 * ndtr(distance / width) - 1
    steepness = np.sqrt(2 / np.pi) * np.exp(-0.5 * (distance / width) ** 2) / width
    return angle, distance, level, steepness, place @ (-np.sin(angle), np.cos(angle))
