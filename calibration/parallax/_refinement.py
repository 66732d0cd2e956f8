"""Parallax to a fraction of a pixel: residuals and slopes along the epipolar lines.

B. Lucas, T. Kanade, "An iterative image registration technique with an application to stereo
vision", IJCAI 1981, with one freedom a pixel. Neighbours on one surface share what they know.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import pi, sqrt
from typing import Self

import cv2
import numpy as np

from calibration.parallax._views import AlignedViews, seen_at, shifted_along, spline_of
from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, Float32Array
from simulation.compiled import compiled

_ROUNDS = 4
SMOOTHING_PX = 0.7
_WINDOW_PX, _WINDOW_SIGMA_PX = 7, 3.0
"""Reach and width of the neighbours that say with a pixel where its surface lies."""

_NARROW_PX = 5
"""Reach where there may be several surfaces."""

_SEVERAL_PX = 1.5
"""Range of the parallax in such a window, from which on there may be several surfaces."""

_SAME_SURFACE_PX, _SAME_SLOPE = 0.6, 0.12
"""Beside a jump, neighbours of one surface differ by so much, and so much a pixel of distance."""

_SLOPE_SD = 0.15
"""Of surfaces that are known by few details: standard deviation of the parallax's slope."""

_LEAST_SCATTER = 1e-3
"""Of levels in units of their contrast: where nothing is left at all."""

_CORRELATED_ERR = sqrt(2 * pi) * SMOOTHING_PX
"""Factor of the errors: noise smoothed by s px is the same over 4 pi s^2 px, and weights by a
Gaussian count half of these."""

_MOST_STEP_PX = 0.7
_STRAYED_PX, _STRAYED_IS_UNLIKE = 0.5, 100.0
"""How far the parallax may end from that of the match, and its half pixel; and how unlike it is
then."""

_PLACE_ERR_PX, _CONTRAST_ERR = 0.3, 0.2
"""What a match leaves that is one: of its place, and of the contrast around it, relative."""

_ROBUST_SD = 3.0
_LEAST_INFORMATION = 1e-3
"""Of the median: where there is no detail at all, the neighbours say all."""


def refined_parallax(
    views: AlignedViews,
    parallax_px: Float32Array,
    matched: BoolArray,
    rounds: int = _ROUNDS,
    coarse_px: int = 1,
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Parallax, its standard error, and how unlike the levels are, in units of what is expected.

    ``views``: in their own light. ``parallax_px``: where ``matched``, to a pixel of ``coarse_px``.
    """
    found = parallax_px.copy()
    error = np.full(found.shape, np.inf, dtype=np.float32)
    unlike = np.zeros(found.shape, dtype=np.float32)
    smooth = SmoothedViews.of(views)
    for _ in range(rounds):
        seen = smooth.residuals(found, matched)
        unlike, left, along = seen.unlike, seen.left, seen.along
        if not seen.counts.any():
            break
        # What no parallax explains does not pull at it.
        least = _LEAST_INFORMATION * float(np.median(along[seen.counts] ** 2))
        information = (seen.weight * (along**2 + least)).astype(np.float32)
        said = (seen.weight * along * left).astype(np.float32) + information * found
        fitted, error = _surface_fit(found, information, said, seen.counts)
        found += np.clip(fitted - found, -_MOST_STEP_PX, _MOST_STEP_PX) * seen.counts
    # On one surface, what has strayed from its match follows something that has none.
    strayed = np.abs(found - parallax_px) > _STRAYED_PX + 0.5 * coarse_px
    strayed &= ~_beside_jumps(parallax_px, matched, _SEVERAL_PX + coarse_px)
    return found, error, np.where(strayed, np.float32(_STRAYED_IS_UNLIKE), unlike)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Residuals:
    """What is left at each pixel, over its scatter, and how it changes with a pixel's displacement.

    ``along, across``: by a displacement towards the epipole, and to the right of that. ``weight``:
    less where more is left. ``unlike``: the size of what is left over what noise, some tenths of a
    pixel and another contrast around leave. ``counts``: pixels that are matched, and seen.
    """

    left: Float32Array
    along: Float32Array
    across: Float32Array
    weight: Float32Array
    unlike: Float32Array
    counts: BoolArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SmoothedViews:
    """Views smoothed a little, with the slopes of the source."""

    views: AlignedViews
    target: Float32Array
    source_spline: Float32Array
    slope_x: Float32Array
    slope_y: Float32Array

    @classmethod
    def of(cls, views: AlignedViews) -> Self:
        """Smooth, which takes from noise more than from what lenses show."""
        target, source = (
            np.asarray(cv2.GaussianBlur(image, (0, 0), SMOOTHING_PX), dtype=np.float32)
            for image in (views.target, views.source)
        )
        slope_x, slope_y = (
            np.asarray(cv2.Sobel(source, cv2.CV_32F, across, 1 - across, scale=1 / 8), np.float32)
            for across in (1, 0)
        )
        return cls(
            views=views,
            target=target,
            source_spline=spline_of(source),
            slope_x=slope_x,
            slope_y=slope_y,
        )

    def residuals(self, parallax_px: Float32Array, matched: BoolArray) -> Residuals:
        """What a parallax leaves of the matched pixels."""
        views = self.views
        rows, cols = parallax_px.shape
        at_y, at_x = np.mgrid[0:rows, 0:cols].astype(np.float32)
        at_y, at_x = at_y + parallax_px * views.to_y, at_x + parallax_px * views.to_x
        left = self.target - seen_at(self.source_spline, at_y, at_x)
        x, y = (
            shifted_along(one, views, parallax_px, cv2.INTER_LINEAR)
            for one in (self.slope_x, self.slope_y)
        )
        along, across = x * views.to_x + y * views.to_y, y * views.to_x - x * views.to_y
        counts = matched & np.isfinite(left) & np.isfinite(along)
        left, along, across = (np.where(counts, one, 0) for one in (left, along, across))
        scatter = np.float32(
            max(robust_sigma(left[counts]), _LEAST_SCATTER) if counts.any() else 1.0
        )
        left, along, across = left / scatter, along / scatter, across / scatter
        expected = 1 + _PLACE_ERR_PX**2 * (along**2 + across**2)
        expected += (_CONTRAST_ERR / scatter) ** 2 * self.target**2
        weight = np.where(counts, _ROBUST_SD / np.maximum(np.abs(left), _ROBUST_SD), 0)
        return Residuals(
            left=left.astype(np.float32),
            along=along.astype(np.float32),
            across=across.astype(np.float32),
            weight=weight.astype(np.float32),
            unlike=np.asarray(np.abs(left) / np.sqrt(expected), dtype=np.float32),
            counts=counts,
        )


def _surface_fit(
    parallax: Float32Array, information: Float32Array, said: Float32Array, counts: BoolArray
) -> tuple[Float32Array, Float32Array]:
    """Level at each pixel of the plane through what those around it say, and its error."""
    along = np.arange(-_WINDOW_PX, _WINDOW_PX + 1, dtype=np.float32)
    window = np.exp(-(along**2) / (2 * _WINDOW_SIGMA_PX**2))
    powers = [window, window * along, window * along**2]

    def moment(image: Float32Array, x_power: int, y_power: int) -> Float32Array:
        # Correlated, not convolved: distances are those of the neighbours from the pixel.
        found = cv2.sepFilter2D(
            image, -1, powers[x_power], powers[y_power], borderType=cv2.BORDER_CONSTANT
        )
        return np.asarray(found, dtype=np.float32)

    ridge = np.float32(_SLOPE_SD**-2)
    a, b, c = moment(information, 0, 0), moment(information, 1, 0), moment(information, 0, 1)
    d, e, f = moment(information, 2, 0), moment(information, 1, 1), moment(information, 0, 2)
    d, f = d + ridge, f + ridge
    # First row of the inverse of a symmetric matrix, whose other two columns are small.
    p, q, r = d * f - e * e, c * e - b * f, b * e - c * d
    whole = np.maximum(a * p + b * q + c * r, np.float32(1e-20))
    level = p * moment(said, 0, 0) + q * moment(said, 1, 0) + r * moment(said, 0, 1)
    fitted = np.where(a > 0, level / whole, parallax)
    error = np.where(a > 0, np.sqrt(np.maximum(p, 0) / whole), np.float32(np.inf))
    images = np.stack([parallax, information, said])
    found = np.stack([fitted, error]).astype(np.float32)
    beside = _beside_jumps(parallax, counts)
    cut = parallax.shape[0] // 2
    with ThreadPoolExecutor(2) as halves:
        parts = [
            halves.submit(_fit_beside_jumps, images, beside, found, *rows)
            for rows in ((0, cut), (cut, parallax.shape[0]))
        ]
        for part in parts:
            part.result()
    return found[0], np.float32(_CORRELATED_ERR) * found[1]


def _beside_jumps(
    parallax: Float32Array, counts: BoolArray, least_px: float = _SEVERAL_PX
) -> BoolArray:
    """Pixels in whose window there is more than one surface."""
    window = np.ones((2 * _WINDOW_PX + 1, 2 * _WINDOW_PX + 1), dtype=np.uint8)
    most = cv2.dilate(np.where(counts, parallax, np.float32(-1e9)), window)
    least = cv2.erode(np.where(counts, parallax, np.float32(1e9)), window)
    return np.asarray((most - least > least_px) & counts)


@compiled(nogil=True)
def _fit_beside_jumps(
    images: Float32Array, beside: BoolArray, found: Float32Array, first: int, last: int
) -> None:
    """The same with the neighbours alone that are on the pixel's surface, in place, some rows.

    ``images``: parallax, information, and what is said, shape ``(3, rows, cols)``. ``found``: fit
    and error.
    """
    parallax, information, said = images[0], images[1], images[2]
    rows, cols = parallax.shape
    reach = _NARROW_PX
    ridge = np.float32(_SLOPE_SD**-2)
    weights = np.empty((2 * reach + 1, 2 * reach + 1), dtype=np.float32)
    most = np.empty((2 * reach + 1, 2 * reach + 1), dtype=np.float32)
    for j in range(2 * reach + 1):
        for i in range(2 * reach + 1):
            square = (j - reach) ** 2 + (i - reach) ** 2
            weights[j, i] = np.exp(-square / (2 * _WINDOW_SIGMA_PX**2))
            most[j, i] = _SAME_SURFACE_PX + _SAME_SLOPE * np.sqrt(square)
    zero = np.float32(0)
    for row in range(first, last):
        for col in range(cols):
            if not beside[row, col]:
                continue
            middle = parallax[row, col]
            a, b, c, d, e, f = zero, zero, zero, ridge, zero, ridge
            u, v, w = zero, zero, zero
            for j in range(max(row - reach, 0), min(row + reach + 1, rows)):
                y = np.float32(j - row)
                for i in range(max(col - reach, 0), min(col + reach + 1, cols)):
                    at = (j - row + reach, i - col + reach)
                    known = information[j, i]
                    if known <= 0 or abs(parallax[j, i] - middle) > most[at]:
                        continue
                    x = np.float32(i - col)
                    level = weights[at] * said[j, i]
                    weight = weights[at] * known
                    a += weight
                    b += weight * x
                    c += weight * y
                    d += weight * x * x
                    e += weight * x * y
                    f += weight * y * y
                    u += level
                    v += level * x
                    w += level * y
            p, q, r = d * f - e * e, c * e - b * f, b * e - c * d
            whole = a * p + b * q + c * r
            if whole > 0:
                found[0, row, col] = (p * u + q * v + r * w) / whole
                found[1, row, col] = np.sqrt(p / whole)
