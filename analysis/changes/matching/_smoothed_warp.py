"""A photograph smoothed by a Gaussian, as the pixels of another one see it; noise of pixels.

Smoothing and the prefilter of the quintic B-spline are one separable filter on the photograph's own
pixels; the spline is then evaluated where the pose puts the pixels of the other photograph. Their
positions come from a coarse grid by cubic interpolation: a pose is far smoother than that.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil
from typing import Self

import cv2
import numpy as np
from scipy.ndimage import median_filter

from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray
from simulation.compiled import compiled, compiled_part

_SEED = 20
"""The same pixels every time: a comparison has the same result whenever it is made."""

_FINEST = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32) / 6
"""Passes the finest detail, along both axes at once, of which a lens leaves little; white noise
keeps its variance.

J. Immerkaer, "Fast noise variance estimation", Computer Vision and Image Understanding 64 (1996).
"""

_STEP = 2
"""Pixels from one to the next of those that the noise is told by."""


def away_from(mask: BoolArray, distance_px: float) -> BoolArray:
    """Pixels further than this from all of a mask."""
    if not mask.any():
        return np.ones(mask.shape, dtype=np.bool_)
    apart = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    return np.asarray(apart > distance_px)


def sampled(mask: BoolArray, count: int) -> tuple[IntArray, IntArray]:
    """Rows and columns of a mask's pixels: of all, or of about so many at random."""
    total = int(np.count_nonzero(mask))
    if total <= count:
        rows, cols = np.nonzero(mask)
        return rows, cols
    rng = np.random.default_rng(_SEED)
    drawn = rng.integers(0, mask.size, round(count * mask.size / total))
    drawn = drawn[mask.ravel()[drawn]]
    rows, cols = np.divmod(drawn, mask.shape[1])
    return rows, cols


def pixel_noise_dn(image: Float32Array, counts: BoolArray | None = None) -> float:
    """Standard deviation of the noise that single pixels show, of those that count."""
    finest = finest_detail(image)[::_STEP, ::_STEP]
    if counts is None:
        return robust_sigma(finest)
    kept = counts[::_STEP, ::_STEP]
    return robust_sigma(finest[kept]) if kept.any() else 0.0


def finest_detail(image: Float32Array) -> Float32Array:
    """What both axes show at once of the finest detail; white noise keeps its variance."""
    return np.asarray(cv2.filter2D(image, -1, _FINEST), dtype=np.float32)


def light_at_first(source: FloatArray, target: FloatArray) -> tuple[float, float]:
    """Gain and offset that give levels the quartiles of others, for a robust fit to begin with."""
    (low, middle, high), (own_low, own_middle, own_high) = (
        np.percentile(levels, [25, 50, 75]).tolist() for levels in (source, target)
    )
    gain = (own_high - own_low) / (high - low) if high > low and own_high > own_low else 1.0
    return gain, own_middle - gain * middle


_LEAST_LEVELS, _MOST_LEVELS = 32, 1024
"""Distinct levels of a photograph that was stored in 8 bits or so; a chart without noise has fewer,
one from colours or means of frames more."""

_NEIGHBOURS = 5
"""Steps between levels of which the median counts: one of two that no pixel has does not matter."""

_SAMPLE_PX = 250_000


def rounding_variance(image_dn: Float32Array) -> Float32Array | None:
    """Twelfth of the squared step between the levels around each pixel's; None if it is unknown.

    Decoded from a tone curve, the steps of a file's integers differ from level to level.
    ``image_dn``: shape ``(rows, cols)``.
    """
    stride = max(round((image_dn.size / _SAMPLE_PX) ** 0.5), 1)
    levels = np.unique(image_dn[::stride, ::stride])
    if not _LEAST_LEVELS <= len(levels) <= _MOST_LEVELS:
        return None
    steps = median_filter(np.diff(levels), _NEIGHBOURS, mode="nearest")
    middles = (levels[1:] + levels[:-1]) / 2
    # A table, since interpolation in levels of uneven steps is slow for every pixel.
    table = np.linspace(float(levels[0]), float(levels[-1]), 8 * _MOST_LEVELS)
    variance = (np.interp(table, middles, steps) ** 2 / 12).astype(np.float32)
    scale = np.float32((len(table) - 1) / (table[-1] - table[0]))
    index = np.clip((image_dn - np.float32(table[0])) * scale, 0, len(table) - 1)
    return np.asarray(variance[np.rint(index).astype(np.int32)])


Window = tuple[slice, slice]
"""Rows and columns of a part of the grid."""

_NODE_STEP_PX = 16
_SPLINE_TERMS = 8
"""The prefilter of the quintic B-spline decays by 0.43 a pixel: to 1e-3 of a Gaussian's end."""

_TAILS = 4.5
_FAR_FRAMES = 4.0
"""Frames beyond the photograph at which a node is taken as one that it cannot show."""


def smoothed(image: Float32Array, sigma_px: float) -> Float32Array:
    """Convolve with a Gaussian; mirrored at the border."""
    size = 2 * ceil(_TAILS * sigma_px) + 1
    blurred = cv2.GaussianBlur(image, (size, size), sigma_px, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(blurred, dtype=np.float32)


def spline_coefficients(image: Float32Array, sigma_px: float) -> Float32Array:
    """Coefficients of the quintic B-spline through the photograph smoothed by ``sigma_px``."""
    radius = ceil(_TAILS * sigma_px) + _SPLINE_TERMS
    freq = np.fft.rfftfreq(8 * radius)
    angle = 2 * np.pi * freq
    spline = (66 + 52 * np.cos(angle) + 2 * np.cos(2 * angle)) / 120  # at whole pixels
    taps = np.fft.irfft(np.exp(-((sigma_px * angle) ** 2) / 2) / spline)
    kernel = np.concatenate([taps[-radius:], taps[: radius + 1]])
    kernel = (kernel / kernel.sum()).astype(np.float32)
    filtered = cv2.sepFilter2D(image, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(filtered, dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PixelPositions:
    """Where the pixels of a grid lie in another photograph.

    ``shape, source_shape``: ``(rows, cols)`` of the grid and of the other photograph. ``nodes_y,
    nodes_x``: positions of a coarse grid of pixels, whose first node is one step before the first
    pixel. ``whole_shift``: ``(rows, cols)`` by which each pixel lies further on in the other
    photograph, where all are such numbers of pixels: then nothing is interpolated. ``at_y, at_x``:
    positions of every pixel, where the scene has depth; the nodes are then those of its plane.
    """

    shape: tuple[int, int]
    source_shape: tuple[int, int]
    nodes_y: FloatArray
    nodes_x: FloatArray
    whole_shift: tuple[int, int] | None = None
    at_y: Float32Array | None = None
    at_x: Float32Array | None = None

    @classmethod
    def of(
        cls,
        positions_px: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]],
        shape: tuple[int, int],
        source_shape: tuple[int, int],
    ) -> Self:
        """Evaluate ``positions_px``, which takes and returns ``(y, x)``, on the coarse grid."""
        y, x = (_NODE_STEP_PX * np.arange(-1.0, ceil(n / _NODE_STEP_PX) + 2) for n in shape)
        nodes_y, nodes_x = positions_px(*np.meshgrid(y, x, indexing="ij"))
        far = _FAR_FRAMES * max(source_shape)
        is_far = ~((np.abs(nodes_y) < far) & (np.abs(nodes_x) < far))
        return cls(
            shape=shape,
            source_shape=source_shape,
            nodes_y=np.where(is_far, np.nan, nodes_y),
            nodes_x=np.where(is_far, np.nan, nodes_x),
            whole_shift=_whole_shift(nodes_y - y[:, None], nodes_x - x),
        )

    def with_depth(
        self, positions_px: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
    ) -> Self:
        """Return these positions of a plane with those of every pixel beside it."""
        y, x = np.meshgrid(*map(np.arange, map(float, self.shape)), indexing="ij")
        at_y, at_x = (at.astype(np.float32) for at in positions_px(y, x))
        return replace(self, whole_shift=None, at_y=at_y, at_x=at_x)

    @property
    def zoom(self) -> float:
        """Median number of the other photograph's pixels to one of the grid, along a line."""
        step = float(_NODE_STEP_PX)
        (yy, yx), (xy, xx) = (np.gradient(nodes, step) for nodes in (self.nodes_y, self.nodes_x))
        return float(np.sqrt(np.nanmedian(np.abs(yy * xx - yx * xy))))

    def near(self, row: float, col: float) -> tuple[float, float, FloatArray]:
        """Position (y, x) of a pixel, and the derivative there, shape (2, 2), order (x, y)."""
        j, i = (
            min(max(round(at / _NODE_STEP_PX) + 1, 1), n - 2)
            for at, n in zip((row, col), self.nodes_y.shape, strict=True)
        )
        if self.at_y is not None and self.at_x is not None:
            own = (round(row), round(col))
            at_y, at_x = float(self.at_y[own]), float(self.at_x[own])
        else:
            at_y, at_x = float(self.nodes_y[j, i]), float(self.nodes_x[j, i])
        slopes = np.array(
            [
                [nodes[j, i + 1] - nodes[j, i - 1], nodes[j + 1, i] - nodes[j - 1, i]]
                for nodes in (self.nodes_x, self.nodes_y)
            ]
        )
        return at_y, at_x, slopes / (2 * _NODE_STEP_PX)

    @property
    def whole(self) -> Window:
        """The window of all pixels."""
        return slice(0, self.shape[0]), slice(0, self.shape[1])

    def coefficients(self, image: Float32Array, sigma_px: float) -> Float32Array:
        """What ``seen`` takes to show a photograph that is smoothed by ``sigma_px``."""
        if self.whole_shift is None:
            return spline_coefficients(image, sigma_px)
        return smoothed(image, sigma_px) if sigma_px > 0 else image

    def seen(self, coefficients: Float32Array, window: Window | None = None) -> Float32Array:
        """Levels that the pixels of a window see; NaN where they look past the photograph."""
        rows, cols = window or self.whole
        if self.whole_shift is not None:
            return _cut_out(coefficients, rows, cols, self.whole_shift)
        if self.at_y is not None and self.at_x is not None:
            return _seen_at(coefficients, self.at_y[rows, cols], self.at_x[rows, cols])
        corner = np.array([rows.start, cols.start, rows.stop, cols.stop])
        return _seen(coefficients, self.nodes_y, self.nodes_x, corner)

    def inside(self, mask: BoolArray, border_px: float) -> BoolArray:
        """Pixels that see the photograph, this far from its border, and a pixel of the mask."""
        if self.at_y is not None and self.at_x is not None:
            return _inside_at(mask, self.at_y, self.at_x, border_px)
        return _inside(mask, self.nodes_y, self.nodes_x, np.array(self.shape), border_px)


def _whole_shift(further_y: FloatArray, further_x: FloatArray) -> tuple[int, int] | None:
    """The shift, if it is the same everywhere and of whole pixels."""
    y, x = float(further_y.flat[0]), float(further_x.flat[0])
    if not (y.is_integer() and x.is_integer()):
        return None
    is_same = np.all(further_y == y) and np.all(further_x == x)
    return (int(y), int(x)) if is_same else None


def _cut_out(image: Float32Array, rows: slice, cols: slice, shift: tuple[int, int]) -> Float32Array:
    """A window of the photograph, moved; NaN beyond its border."""
    cut = np.full((rows.stop - rows.start, cols.stop - cols.start), np.nan, dtype=np.float32)
    own, there = [], []
    for part, by, size in zip((rows, cols), shift, image.shape, strict=True):
        first, last = max(part.start + by, 0), min(part.stop + by, size)
        there.append(slice(first, max(last, first)))
        own.append(slice(first - by - part.start, max(last, first) - by - part.start))
    cut[tuple(own)] = image[tuple(there)]
    return cut


@compiled_part()
def _cubic(t: float, weight: FloatArray) -> None:
    """Lagrange's weights of four nodes, of which the second is at 0."""
    weight[0] = -t * (t - 1) * (t - 2) / 6
    weight[1] = (t + 1) * (t - 1) * (t - 2) / 2
    weight[2] = -(t + 1) * t * (t - 2) / 2
    weight[3] = (t + 1) * t * (t - 1) / 6


@compiled_part()
def _weights_in_cell() -> FloatArray:
    table = np.empty((_NODE_STEP_PX, 4))
    for step in range(_NODE_STEP_PX):
        _cubic(step / _NODE_STEP_PX, table[step])
    return table


@compiled_part()
def _node_row(nodes: FloatArray, row: int, table: FloatArray, out: FloatArray) -> None:
    first, weight = row // _NODE_STEP_PX, table[row % _NODE_STEP_PX]
    for col in range(nodes.shape[1]):
        total = 0.0
        for k in range(4):
            total += weight[k] * nodes[first + k, col]
        out[col] = total


@compiled_part()
def _between(nodes: FloatArray, col: int, table: FloatArray) -> float:
    first, weight = col // _NODE_STEP_PX, table[col % _NODE_STEP_PX]
    return float(
        weight[0] * nodes[first]
        + weight[1] * nodes[first + 1]
        + weight[2] * nodes[first + 2]
        + weight[3] * nodes[first + 3]
    )


@compiled_part()
def _quintic(t: float, weight: Float32Array) -> None:
    """Quintic B-spline around a position ``t`` after the third of six samples."""
    near_one = np.float32(t)
    for side in range(2):
        u = (
            near_one if side == 0 else np.float32(1.0) - near_one
        )  # distance to the nearest on this side
        near, outer, last = (2, 1, 0) if side == 0 else (3, 4, 5)
        square, w, rest = u * u, np.float32(1.0) + u, np.float32(1.0) - u
        fourth = rest * rest * rest * rest
        weight[near] = np.float32(1 / 120) * (
            np.float32(66.0)
            + square * (np.float32(-60.0) + square * (np.float32(30.0) - np.float32(10.0) * u))
        )
        powers = np.float32(150.0) + w * (np.float32(-45.0) + np.float32(5.0) * w)
        powers = np.float32(75.0) + w * (np.float32(-210.0) + w * powers)
        weight[outer] = np.float32(1 / 120) * (np.float32(51.0) + w * powers)
        weight[last] = np.float32(1 / 120) * rest * fourth


@compiled_part()
def _level_at(
    coefficients: Float32Array, y: float, x: float, across: Float32Array, down: Float32Array
) -> np.float32:
    """Level between pixels; NaN past the photograph. The last two are room for weights."""
    rows, cols = coefficients.shape
    # Written so that NaN is outside.
    if not (y >= 2 and y < rows - 3 and x >= 2 and x < cols - 3):
        return np.float32(np.nan)
    j, i = int(y), int(x)
    _quintic(y - j, down)
    _quintic(x - i, across)
    level = np.float32(0.0)
    for k in range(6):
        line = coefficients[j + k - 2]
        level += down[k] * (
            across[0] * line[i - 2]
            + across[1] * line[i - 1]
            + across[2] * line[i]
            + across[3] * line[i + 1]
            + across[4] * line[i + 2]
            + across[5] * line[i + 3]
        )
    return level


@compiled(nogil=True)
def _seen_at(coefficients: Float32Array, at_y: Float32Array, at_x: Float32Array) -> Float32Array:
    levels = np.empty(at_y.shape, dtype=np.float32)
    across, down = np.empty(6, dtype=np.float32), np.empty(6, dtype=np.float32)
    for row in range(at_y.shape[0]):
        for col in range(at_y.shape[1]):
            levels[row, col] = _level_at(
                coefficients, float(at_y[row, col]), float(at_x[row, col]), across, down
            )
    return levels


@compiled_part()
def _is_marked(mask: BoolArray, y: float, x: float, border_px: float) -> bool:
    """Whether a place is this far from the border, and its pixel in the mask; NaN is not."""
    rows, cols = mask.shape
    if not (border_px <= y <= rows - 1 - border_px and border_px <= x <= cols - 1 - border_px):
        return False
    return bool(mask[int(y + 0.5), int(x + 0.5)])


@compiled(nogil=True)
def _inside_at(
    mask: BoolArray, at_y: Float32Array, at_x: Float32Array, border_px: float
) -> BoolArray:
    found = np.zeros(at_y.shape, dtype=np.bool_)
    for row in range(at_y.shape[0]):
        for col in range(at_y.shape[1]):
            y, x = at_y[row, col], at_x[row, col]
            found[row, col] = _is_marked(mask, y, x, border_px)
    return found


@compiled(nogil=True)
def _seen(
    coefficients: Float32Array, nodes_y: FloatArray, nodes_x: FloatArray, corner: FloatArray
) -> Float32Array:
    top, left, bottom, right = corner
    levels = np.empty((bottom - top, right - left), dtype=np.float32)
    table = _weights_in_cell()
    line_y, line_x = np.empty(nodes_y.shape[1]), np.empty(nodes_y.shape[1])
    across, down = np.empty(6, dtype=np.float32), np.empty(6, dtype=np.float32)
    for row in range(top, bottom):
        _node_row(nodes_y, row, table, line_y)
        _node_row(nodes_x, row, table, line_x)
        for col in range(left, right):
            y, x = _between(line_y, col, table), _between(line_x, col, table)
            levels[row - top, col - left] = _level_at(coefficients, y, x, across, down)
    return levels


@compiled(nogil=True)
def _inside(
    mask: BoolArray, nodes_y: FloatArray, nodes_x: FloatArray, shape: FloatArray, border_px: float
) -> BoolArray:
    found = np.zeros((shape[0], shape[1]), dtype=np.bool_)
    table = _weights_in_cell()
    line_y, line_x = np.empty(nodes_y.shape[1]), np.empty(nodes_y.shape[1])
    for row in range(shape[0]):
        _node_row(nodes_y, row, table, line_y)
        _node_row(nodes_x, row, table, line_x)
        for col in range(shape[1]):
            y, x = _between(line_y, col, table), _between(line_x, col, table)
            found[row, col] = _is_marked(mask, y, x, border_px)
    return found
