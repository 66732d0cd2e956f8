"""The focus value of an image, and whether there is anything in it to focus on.

It comes from sums that grow with the sharpness, each one compiled pass, for speed:
``benchmarks/speed/focus.py``. An edge across the picture looks the same from every height; a
texture is drawn at another scale, and its focus value changes with that as it does with the focus.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from acquisition.choices import FocusMeasure

_SHORT_BYTES = 2
_FREE_ORDER = {"reassoc", "contract"}
"""Sums of floats may be taken in any order, so that they vectorise; integers are exact."""

_Zero = np.int64 | np.float64
Levels = NDArray[np.integer[Any] | np.floating[Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class _PictureSums:
    """Mean squared response in DN^2, and mean and mean square of the levels."""

    response_dn2: float
    mean_dn: float
    square_dn2: float


@dataclass(frozen=True, slots=True, kw_only=True)
class _MeasureKernel:
    """A focus measure: the sum of its squared weights, and how far beyond a pixel it reaches."""

    kernel: Callable[[Levels, Any], tuple[float, float, float]]
    noise_gain: float
    reach_px: int
    kernel_of_integers: Callable[[Levels, Any], tuple[float, float, float]] | None = None

    def sums(self, image_dn: Levels) -> _PictureSums:
        """Take the sums of an image of shape ``(rows, cols)`` in one pass."""
        # One kind of array for all: another one is compiled anew, which takes a second or more and
        # keeps a live camera waiting.
        image_dn = np.ascontiguousarray(image_dn).view()
        image_dn.flags.writeable = False
        # The type of the zero is the type of the sums: exact for integers.
        is_whole = image_dn.dtype.kind in "ui"
        zero = np.int64(0) if is_whole else np.float64(0)
        is_short = is_whole and image_dn.dtype.itemsize <= _SHORT_BYTES
        kernel = self.kernel_of_integers if is_short and self.kernel_of_integers else self.kernel
        response, total, square = kernel(image_dn, zero)
        return _PictureSums(
            response_dn2=response, mean_dn=total / image_dn.size, square_dn2=square / image_dn.size
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """A rectangle of whole pixels; ``x_px``, ``y_px`` is its first column and row."""

    x_px: int
    y_px: int
    width_px: int
    height_px: int

    def __post_init__(self) -> None:
        if self.x_px < 0 or self.y_px < 0 or self.width_px < 2 or self.height_px < 2:
            raise ValueError(
                f"region must start at 0 or more and span at least 2 x 2 pixels, got {self}"
            )

    def cut(self, image: Levels) -> Levels:
        """View of the region in an image of shape ``(rows, cols)``."""
        bottom, right = self.y_px + self.height_px, self.x_px + self.width_px
        if bottom > image.shape[0] or right > image.shape[1]:
            raise ValueError(f"{self} reaches beyond the image of shape {image.shape}")
        return image[self.y_px : bottom, self.x_px : right]


def focus_value(
    image_dn: Levels,
    *,
    black_level_dn: float,
    region: Region | None = None,
    noise_variance_dn2: float = 0.0,
    measure: FocusMeasure = "squared-gradient",
) -> float:
    """Focus value, dimensionless; larger is sharper, 0 is flat or dark.

    With R the responses of the measure to the image I, b the black level, v the noise variance of a
    pixel and g the measure's noise gain (``FOCUS_MEASURES``)::

        F = (mean R^2 - g v) / (mean (I - b)^2 - v)

    Scaling the light scales numerator and denominator alike, so that exposure, gain and lamp drift
    do not affect it. Values are comparable only for the same scene, region and measure.

    Noise adds g v to the mean squared response; for the squared gradient g is 4. Left in
    (``noise_variance_dn2`` 0), it raises every value by about g v / mean (I - b)^2 and flattens the
    peak; where the light drifts, its share drifts too and moves the peak. Taken out, F is unbiased
    and may come out slightly negative on a flat scene. The mean of v over the region is enough,
    though shot noise varies with the level: the bias is linear in v. For the mean of N frames, v is
    the temporal variance of one frame divided by N.

    The image ``(rows, cols)`` has at least 2 x 2 pixels; 3 x 3 for all but the squared gradient.

    References
    ----------
    Subbarao, Choi, Nikzad: "Focusing techniques", Optical Engineering 32 (11), 1993: gradient
    magnitude maximisation. Pertuz, Puig, Garcia: "Analysis of focus measure operators for
    shape-from-focus", Pattern Recognition 46, 2013: the others. ``benchmarks/speed/focus.py``
    has their times.
    """
    view = image_dn if region is None else region.cut(image_dn)
    kernel = FOCUS_MEASURES[measure]
    least = kernel.reach_px + 1
    if view.ndim != 2 or min(view.shape) < least:
        raise ValueError(f"image must be at least {least} x {least} pixels, got shape {view.shape}")
    sums = kernel.sums(view)
    light_dn2 = (
        sums.square_dn2
        - 2.0 * black_level_dn * sums.mean_dn
        + black_level_dn**2
        - noise_variance_dn2
    )
    response_dn2 = sums.response_dn2 - kernel.noise_gain * noise_variance_dn2
    return response_dn2 / light_dn2 if light_dn2 > 0 else 0.0


@njit(cache=True, fastmath=_FREE_ORDER)
def _level_sums(image: Levels, zero: _Zero) -> tuple[float, float]:
    total, square = zero, zero
    for y in range(image.shape[0]):
        row = image[y]
        for x in range(image.shape[1]):
            value = row[x] + zero
            total += value
            square += value * value
    return float(total), float(square)


@njit(cache=True, fastmath=_FREE_ORDER)
def _squared_gradient(image: Levels, zero: _Zero) -> tuple[float, float, float]:
    """Mean (I[x+1] - I[x])^2 plus mean (I[y+1] - I[y])^2."""
    rows, cols = image.shape
    across, down, total, square = zero, zero, zero, zero
    for y in range(rows - 1):
        row, below = image[y], image[y + 1]
        for x in range(cols - 1):
            value = row[x] + zero
            dx = row[x + 1] - value
            dy = below[x] - value
            total += value
            square += value * value
            across += dx * dx
            down += dy * dy
        value = row[cols - 1] + zero
        dy = below[cols - 1] - value
        total += value
        square += value * value
        down += dy * dy
    last = image[rows - 1]
    for x in range(cols):
        value = last[x] + zero
        total += value
        square += value * value
        if x + 1 < cols:
            dx = last[x + 1] - value
            across += dx * dx
    mean = across / (rows * (cols - 1)) + down / ((rows - 1) * cols)
    return mean, float(total), float(square)


@njit(cache=True)
def _squared_gradient_of_integers(image: Levels, zero: _Zero) -> tuple[float, float, float]:
    """The same for at most 16 bits: squares fit in 32 bits, which vectorises twice as well."""
    rows, cols = image.shape
    across, down = np.uint64(0), np.uint64(0)
    total, square = np.uint64(0), np.uint64(0)
    for y in range(rows - 1):
        row, below = image[y], image[y + 1]
        for x in range(cols - 1):
            value = np.int32(row[x])
            dx = np.int32(row[x + 1]) - value
            dy = np.int32(below[x]) - value
            total += np.uint32(value)
            square += np.uint64(np.uint32(value * value))
            across += np.uint64(np.uint32(dx * dx))
            down += np.uint64(np.uint32(dy * dy))
        value = np.int32(row[cols - 1])
        dy = np.int32(below[cols - 1]) - value
        total += np.uint32(value)
        square += np.uint64(np.uint32(value * value))
        down += np.uint64(np.uint32(dy * dy))
    last = image[rows - 1]
    for x in range(cols):
        value = np.int32(last[x])
        total += np.uint32(value)
        square += np.uint64(np.uint32(value * value))
        if x + 1 < cols:
            dx = np.int32(last[x + 1]) - value
            across += np.uint64(np.uint32(dx * dx))
    mean = across / (rows * (cols - 1)) + down / ((rows - 1) * cols)
    return mean, float(total), float(square)


@njit(cache=True, fastmath=_FREE_ORDER)
def _brenner(image: Levels, zero: _Zero) -> tuple[float, float, float]:
    """Mean (I[x+2] - I[x])^2 plus mean (I[y+2] - I[y])^2."""
    rows, cols = image.shape
    across, down = zero, zero
    for y in range(rows):
        row = image[y]
        for x in range(cols - 2):
            dx = (row[x + 2] + zero) - row[x]
            across += dx * dx
    for y in range(rows - 2):
        row, below = image[y], image[y + 2]
        for x in range(cols):
            dy = (below[x] + zero) - row[x]
            down += dy * dy
    total, square = _level_sums(image, zero)
    return across / (rows * (cols - 2)) + down / ((rows - 2) * cols), total, square


@njit(cache=True, fastmath=_FREE_ORDER)
def _tenengrad(image: Levels, zero: _Zero) -> tuple[float, float, float]:
    """Mean of the squares of both Sobel gradients."""
    rows, cols = image.shape
    sum2 = zero
    for y in range(1, rows - 1):
        above, row, below = image[y - 1], image[y], image[y + 1]
        for x in range(1, cols - 1):
            nw, ne = above[x - 1] + zero, above[x + 1] + zero
            sw, se = below[x - 1] + zero, below[x + 1] + zero
            dx = ne - nw + 2 * ((row[x + 1] + zero) - row[x - 1]) + se - sw
            dy = sw - nw + 2 * ((below[x] + zero) - above[x]) + se - ne
            sum2 += dx * dx + dy * dy
    total, square = _level_sums(image, zero)
    return sum2 / ((rows - 2) * (cols - 2)), total, square


@njit(cache=True, fastmath=_FREE_ORDER)
def _laplacian(image: Levels, zero: _Zero) -> tuple[float, float, float]:
    """Variance of the four neighbours less 4 I."""
    rows, cols = image.shape
    sum1, sum2 = zero, zero
    for y in range(1, rows - 1):
        above, row, below = image[y - 1], image[y], image[y + 1]
        for x in range(1, cols - 1):
            bend = (above[x] + zero) + below[x] + row[x - 1] + row[x + 1] - 4 * (row[x] + zero)
            sum1 += bend
            sum2 += bend * bend
    count = (rows - 2) * (cols - 2)
    total, square = _level_sums(image, zero)
    return sum2 / count - (sum1 / count) ** 2, total, square


FOCUS_MEASURES: dict[FocusMeasure, _MeasureKernel] = {
    "squared-gradient": _MeasureKernel(
        kernel=_squared_gradient,
        kernel_of_integers=_squared_gradient_of_integers,
        noise_gain=4.0,
        reach_px=1,
    ),
    "tenengrad": _MeasureKernel(kernel=_tenengrad, noise_gain=24.0, reach_px=2),
    "brenner": _MeasureKernel(kernel=_brenner, noise_gain=4.0, reach_px=2),
    "laplacian": _MeasureKernel(kernel=_laplacian, noise_gain=20.0, reach_px=2),
}
"""Every focus measure by its name on the command line."""


_BLOCK_PX = 4
_FEWEST_BLOCKS = 4  # a third difference takes four
_SIGMAS = 5.0
_OVERLAP = 4.62  # 2 (1 + 2 (15^2 + 6^2 + 1) / 20^2): differences of neighbours share levels
_LEAST_PX = 32  # either way; less than half of it may be of one colour
_PIXELS = 2**17
_COARSE, _COARSE_PX = 4, 195
"""An edge far out of focus is seen in means over 4 px, or of at most 195 to a picture's side."""

_SHADING = 2e-3  # of the level: a highlight on paper leaves half of that in such means
_SPARSEST = 8  # a row of blocks every 32 px
_LEAST_DN = 0.3  # steps of 1 DN of a smooth light scatter by 1 / sqrt(12)


def shows_nothing(image_dn: Levels) -> bool:
    """Whether there is nothing in a picture to focus on, as in a lens cap; False below 32 px."""
    if min(image_dn.shape) < _LEAST_PX:
        return False
    # Every second pixel of a mosaic has one colour.
    if has_detail(image_dn) or has_detail(image_dn[::2, ::2]):
        return False
    rows, cols = image_dn.shape
    factor = max(_COARSE, max(rows, cols) // _COARSE_PX)
    size = cols // factor, rows // factor
    coarse_dn = cv2.resize(image_dn.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return not has_detail(coarse_dn, least_dn=max(_LEAST_DN, _SHADING * float(coarse_dn.mean())))


def has_detail(image_dn: Levels, *, least_dn: float = _LEAST_DN) -> bool:
    """Whether levels of one colour differ by more than noise that differs from pixel to pixel.

    Means over 4 x 4 pixels of independent noise scatter by a quarter of what the pixels do; what a
    lens draws scatters more. Third differences take out light that falls off; ``least_dn`` is what
    uneven light may leave. False below 16 px either way.
    """
    return _is_drawn(image_dn, least_dn) or _is_drawn(image_dn.T, least_dn)


def _is_drawn(levels_dn: Levels, least_dn: float) -> bool:
    rows, cols = (length // _BLOCK_PX for length in levels_dn.shape)
    if rows < 1 or cols < _FEWEST_BLOCKS:
        return False
    cut = levels_dn[: rows * _BLOCK_PX, : cols * _BLOCK_PX]
    # Of a large picture some rows of blocks are enough.
    step = min(max(cut.size // _PIXELS, 1), _SPARSEST)
    strips = cut.reshape(rows, _BLOCK_PX, cols * _BLOCK_PX)[::step].astype(np.float64)
    rows = len(strips)
    pixels = strips.reshape(rows * _BLOCK_PX, cols * _BLOCK_PX)
    blocks = pixels.reshape(rows, _BLOCK_PX, cols, _BLOCK_PX).mean(axis=(1, 3))
    per_block = _scatter_dn2(blocks)
    of_noise = _scatter_dn2(pixels) / _BLOCK_PX**2
    unsure = _SIGMAS * sqrt(_OVERLAP / (rows * (cols - 3))) * of_noise
    return per_block - of_noise > max(unsure, least_dn**2)


def _scatter_dn2(levels: NDArray[np.float64]) -> float:
    """Variance of independent levels, from their third differences along the rows."""
    bend = np.diff(levels, n=3, axis=1)
    return float(np.mean(bend * bend)) / 20.0


_TEXTURE_BLOCK_PX = 8
_FEWEST_TEXTURE_BLOCKS = 4
_EDGE_CORE = 0.25  # of the strongest block: those that say where the edge is
_EDGE_BAND = 0.125  # of the shorter side, to either side of the edge
_EDGE_CROSSED = 0.85  # of the way across the picture


def texture_share(image_dn: Levels) -> float:
    """Share of the detail not of one straight edge, 0 to 1; 1 without detail or below 32 px.

    Detail is what differs more over two pixels than over one, as noise and the sensor's own pattern
    do not.
    """
    detail = _detail_blocks(np.asarray(image_dn, dtype=np.float32))
    if min(detail.shape) < _FEWEST_TEXTURE_BLOCKS or not detail.sum() > 0:
        return 1.0
    y, x = np.nonzero(detail > _EDGE_CORE * detail.max())
    weight = detail[y, x]
    centre = np.average([x, y], axis=1, weights=weight)
    spread = np.cov([x, y], aweights=weight) if x.size > 1 else np.eye(2)
    normal, along = np.linalg.eigh(spread)[1].T
    rows, cols = np.indices(detail.shape)
    away = normal[0] * (cols - centre[0]) + normal[1] * (rows - centre[1])
    on_line = np.abs(away) <= 1.0
    position = along[0] * (cols - centre[0]) + along[1] * (rows - centre[1])
    is_drawn = on_line & (detail > _EDGE_CORE * np.median(detail[on_line]))
    crossed = np.ptp(position[is_drawn]) if is_drawn.any() else 0.0
    if crossed < _EDGE_CROSSED * np.ptp(position[on_line]):
        return 1.0
    beside = np.abs(away) > max(_EDGE_BAND * min(detail.shape), 1.0)
    # As much detail lies in the band as in any other place.
    share = detail[beside].sum() / detail.sum() / max(float(beside.mean()), 1e-9)
    return float(np.clip(share, 0.0, 1.0))


def _detail_blocks(levels_dn: NDArray[np.float32]) -> NDArray[np.float64]:
    """Squared differences over two pixels less those over one, summed in blocks."""
    inner = levels_dn[:-2, :-2]
    detail = (levels_dn[:-2, 2:] - inner) ** 2 + (levels_dn[2:, :-2] - inner) ** 2
    detail -= (levels_dn[:-2, 1:-1] - inner) ** 2 + (levels_dn[1:-1, :-2] - inner) ** 2
    rows, cols = (length // _TEXTURE_BLOCK_PX for length in detail.shape)
    cut = detail[: rows * _TEXTURE_BLOCK_PX, : cols * _TEXTURE_BLOCK_PX].astype(np.float64)
    return np.asarray(
        cut.reshape(rows, _TEXTURE_BLOCK_PX, cols, _TEXTURE_BLOCK_PX).sum(axis=(1, 3))
    )
