"""Parallax to a whole pixel, along epipolar lines: census costs and semi-global matching.

H. Hirschmueller, "Stereo processing by semiglobal matching and mutual information", IEEE Trans.
PAMI 30 (2008); the census transform of R. Zabih, J. Woodfill, ECCV 1994, is the same in another
light. Here the lines go through an epipole anywhere, and both views are matched.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.parallax._views import AlignedViews
from simulation.arrays import BoolArray, Float32Array
from simulation.compiled import compiled, compiled_part

CensusCodes = NDArray[np.uint64]
Costs = NDArray[np.uint8]

_SMOOTHED_PX = 1
"""Reach of the smoothing before it."""

_CENSUS_ROWS, _CENSUS_COLS = 3, 4
"""To either side of the middle: 62 neighbours."""

_STEP_COST, _JUMP_COST = 10, 120
"""Of neighbours whose parallax differs by a pixel, and by more: each is a sum of census costs."""

_OUTSIDE_COST = 31
"""Of a place beyond the photograph: as of one that has nothing in common."""

HELD_OUT_PX, _HELD_OUT_PERIOD_PX = 8, 24
"""Side and distance of blocks that are not looked at; nor is what sees them through the census."""

_SMALL_PX = 2e5
_OFFSETS_PX = tuple((down, right) for down in (0, 8, 16) for right in (0, 8, 16))
"""Of the blocks: a small frame has few, and is matched without those at each offset in turn."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MatchedViews:
    """Parallax of either view's pixels in whole px, and of the target's held-out blocks.

    ``target, source``: towards the epipole from the target to the source, shape ``(rows, cols)``,
    each on its own pixels. ``held_out``: the target's, of which some blocks were not looked at, as
    ``is_held_out`` marks them. ``range_px``: the least parallax that was looked for, and the most.
    """

    target: Float32Array
    source: Float32Array
    held_out: Float32Array
    is_held_out: BoolArray
    range_px: tuple[int, int]


def match_views(views: AlignedViews, least_px: int, most_px: int) -> MatchedViews:
    """Match along the epipolar lines, from the least parallax to the most."""
    codes = np.stack([_census(views.target), _census(views.source)])
    shown = np.stack([views.is_target, views.is_source])
    along = np.stack([views.to_y, views.to_x])
    count = most_px - least_px + 1
    reach = np.ones(
        (2 * (_CENSUS_ROWS + _SMOOTHED_PX) + 1, 2 * (_CENSUS_COLS + _SMOOTHED_PX) + 1), np.uint8
    )
    offsets = _OFFSETS_PX if views.target.size < _SMALL_PX else _OFFSETS_PX[:1]
    blocks = [_blocks(views.target.shape, *offset) for offset in offsets]

    def of_target(left_out: BoolArray) -> Float32Array:
        seen = np.stack([views.is_target & ~left_out, views.is_source])
        return _least(_costs(codes, seen, along, least_px, count), least_px)

    def of_source() -> Float32Array:
        # From the source's pixels the target lies the other way.
        return _least(_costs(codes[::-1], shown[::-1], -along, least_px, count), least_px)

    with ThreadPoolExecutor(2) as both:
        there = both.submit(of_source)
        own = of_target(np.zeros_like(views.is_target))
        held_out = own.copy()
        for block in blocks:
            looks_there = cv2.dilate(block.astype(np.uint8), reach).astype(np.bool_)
            held_out[block] = of_target(looks_there)[block]
        return MatchedViews(
            target=own,
            source=there.result(),
            held_out=held_out,
            is_held_out=np.logical_or.reduce(blocks),
            range_px=(least_px, most_px),
        )


def _blocks(shape: tuple[int, ...], down_px: int, right_px: int) -> BoolArray:
    rows, cols = np.indices(shape)
    is_in_row = (rows - down_px) % _HELD_OUT_PERIOD_PX < HELD_OUT_PX
    return np.asarray(is_in_row & ((cols - right_px) % _HELD_OUT_PERIOD_PX < HELD_OUT_PX))


def _census(image: Float32Array) -> CensusCodes:
    """A bit for each neighbour that is brighter, shape ``(rows, cols)``."""
    smooth = np.asarray(cv2.GaussianBlur(image, (2 * _SMOOTHED_PX + 1,) * 2, 0.6), dtype=np.float32)
    top, left = _CENSUS_ROWS, _CENSUS_COLS
    padded = cv2.copyMakeBorder(smooth, top, top, left, left, cv2.BORDER_REFLECT_101)
    return _codes(np.asarray(padded, dtype=np.float32))


@compiled(nogil=True)
def _codes(padded: Float32Array) -> CensusCodes:
    rows, cols = padded.shape[0] - 2 * _CENSUS_ROWS, padded.shape[1] - 2 * _CENSUS_COLS
    codes = np.empty((rows, cols), dtype=np.uint64)
    for row in range(rows):
        for col in range(cols):
            middle = padded[row + _CENSUS_ROWS, col + _CENSUS_COLS]
            code = np.uint64(0)
            for j in range(2 * _CENSUS_ROWS + 1):
                for i in range(2 * _CENSUS_COLS + 1):
                    if j == _CENSUS_ROWS and i == _CENSUS_COLS:
                        continue
                    code = code << np.uint64(1)
                    if padded[row + j, col + i] > middle:
                        code |= np.uint64(1)
            codes[row, col] = code
    return codes


@compiled_part()
def _bits(code: np.uint64) -> np.uint64:
    """Number of bits that are set, by the parallel sums of H. Warren, "Hacker's Delight"."""
    pairs = code - ((code >> np.uint64(1)) & np.uint64(0x5555555555555555))
    fours = (pairs & np.uint64(0x3333333333333333)) + (
        (pairs >> np.uint64(2)) & np.uint64(0x3333333333333333)
    )
    bytes_ = (fours + (fours >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (bytes_ * np.uint64(0x0101010101010101)) >> np.uint64(56)


@compiled(nogil=True)
def _costs(
    codes: CensusCodes, shown: BoolArray, along: Float32Array, least_px: int, count: int
) -> Costs:
    """Neighbours that differ, at each parallax, shape ``(rows, cols, count)``.

    ``codes, shown``: of a view and of the other one, shape ``(2, rows, cols)``. ``along``: its
    lines, ``(y, x)``.
    """
    rows, cols = codes.shape[1:]
    costs = np.full((rows, cols, count), _OUTSIDE_COST, dtype=np.uint8)
    for row in range(rows):
        for col in range(cols):
            if not shown[0, row, col]:
                continue
            for k in range(count):
                y = int(np.floor(row + (least_px + k) * along[0, row, col] + 0.5))
                x = int(np.floor(col + (least_px + k) * along[1, row, col] + 0.5))
                if 0 <= y < rows and 0 <= x < cols and shown[1, y, x]:
                    costs[row, col, k] = _bits(codes[0, row, col] ^ codes[1, y, x])
    return costs


_PATHS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Each is gone both ways."""


def _least(costs: Costs, least_px: int) -> Float32Array:
    """Parallax of least cost, over eight paths to each pixel."""
    total = np.zeros(costs.shape, dtype=np.uint16)
    for down, right in _PATHS:
        _add_path(costs, total, down, right)
        _add_path(costs[::-1, ::-1], total[::-1, ::-1], down, right)
    return np.asarray(total.argmin(axis=2) + least_px, dtype=np.float32)


@compiled(nogil=True)
def _add_path(costs: Costs, total: NDArray[np.uint16], down: int, right: int) -> None:
    """Add the costs of paths that come from one direction."""
    rows, cols, count = costs.shape
    # One line of paths before this, and this; each with its least cost.
    before = np.zeros((cols, count), dtype=np.int32)
    now = np.zeros((cols, count), dtype=np.int32)
    for row in range(rows):
        for step in range(cols):
            col = step if right >= 0 else cols - 1 - step
            j, i = row - down, col - right
            if j < 0 or i < 0 or i >= cols:
                for k in range(count):
                    now[col, k] = costs[row, col, k]
                    total[row, col, k] += np.uint16(costs[row, col, k])
                continue
            last = now[i] if down == 0 else before[i]
            least = last[0]
            for k in range(1, count):
                least = min(least, last[k])
            jump = least + _JUMP_COST
            for k in range(count):
                come = min(last[k], jump)
                if k > 0:
                    come = min(come, last[k - 1] + _STEP_COST)
                if k + 1 < count:
                    come = min(come, last[k + 1] + _STEP_COST)
                path = costs[row, col, k] + come - least
                now[col, k] = path
                total[row, col, k] += np.uint16(path)
        before, now = now, before
