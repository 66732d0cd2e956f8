"""The focus value of an image, from sums that grow with its sharpness.

Each sum is one compiled pass, for speed: ``benchmarks/bench_focus.py``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from acquisition.choices import FocusMeasure

_SHORT_BYTES = 2
_FREE_ORDER = {"reassoc", "contract"}
"""Sums of floats may be taken in any order, so that they vectorise; integers are exact."""

Zero = np.int64 | np.float64
Levels = NDArray[np.integer[Any] | np.floating[Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureSums:
    """Mean squared response in DN^2, and mean and mean square of the levels."""

    response_dn2: float
    mean_dn: float
    square_dn2: float


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureKernel:
    """One focus measure.

    ``noise_gain`` is the mean squared response to white noise of variance 1: the sum of the
    squared weights. ``reach_px`` is how many pixels beyond 1 a side of the image must have.
    """

    kernel: Callable[[Levels, Any], tuple[float, float, float]]
    noise_gain: float
    reach_px: int
    kernel_of_integers: Callable[[Levels, Any], tuple[float, float, float]] | None = None

    def sums(self, image_dn: Levels) -> PictureSums:
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
        return PictureSums(
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
        """View of the region in an image of shape ``(rows, cols)``.

        Raises
        ------
        ValueError
            If the region reaches beyond the image.
        """
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

    With R the responses of the measure to the image I, b the black level, v the noise variance
    of a pixel and g the measure's noise gain (``FOCUS_MEASURES``)::

        F = (mean R^2 - g v) / (mean (I - b)^2 - v)

    Scaling the light scales numerator and denominator alike, so that exposure, gain and lamp
    drift do not affect it. Values are comparable only for the same scene, region and measure.

    Noise adds g v to the mean squared response; for the squared gradient g is 4. Left in
    (``noise_variance_dn2`` 0), it raises every value by about g v / mean (I - b)^2 and flattens
    the peak; where the light drifts, its share drifts too and moves the peak. Taken out, F is
    unbiased and may come out slightly negative on a flat scene. The mean of v over the region is
    enough, though shot noise varies with the level: the bias is linear in v.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``, at least 2 x 2; 3 x 3 for all but the squared gradient.
    black_level_dn
        Level without light.
    region
        Part of the image to measure, all of it by default.
    noise_variance_dn2
        For the mean of N frames, the temporal variance of one frame divided by N.
    measure
        See ``FOCUS_MEASURES``.

    References
    ----------
    Subbarao, Choi, Nikzad: "Focusing techniques", Optical Engineering 32 (11), 1993: gradient
    magnitude maximisation. Pertuz, Puig, Garcia: "Analysis of focus measure operators for
    shape-from-focus", Pattern Recognition 46, 2013: the others. ``benchmarks/bench_focus.py``
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
def _level_sums(image: Levels, zero: Zero) -> tuple[float, float]:
    total, square = zero, zero
    for y in range(image.shape[0]):
        row = image[y]
        for x in range(image.shape[1]):
            value = row[x] + zero
            total += value
            square += value * value
    return float(total), float(square)


@njit(cache=True, fastmath=_FREE_ORDER)
def _squared_gradient(image: Levels, zero: Zero) -> tuple[float, float, float]:
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
def _squared_gradient_of_integers(image: Levels, zero: Zero) -> tuple[float, float, float]:
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
def _brenner(image: Levels, zero: Zero) -> tuple[float, float, float]:
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
def _tenengrad(image: Levels, zero: Zero) -> tuple[float, float, float]:
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
def _laplacian(image: Levels, zero: Zero) -> tuple[float, float, float]:
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


FOCUS_MEASURES: dict[FocusMeasure, MeasureKernel] = {
    "squared-gradient": MeasureKernel(
        kernel=_squared_gradient,
        kernel_of_integers=_squared_gradient_of_integers,
        noise_gain=4.0,
        reach_px=1,
    ),
    "tenengrad": MeasureKernel(kernel=_tenengrad, noise_gain=24.0, reach_px=2),
    "brenner": MeasureKernel(kernel=_brenner, noise_gain=4.0, reach_px=2),
    "laplacian": MeasureKernel(kernel=_laplacian, noise_gain=20.0, reach_px=2),
}
"""Every focus measure by its name on the command line."""
