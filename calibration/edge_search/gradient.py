"""Ridges of an image's gradient, found strip by strip, and its noise in dark and bright areas.

An image is never copied as a whole: memory that is touched for the first time costs more than the
filters do. What is kept are the ridge pixels, each with what a line through it needs.
"""

from dataclasses import dataclass
from math import ceil, floor, log1p, sqrt

import cv2
import numpy as np

from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray
from simulation.compiled import compiled, compiled_part

SMOOTHING_PX = 1.0
# Where edges fill the picture, as squares of 25 px do, the median gradient is theirs: then it is
# far above that of the lowest quarter (8 times and more; in textures 4 times at most).
_MIDDLE, _LOWER, _LOWEST = 0.5, 0.25, 0.1
_CROWDED = 5.0
_CROWDED_LEAST = 0.04  # of the strongest gradient: less hides no edge
_NOISE_HIGH = 5.0
_NOISE_LOW = 2.5
_NOISE_RANGES, _NOISE_PIXELS, _NOISE_SPREAD = 4, 100, 5.0
_LEAST_OF_STRONGEST = 0.04
_LOW_OF_HIGH = 0.4
_TILES, _TILE_PX = 10, 32  # along either axis, and side: the noise is taken from 100 000 pixels
_SAMPLED_PX = 100_000  # of an image not much larger than all tiles
_HALO_PX = 6  # median 1, Gaussian 4, Scharr 1
_ACROSS_PX = 5  # farthest that a ridge pixel looks
_STRIP_PIXELS, _STRIP_ROWS = 1 << 17, 64  # work images of half a megabyte, but not too flat
PROFILE_PX = 3.0  # half the band about a ridge whose moments are taken
_TAN_22_5 = sqrt(2.0) - 1.0


@dataclass(frozen=True, slots=True, eq=False)
class RidgePixels:
    """Pixels where the gradient of the smoothed image is largest across itself, from top to bottom.

    All of shape ``(n,)``. ``shift`` is where the ridge lies beside the pixel, along the axis
    nearer to the gradient. ``moments``, shape ``(n, 3)``, are the sums of the squared gradient
    along that axis, times 1, the offset and its square.
    """

    rows: IntArray
    cols: IntArray
    x: Float32Array
    y: Float32Array
    shift: Float32Array
    moments: Float32Array

    @property
    def strength(self) -> Float32Array:
        """Magnitude of the gradient."""
        return np.hypot(self.x, self.y)

    @staticmethod
    def joined(parts: "list[RidgePixels]") -> "RidgePixels":
        """Return the pixels of all parts, one after another."""
        names = ("rows", "cols", "x", "y", "shift", "moments")
        return RidgePixels(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))

    def where(self, chosen: BoolArray) -> "RidgePixels":
        """Return the chosen ones."""
        return RidgePixels(
            self.rows[chosen],
            self.cols[chosen],
            self.x[chosen],
            self.y[chosen],
            self.shift[chosen],
            self.moments[chosen],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Gradient:
    """Ridges of an image's gradient, whose levels are scaled to about 0 to 1.

    Ridge pixels weaker than ``high`` count only beside others. Bright areas can be noisier than
    dark ones: ``noise`` is the gradient's noise in each range of levels of the image, and
    ``levels_dn`` what separates the ranges. Gradients are in units of ``span_dn`` per px.
    """

    ridge: RidgePixels
    high: float
    levels_dn: FloatArray
    noise: FloatArray
    span_dn: float

    @classmethod
    def of(cls, image_dn: FloatArray) -> "Gradient | None":
        """Find the ridges with Canny's suppression; None where all levels are the same."""
        boxes = _tiles(*image_dn.shape)
        scale = _Scale.of(image_dn, boxes)
        if scale is None:
            return None
        magnitude, levels_dn = _sampled(image_dn, boxes, scale)
        strongest = float(magnitude.max())
        share = _LOWEST if _is_crowded(magnitude, strongest) else _MIDDLE
        noise = _noise(magnitude, share)
        separators, noise_by_level = _noise_by_level(levels_dn, magnitude, noise, share)
        found: list[RidgePixels] = []
        for top, bottom in _strips(*image_dn.shape):
            first = max(top - _ACROSS_PX, 0)
            rows, cols = (first, bottom + _ACROSS_PX), (0, image_dn.shape[1])
            gx, gy = _gradient(image_dn, rows, cols, scale)
            squares = np.empty_like(gx)
            strongest = max(strongest, sqrt(_squares(gx, gy, squares)))
            least = _lowest(noise, strongest) ** 2
            pixels = _ridge_pixels(gx, gy, squares, (top - first, bottom - first), least)
            found.append(RidgePixels(pixels[0] + first, *pixels[1:]))
        ridge = found[0] if len(found) == 1 else RidgePixels.joined(found)
        ridge = ridge.where(ridge.strength >= _lowest(noise, strongest))
        high = _highest(noise, strongest)
        return cls(ridge, high, separators, noise_by_level, scale.span_dn)


def _highest(noise: float, strongest: float) -> float:
    """Least gradient of a ridge's strongest pixel."""
    return max(_NOISE_HIGH * noise, _LEAST_OF_STRONGEST * strongest)


def _lowest(noise: float, strongest: float) -> float:
    """Least gradient of a ridge pixel."""
    return max(_NOISE_LOW * noise, _LOW_OF_HIGH * _highest(noise, strongest))


_Box = tuple[tuple[int, int], tuple[int, int]]
"""First row and the one after the last, and the same of columns."""


def _tiles(rows: int, cols: int) -> list[_Box]:
    """Where the noise is taken: all of a small image, else tiles all over it."""
    if rows * cols <= 4 * (_TILES * _TILE_PX) ** 2 or min(rows, cols) < _TILES * _TILE_PX:
        return [((0, rows), (0, cols))]
    tops = np.linspace(0, rows - _TILE_PX, _TILES).astype(int).tolist()
    lefts = np.linspace(0, cols - _TILE_PX, _TILES).astype(int).tolist()
    return [((y, y + _TILE_PX), (x, x + _TILE_PX)) for y in tops for x in lefts]


def _strips(rows: int, cols: int) -> list[tuple[int, int]]:
    """First row of each strip, and the one after its last."""
    height = max(_STRIP_PIXELS // cols, _STRIP_ROWS)
    return [(top, min(top + height, rows)) for top in range(0, rows, height)]


@dataclass(frozen=True, slots=True)
class _Scale:
    """What is subtracted from the levels, and their span: neither overflows in 32 bits."""

    low_dn: float
    span_dn: float

    @classmethod
    def of(cls, image_dn: FloatArray, boxes: list[_Box]) -> "_Scale | None":
        """Take the scale from the boxes where they have one, else from the whole image."""
        parts = [image_dn[slice(*rows), slice(*cols)] for rows, cols in boxes]
        low_dn = min(float(part.min()) for part in parts)
        span_dn = max(float(part.max()) for part in parts) - low_dn
        if span_dn > 0 or len(boxes) == 1:
            return cls(low_dn, span_dn) if span_dn > 0 else None
        low_dn = float(image_dn.min())
        span_dn = float(image_dn.max()) - low_dn
        return cls(low_dn, span_dn) if span_dn > 0 else None


def _gradient(
    image_dn: FloatArray, rows: tuple[int, int], cols: tuple[int, int], scale: _Scale
) -> tuple[Float32Array, Float32Array]:
    """Gradient of the smoothed image along x and y in a box, as far as the image reaches."""
    top, left = max(rows[0] - _HALO_PX, 0), max(cols[0] - _HALO_PX, 0)
    part = image_dn[top : rows[1] + _HALO_PX, left : cols[1] + _HALO_PX]
    level = np.empty(part.shape, np.float32)
    np.subtract(part, scale.low_dn, out=level, casting="unsafe")
    level *= np.float32(1.0 / scale.span_dn)
    # The median takes hot pixels away and leaves edges where they are; fits see the raw image.
    smooth = np.empty_like(level)
    cv2.medianBlur(level, 3, dst=smooth)
    border = cv2.BORDER_REPLICATE
    cv2.GaussianBlur(smooth, (0, 0), SMOOTHING_PX, dst=level, borderType=border)
    cv2.Scharr(level, cv2.CV_32F, 1, 0, dst=smooth, scale=1 / 32, borderType=border)
    gy = np.empty_like(level)
    cv2.Scharr(level, cv2.CV_32F, 0, 1, dst=gy, scale=1 / 32, borderType=border)
    inner = np.s_[rows[0] - top : rows[1] - top, cols[0] - left : cols[1] - left]
    return smooth[inner], gy[inner]


def _sampled(
    image_dn: FloatArray, boxes: list[_Box], scale: _Scale
) -> tuple[Float32Array, FloatArray]:
    """Magnitude of the gradient in the boxes, and the levels there."""
    magnitudes, levels = [], []
    step = max(int(sqrt(image_dn.size / _SAMPLED_PX)), 1) if len(boxes) == 1 else 1
    for rows, cols in boxes:
        gx, gy = _gradient(image_dn, rows, cols, scale)
        magnitudes.append(np.hypot(gx[::step, ::step], gy[::step, ::step]).ravel())
        levels.append(image_dn[slice(*rows, step), slice(*cols, step)].ravel())
    return np.concatenate(magnitudes), np.concatenate(levels)


@compiled(fastmath=True)
def _squares(gx: Float32Array, gy: Float32Array, out: Float32Array) -> float:
    """Squared magnitude of the gradient into ``out``; the largest is returned."""
    largest = np.float32(0.0)
    for r in range(gx.shape[0]):
        for c in range(gx.shape[1]):
            square = gx[r, c] * gx[r, c] + gy[r, c] * gy[r, c]
            out[r, c] = square
            largest = max(largest, square)
    return float(largest)


@compiled_part()
def _at(squares: Float32Array, r: int, c: int) -> float:
    """Squared magnitude; 0 outside."""
    if r < 0 or c < 0 or r >= squares.shape[0] or c >= squares.shape[1]:
        return 0.0
    return float(squares[r, c])


@compiled_part()
def _is_ridge(squares: Float32Array, r: int, c: int, x: float, y: float) -> bool:
    """Whether the gradient (x, y) of a pixel is largest across itself (Canny 1986)."""
    if abs(y) <= _TAN_22_5 * abs(x):
        step_r, step_c = 0, 1
    elif abs(x) <= _TAN_22_5 * abs(y):
        step_r, step_c = 1, 0
    else:
        step_r, step_c = 1, 1 if x * y > 0 else -1
    here = squares[r, c]
    before, after = _at(squares, r - step_r, c - step_c), _at(squares, r + step_r, c + step_c)
    return bool(here > before and here >= after)


@compiled()
def _ridge_pixels(
    gx: Float32Array,
    gy: Float32Array,
    squares: Float32Array,
    rows: tuple[int, int],
    least: float,
) -> tuple[IntArray, IntArray, Float32Array, Float32Array, Float32Array, Float32Array]:
    """Fields of ``RidgePixels`` for the ridge pixels in some rows whose square is not below."""
    count = 0
    for r in range(rows[0], rows[1]):
        for c in range(gx.shape[1]):
            if squares[r, c] >= least and _is_ridge(squares, r, c, gx[r, c], gy[r, c]):
                count += 1
    where_r, where_c = np.empty(count, np.int64), np.empty(count, np.int64)
    x, y, shift = np.empty((3, count), np.float32)
    moments = np.zeros((count, 3), np.float32)
    i = 0
    for r in range(rows[0], rows[1]):
        for c in range(gx.shape[1]):
            if squares[r, c] < least or not _is_ridge(squares, r, c, gx[r, c], gy[r, c]):
                continue
            where_r[i], where_c[i] = r, c
            x[i], y[i] = gx[r, c], gy[r, c]
            step_c, step_r = (1, 0) if abs(x[i]) >= abs(y[i]) else (0, 1)
            before = sqrt(_at(squares, r - step_r, c - step_c))
            after = sqrt(_at(squares, r + step_r, c + step_c))
            bend = 2 * sqrt(squares[r, c]) - before - after
            # Below the pixel, by a parabola.
            shift[i] = min(max(0.5 * (after - before) / bend, -0.5), 0.5) if bend > 0 else 0.0
            steep = max(abs(x[i]), abs(y[i])) / sqrt(squares[r, c])
            reach = PROFILE_PX / steep
            for k in range(ceil(shift[i] - reach), floor(shift[i] + reach) + 1):
                square = _at(squares, r + k * step_r, c + k * step_c)
                moments[i, 0] += square
                moments[i, 1] += k * square
                moments[i, 2] += k * k * square
            i += 1
    return where_r, where_c, x, y, shift, moments


def _is_crowded(magnitude: Float32Array, strongest: float) -> bool:
    """Whether most of the gradient is that of edges, and the rest that of flat areas."""
    middle = _noise(magnitude, _MIDDLE)
    is_crowded = middle > _CROWDED * _noise(magnitude, _LOWER)
    return is_crowded and middle > _CROWDED_LEAST * strongest


def _noise(magnitude: Float32Array, share: float) -> float:
    """Standard deviation of a gradient's part by the quantile of its magnitude: Rayleigh's."""
    return float(np.quantile(magnitude, share)) / sqrt(-2 * log1p(-share))


def _noise_by_level(
    levels_dn: FloatArray, magnitude: Float32Array, overall: float, share: float
) -> tuple[FloatArray, FloatArray]:
    """Noise of the gradient in ranges of equally many levels, and what separates them."""
    separators = np.quantile(levels_dn, np.arange(1, _NOISE_RANGES) / _NOISE_RANGES)
    level_range = np.searchsorted(separators, levels_dn, side="right")
    noise = np.full(_NOISE_RANGES, overall)
    for k in range(_NOISE_RANGES):
        chosen = magnitude[level_range == k]
        if chosen.size >= _NOISE_PIXELS:
            noise[k] = _noise(chosen, share)
    # A range that holds edges and little else says nothing about the noise.
    return separators, np.clip(noise, overall, _NOISE_SPREAD * overall)
