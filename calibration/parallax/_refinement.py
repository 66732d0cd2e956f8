"""Parallax to a fraction of a pixel: residuals and slopes along the epipolar lines.

B. Lucas, T. Kanade, "An iterative image registration technique with an application to stereo
vision", IJCAI 1981, with one freedom a pixel. Neighbours on one surface share what they know.
"""

import cv2
import numpy as np

from calibration.parallax._matching import AlignedViews
from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, Float32Array
from simulation.compiled import compiled

_LIGHT_PX = 12.0
"""Width over which a photograph is compared with its own mean and contrast."""

_CONTRAST_FLOOR = 0.15
"""Of the contrast's median over the frame: where there is none, noise is not made one."""

_ROUNDS = 4
_WINDOW_PX = 5
"""Reach of the neighbours of a pixel that are on its surface."""

_WINDOW_SIGMA_PX = 2.0
_SAME_SURFACE_PX = 1.0
_MOST_STEP_PX = 0.7
_LEAST_INFORMATION = 1e-4
"""Of the median: where there is no detail at all, the neighbours say all."""


def in_own_light(image: Float32Array, shown: BoolArray) -> Float32Array:
    """A photograph less its local mean, over its local contrast; 0 where it shows nothing."""
    weight = _blurred(shown.astype(np.float32)) + np.float32(1e-6)
    known = np.where(shown, image, np.float32(0))
    mean = _blurred(known) / weight
    apart = np.where(shown, image - mean, np.float32(0))
    contrast = np.sqrt(_blurred(apart**2) / weight)
    floor = _CONTRAST_FLOOR * float(np.median(contrast[shown])) if shown.any() else 1.0
    return np.asarray(apart / np.hypot(contrast, np.float32(max(floor, 1e-12))), dtype=np.float32)


def _blurred(image: Float32Array) -> Float32Array:
    return np.asarray(
        cv2.GaussianBlur(image, (0, 0), _LIGHT_PX, borderType=cv2.BORDER_REFLECT_101), np.float32
    )


def shifted_along(
    image: Float32Array, views: AlignedViews, parallax_px: Float32Array, interpolation: int
) -> Float32Array:
    """What an image shows where each pixel lies in it; NaN outside."""
    rows, cols = parallax_px.shape
    y, x = np.mgrid[0:rows, 0:cols].astype(np.float32)
    return np.asarray(
        cv2.remap(
            image,
            x + parallax_px * views.to_x,
            y + parallax_px * views.to_y,
            interpolation,
            borderValue=(np.nan,) * 4,
        ),
        dtype=np.float32,
    )


def refined_parallax(
    views: AlignedViews, parallax_px: Float32Array, matched: BoolArray
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Parallax, its standard error, and what is left of the levels in units of their scatter.

    ``views``: in their own light. ``parallax_px``: to a pixel, where ``matched``.
    """
    found = parallax_px.copy()
    smooth = np.asarray(cv2.GaussianBlur(views.target, (0, 0), 0.7), dtype=np.float32)
    source = np.asarray(cv2.GaussianBlur(views.source, (0, 0), 0.7), dtype=np.float32)
    slope_x, slope_y = (
        cv2.Sobel(source, cv2.CV_32F, across, 1 - across, scale=1 / 8) for across in (1, 0)
    )
    error = np.full(found.shape, np.inf, dtype=np.float32)
    left = np.zeros(found.shape, dtype=np.float32)
    for turn in range(_ROUNDS):
        seen = shifted_along(source, views, found, cv2.INTER_CUBIC)
        along = shifted_along(np.asarray(slope_x, np.float32), views, found, cv2.INTER_LINEAR)
        along = along * views.to_x + views.to_y * shifted_along(
            np.asarray(slope_y, np.float32), views, found, cv2.INTER_LINEAR
        )
        left = smooth - seen
        counts = matched & np.isfinite(left) & np.isfinite(along)
        if not counts.any():
            break
        left = np.where(counts, left, np.float32(0))
        along = np.where(counts, along, np.float32(0))
        scatter = np.float32(max(robust_sigma(left[counts]), 1e-9))
        least = _LEAST_INFORMATION * float(np.median(along[counts] ** 2))
        found, error = _stepped(
            found, left, along, counts, scatter, np.float32(least), turn < _ROUNDS - 1
        )
        left = left / scatter
    return found, error, left


@compiled(nogil=True)
def _stepped(
    parallax: Float32Array,
    left: Float32Array,
    along: Float32Array,
    counts: BoolArray,
    scatter: float,
    least: float,
    moves: bool,  # noqa: FBT001 - a flag of compiled code
) -> tuple[Float32Array, Float32Array]:
    """A step of each pixel's parallax with those around it on its surface, and its error."""
    rows, cols = parallax.shape
    found, error = parallax.copy(), np.full(parallax.shape, np.inf, dtype=np.float32)
    reach = _WINDOW_PX
    weights = np.empty((2 * reach + 1, 2 * reach + 1), dtype=np.float32)
    for j in range(-reach, reach + 1):
        for i in range(-reach, reach + 1):
            weights[j + reach, i + reach] = np.exp(-(j * j + i * i) / (2 * _WINDOW_SIGMA_PX**2))
    for row in range(rows):
        for col in range(cols):
            if not counts[row, col]:
                continue
            middle = parallax[row, col]
            information, score, squares, level, total = 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(max(row - reach, 0), min(row + reach + 1, rows)):
                for i in range(max(col - reach, 0), min(col + reach + 1, cols)):
                    apart = parallax[j, i] - middle
                    if not counts[j, i] or abs(apart) > _SAME_SURFACE_PX:
                        continue
                    weight = weights[j - row + reach, i - col + reach]
                    # A residual that no parallax explains does not pull at it.
                    size = abs(left[j, i]) / scatter
                    if size > 3.0:
                        weight = weight * 3.0 / size
                    slope = along[j, i]
                    information += weight * (slope * slope + least)
                    score += weight * (slope * (left[j, i] + slope * apart) + least * apart)
                    squares += weight * weight * slope * slope
                    level += weight * apart
                    total += weight
            if information <= 0:
                continue
            step = score / information
            if moves:
                found[row, col] = middle + min(max(step, -_MOST_STEP_PX), _MOST_STEP_PX)
            error[row, col] = scatter * np.sqrt(squares) / information
    return found, error
