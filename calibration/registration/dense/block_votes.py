"""Blocks of a photograph looked for in the other one around the place where a pose puts them.

A pose that follows a few strong outlines, or that chance made agree in part of the overlap, leaves
blocks that are plainly somewhere else. Noise and changes hide blocks, and move none.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from calibration.registration.dense.agreement import compared_at
from calibration.registration.dense.photograph import AlignedPhotograph
from calibration.registration.distorted_pose import DistortedPose
from simulation.arrays import BoolArray, Float32Array, FloatArray

_LONG_SIDE_PX = 400
_BLOCK_PX = 32
_REACH_PX = 16
"""Of the coarser photograph, reduced; side of a block, and how far it is looked for."""

_LEAST_SHARE = 0.9
_LEAST_DETAIL = 0.1
"""Share of a block in the overlap, and its mean square beside that of the normalised photograph."""

_RECOGNISED = 0.6
"""Correlation of a block from which it is recognised."""

_AS_WELL = 0.95
_PLACE_PX = 1.5
"""A block is in its place if its best place is so near, or the best of the next pixels so good."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BlockVotes:
    """Blocks that are recognised where a pose puts them, and elsewhere."""

    here: int
    elsewhere: int

    @property
    def share_elsewhere(self) -> float:
        """Share of the recognised blocks that lie elsewhere; 0 if there are none."""
        return self.elsewhere / max(self.here + self.elsewhere, 1)


def block_votes(
    source: AlignedPhotograph, target: AlignedPhotograph, pose: DistortedPose
) -> BlockVotes:
    """Look for every block with detail.

    Parameters
    ----------
    source, target
        The finer and the coarser photograph.
    pose
        Target to source.
    """
    factor = max(round(max(target.shape) / _LONG_SIDE_PX), 1)
    found = compared_at(source, target, pose, factor)
    if found is None:
        return BlockVotes(here=0, elsewhere=0)
    ours, inside = found.ours * found.inside, found.inside & found.usable
    theirs = np.asarray(found.theirs * found.usable, dtype=np.float32)
    votes = {True: 0, False: 0}
    rows, cols = inside.shape
    for top in range(0, rows - _BLOCK_PX + 1, _BLOCK_PX // 2):
        for left in range(0, cols - _BLOCK_PX + 1, _BLOCK_PX // 2):
            block = np.s_[top : top + _BLOCK_PX, left : left + _BLOCK_PX]
            detail = float(np.mean(theirs[block] ** 2))
            if inside[block].mean() < _LEAST_SHARE or detail < _LEAST_DETAIL:
                continue
            is_here = _is_here(ours, theirs[block], inside, (top, left))
            if is_here is not None:
                votes[is_here] += 1
    return BlockVotes(here=votes[True], elsewhere=votes[False])


def _is_here(
    ours: Float32Array, block: Float32Array, inside: BoolArray, at: tuple[int, int]
) -> bool | None:
    """Whether a block lies at its place; None where it is recognised nowhere."""
    low = [max(along - _REACH_PX, 0) for along in at]
    window = np.s_[low[0] : at[0] + _BLOCK_PX + _REACH_PX, low[1] : at[1] + _BLOCK_PX + _REACH_PX]
    seen, area = np.ascontiguousarray(ours[window], dtype=np.float32), _BLOCK_PX**2
    square = _summed(seen**2)
    spread = np.sqrt(np.maximum(square, _LEAST_DETAIL / 2 * area) * float(np.sum(block**2)))
    correlation = np.asarray(cv2.matchTemplate(seen, block, cv2.TM_CCORR)) / spread
    shared = _summed(inside[window].astype(np.float32)) / area
    correlation = np.where(shared < _LEAST_SHARE, -1.0, correlation)
    row, col = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    best = float(correlation[row, col])
    if best < _RECOGNISED:
        return None
    y, x = (along - first for along, first in zip(at, low, strict=True))
    around = correlation[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2]
    is_near = np.hypot(row - y, col - x) <= _PLACE_PX
    return bool(is_near or around.max() > _AS_WELL * best)


def _summed(values: Float32Array) -> FloatArray:
    """Sums over all blocks of an array."""
    ones = np.ones((_BLOCK_PX, _BLOCK_PX), dtype=np.float32)
    return np.asarray(cv2.matchTemplate(values, ones, cv2.TM_CCORR), dtype=np.float64)
