"""Ridges of an image's gradient, found strip by strip and grouped into regions with a line each.

An image is never copied as a whole: memory that is touched for the first time costs more than the
filters do. What is kept are the ridge pixels, each with what a line through it needs.

The loops are compiled: an image has hundreds of regions of a hundred pixels each, and numpy's cost
per call would be most of the time. ``benchmarks/speed/edge_fit.py`` shows what that gains.
"""

from dataclasses import dataclass
from math import atan2, ceil, cos, floor, log1p, pi, sin, sqrt
from typing import NamedTuple

import cv2
import numpy as np

from calibration.edges._segments import ROUNDED_PX, EdgeLine
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

    ``shift`` is where the ridge lies beside the pixel, along the axis nearer to the gradient;
    ``moments``, shape ``(n, 3)``, sum squared gradients along it times 1, the offset, its square.
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
    """Ridges of an image's gradient, in units of ``span_dn`` per px.

    Ridge pixels weaker than ``high`` count only beside others; ``noise`` is the gradient's in each
    range of levels, which ``levels_dn`` separate.
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


SHORTEST_REGION_PX = 8
_NOISE_MEAN, _NOISE_SOLID = 4.0, 8.0  # of a region's mean gradient
_DIRECTION_COSINE = cos(pi / 8)
_SMALLEST_NEIGHBOUR_PX, _FAINT_NEIGHBOUR_PX = 6, 16
_LARGEST_SAGITTA = 0.02  # of the length: a bend the fit's curvature takes up
_ROUGHEST_PX = 0.7  # rms distance of the ridge from its line
_LINE_BAND_PX = 1.5  # a ridge's pixels are nearer to its line
_LINE_ROUNDS = 3


class ArtefactGradient(NamedTuple):
    """Gradient that a compression makes by itself, DN per px at each of rising ``levels_dn``."""

    levels_dn: FloatArray
    dn_per_px: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Ridges:
    """Lines through the ridges of an image, and the ridge pixels.

    ``lines`` has a row per straight region: middle x and y (px), angle of the normal from dark to
    bright (rad) and length (px). ``points`` holds x and y of all but specks of noise.
    """

    lines: FloatArray
    points: FloatArray
    pixels: RidgePixels


def find_ridges(
    gradient: Gradient, image_dn: FloatArray, artefacts: ArtefactGradient | None = None
) -> _Ridges:
    """Group the ridge pixels into regions and put a line through each that is no artefact."""
    found = gradient.ridge
    height = image_dn.shape[0]
    is_strong = found.strength >= gradient.high
    pixels = found.where(
        _beside_strong(found.rows, found.cols, _first_of(found, height), is_strong)
    )
    members, starts = _regions(
        pixels.rows, pixels.cols, _first_of(pixels, height), pixels.x, pixels.y
    )
    sizes = np.diff(starts)
    if sizes.size == 0:
        return _Ridges(np.empty((0, 4)), np.empty((0, 2)), pixels)
    level_dn = image_dn[pixels.rows[members], pixels.cols[members]]
    level_dn = np.add.reduceat(level_dn, starts[:-1]) / sizes
    noise = gradient.noise[np.searchsorted(gradient.levels_dn, level_dn, side="right")]
    strength = np.add.reduceat(pixels.strength[members], starts[:-1]) / sizes
    least = np.zeros(sizes.size)
    if artefacts is not None:
        least = np.interp(level_dn, artefacts.levels_dn, artefacts.dn_per_px) / gradient.span_dn
    is_real = strength >= np.maximum(_NOISE_MEAN * noise, least)
    gradient_of = pixels.x, pixels.y, pixels.shift
    lines = _lines(pixels.rows, pixels.cols, gradient_of, members, starts, is_real)
    # Noise beside a faint edge makes short, faint ridges; only what is neither spoils a fit.
    is_solid = (sizes >= _SMALLEST_NEIGHBOUR_PX) & (strength >= _NOISE_SOLID * noise)
    is_solid &= strength >= least
    is_solid |= (sizes >= _FAINT_NEIGHBOUR_PX) & is_real
    solid = np.sort(members[np.repeat(is_solid, sizes)])
    points = np.column_stack([pixels.cols[solid], pixels.rows[solid]]).astype(np.float64)
    return _Ridges(lines, points, pixels)


def _first_of(pixels: RidgePixels, height: int) -> IntArray:
    """Index of the first pixel of each row, and the number of all."""
    return np.searchsorted(pixels.rows, np.arange(height + 1))


@compiled_part()
def _first_near(cols: IntArray, first_of: IntArray, row: int, col: int) -> tuple[int, int]:
    """First index in a row that is not left of ``col``, and the row's end."""
    if row < 0 or row >= len(first_of) - 1:
        return 0, 0
    low, end = first_of[row], first_of[row + 1]
    high = end
    while low < high:
        middle = (low + high) // 2
        if cols[middle] < col:
            low = middle + 1
        else:
            high = middle
    return low, end


@compiled()
def _beside_strong(
    rows: IntArray, cols: IntArray, first_of: IntArray, is_strong: BoolArray
) -> BoolArray:
    """Which pixels are strong or connected with one that is (Canny's hysteresis)."""
    kept = is_strong.copy()
    waiting = np.empty(len(rows), np.int64)
    count = 0
    for i in range(len(rows)):
        if is_strong[i]:
            waiting[count] = i
            count += 1
    while count:
        count -= 1
        i = waiting[count]
        for row in range(rows[i] - 1, rows[i] + 2):
            j, end = _first_near(cols, first_of, row, cols[i] - 1)
            while j < end and cols[j] <= cols[i] + 1:
                if not kept[j]:
                    kept[j] = True
                    waiting[count] = j
                    count += 1
                j += 1
    return kept


@compiled()
def _regions(
    rows: IntArray, cols: IntArray, first_of: IntArray, gx: Float32Array, gy: Float32Array
) -> tuple[IntArray, IntArray]:
    """Connected ridge pixels of like gradient: indices, region by region, and where each starts."""
    total = len(rows)
    taken = np.zeros(total, np.bool_)
    members = np.empty(total, np.int64)
    starts = np.empty(total + 1, np.int64)
    filled = count = 0
    for seed in range(total):
        if taken[seed]:
            continue
        starts[count] = filled
        count += 1
        taken[seed] = True
        members[filled] = seed
        looked_at = filled
        filled += 1
        sum_x = sum_y = 0.0
        while looked_at < filled:
            i = members[looked_at]
            looked_at += 1
            norm = max(sqrt(gx[i] ** 2 + gy[i] ** 2), 1e-30)
            sum_x += gx[i] / norm
            sum_y += gy[i] / norm
            for row in range(rows[i] - 1, rows[i] + 2):
                j, end = _first_near(cols, first_of, row, cols[i] - 1)
                while j < end and cols[j] <= cols[i] + 1:
                    if not taken[j]:
                        x, y = gx[j], gy[j]
                        along = x * sum_x + y * sum_y
                        norms = (x * x + y * y) * (sum_x * sum_x + sum_y * sum_y)
                        if along > 0 and along * along >= _DIRECTION_COSINE**2 * norms:
                            taken[j] = True
                            members[filled] = j
                            filled += 1
                    j += 1
    starts[count] = filled
    return members, starts[: count + 1]


@compiled()
def _lines(
    rows: IntArray,
    cols: IntArray,
    gradient: tuple[Float32Array, Float32Array, Float32Array],
    members: IntArray,
    starts: IntArray,
    is_real: BoolArray,
) -> FloatArray:
    """Lines of the straight ones of the regions; ``gradient`` is x, y and the ridge's shift."""
    lines = np.empty((len(starts), 4))
    count = 0
    for k in range(len(starts) - 1):
        first, last = starts[k], starts[k + 1]
        if last - first < SHORTEST_REGION_PX or not is_real[k]:
            continue
        line, is_straight = _line(rows, cols, gradient, members[first:last])
        if is_straight:
            for i in range(4):
                lines[count, i] = line[i]
            count += 1
    return lines[:count]


@compiled_part()
def _line(
    rows: IntArray,
    cols: IntArray,
    gradient: tuple[Float32Array, Float32Array, Float32Array],
    members: IntArray,
) -> tuple[tuple[float, float, float, float], bool]:
    """Line through a region's pixels: middle x, y, normal, length; whether they lie along it."""
    none = (0.0, 0.0, 0.0, 0.0)
    gx, gy, shifts = gradient
    n = len(members)
    x, y, weight = np.empty(n), np.empty(n), np.empty(n)
    sum_x = sum_y = 0.0
    for i in range(n):
        k = members[i]
        dx, dy = gx[k], gy[k]
        sum_x += dx
        sum_y += dy
        weight[i] = dx * dx + dy * dy
        x[i], y[i] = cols[k], rows[k]
        if abs(dx) >= abs(dy):
            x[i] += shifts[k]
        else:
            y[i] += shifts[k]
    normal = atan2(sum_y, sum_x)
    cx, cy = x.mean(), y.mean()
    kept, away = np.ones(n, np.bool_), np.empty(n)
    for _ in range(_LINE_ROUNDS):
        along, across = _projected(x, y, cx, cy, normal)
        slope, shift = _weighted_line(along, across, weight, kept)
        if not np.isfinite(slope):
            return none, False
        cx += shift * cos(normal)
        cy += shift * sin(normal)
        normal -= np.arctan(slope)
        # The ridge runs around a corner for its last pixels: they are not part of this line.
        for i in range(n):
            away[i] = abs(across[i] - slope * along[i] - shift)
        limit = max(_ROUGHEST_PX, 2.5 * np.median(away))
        for i in range(n):
            kept[i] = away[i] <= limit
    along, across = _projected(x, y, cx, cy, normal)
    along, across = along[kept], across[kept]
    if len(along) < max(SHORTEST_REGION_PX, 0.6 * n):
        return none, False
    low, high = along.min(), along.max()
    length = high - low
    if not _is_straight(along, across, length):
        # Pixels that turn with a corner within the distance kept above bend a short ridge.
        inner = 0
        for i in range(len(along)):
            if low + ROUNDED_PX <= along[i] <= high - ROUNDED_PX:
                along[inner], across[inner] = along[i], across[i]
                inner += 1
        if inner < SHORTEST_REGION_PX or not _is_straight(along[:inner], across[:inner], length):
            return none, False
    middle = 0.5 * (low + high)
    return (cx - middle * sin(normal), cy + middle * cos(normal), normal, length + 1), True


@compiled_part()
def _projected(
    x: FloatArray, y: FloatArray, cx: float, cy: float, normal: float
) -> tuple[FloatArray, FloatArray]:
    """Coordinates of points along a line and across it, from (cx, cy)."""
    c, s = cos(normal), sin(normal)
    along, across = np.empty(len(x)), np.empty(len(x))
    for i in range(len(x)):
        along[i] = -s * (x[i] - cx) + c * (y[i] - cy)
        across[i] = c * (x[i] - cx) + s * (y[i] - cy)
    return along, across


@compiled_part()
def _weighted_line(
    along: FloatArray, across: FloatArray, weight: FloatArray, kept: BoolArray
) -> tuple[float, float]:
    """Slope and value at 0 of the line through what is kept; NaN where that is too short."""
    w = wt = wa = wtt = wta = 0.0
    first, last, count = np.inf, -np.inf, 0
    for i in range(len(along)):
        if kept[i]:
            t, a = along[i], across[i]
            w += weight[i]
            wt += weight[i] * t
            wa += weight[i] * a
            wtt += weight[i] * t * t
            wta += weight[i] * t * a
            first, last, count = min(first, t), max(last, t), count + 1
    spread = w * wtt - wt * wt
    if count < SHORTEST_REGION_PX or last - first < SHORTEST_REGION_PX - 1 or not spread > 0:
        return np.nan, np.nan
    slope = (w * wta - wt * wa) / spread
    return slope, (wa - slope * wt) / w


@compiled_part()
def _is_straight(along: FloatArray, across: FloatArray, length: float) -> bool:
    """Whether points lie along a line so long with a bend that a fit takes up, and no more."""
    bend, rough = _parabola(along, across)
    sagitta = abs(bend) * length**2 / 4
    return bool(rough <= _ROUGHEST_PX and sagitta <= max(_LARGEST_SAGITTA * length, 0.5))


@compiled_part()
def _parabola(along: FloatArray, across: FloatArray) -> tuple[float, float]:
    """Second-order coefficient of the parabola through the points, and their rms distance."""
    scale = max(np.abs(along).max(), 1.0)
    mean, level = along.mean() / scale, across.mean()
    # Two more polynomials that are orthogonal over the points to the constant and to each other.
    linear, parabola = np.empty(len(along)), np.empty(len(along))
    squares = cubes = sloped = 0.0
    for i in range(len(along)):
        t = along[i] / scale - mean
        linear[i] = t
        squares += t * t
        cubes += t * t * t
        sloped += t * across[i]
    fourths = bent = 0.0
    for i in range(len(along)):
        parabola[i] = linear[i] * (linear[i] - cubes / squares) - squares / len(along)
        fourths += parabola[i] * parabola[i]
        bent += parabola[i] * across[i]
    rest = 0.0
    for i in range(len(along)):
        fitted = level + sloped / squares * linear[i] + bent / fourths * parabola[i]
        rest += (across[i] - fitted) ** 2
    return bent / fourths / scale**2, sqrt(rest / len(along))


@compiled()
def refined(
    rows: IntArray,
    cols: IntArray,
    gradient: tuple[Float32Array, Float32Array, Float32Array],
    line: EdgeLine,
) -> tuple[EdgeLine, float]:
    """Line through the gradient along a line, weighted with its square.

    The variance is that of the squared gradient across it in px^2, -1 where there is none.
    """
    gx, gy, moments = gradient
    x_px, y_px, reach_px = line.x_px, line.y_px, line.half_length_px
    c, s = cos(line.normal_rad), sin(line.normal_rad)
    w = wt = wa = wtt = wta = waa = 0.0
    reach_x, reach_y = reach_px * abs(s) + 2, reach_px * abs(c) + 2
    for i in range(np.searchsorted(rows, int(y_px - reach_y)), len(rows)):
        if rows[i] > y_px + reach_y:
            break
        dx, dy = cols[i] - x_px, rows[i] - y_px
        if abs(dx) > reach_x:
            continue
        a, t = c * dx + s * dy, -s * dx + c * dy
        if abs(a) > _LINE_BAND_PX or abs(t) > reach_px or c * gx[i] + s * gy[i] <= 0:
            continue
        # A step along the axis nearer to the gradient goes so far across and along.
        step_a, step_t = (c, -s) if abs(gx[i]) >= abs(gy[i]) else (s, c)
        m0, m1, m2 = moments[i, 0], moments[i, 1], moments[i, 2]
        w += m0
        wt += m0 * t + m1 * step_t
        wa += m0 * a + m1 * step_a
        wtt += m0 * t * t + 2 * m1 * t * step_t + m2 * step_t * step_t
        wta += m0 * t * a + m1 * (t * step_a + a * step_t) + m2 * step_t * step_a
        waa += m0 * a * a + 2 * m1 * a * step_a + m2 * step_a * step_a
    spread = w * wtt - wt * wt
    if not spread > 0:
        return line, -1.0
    turn = (w * wta - wt * wa) / spread
    shift = (wa - turn * wt) / w
    variance = (waa - turn * wta - shift * wa) / w
    normal_rad = line.normal_rad - np.arctan(turn)
    return EdgeLine(x_px + shift * c, y_px + shift * s, normal_rad, reach_px), variance
