"""Changes that are movements: what a shift of a few pixels explains better than an added signal.

What is seen somewhere after may be what was elsewhere before, and what was there before may be
seen elsewhere after: a change is a movement if either holds, by the same shift, on nearly all that
stands out. Parallax and things that moved are found so; what vanished and what appeared is one
movement.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from analysis.changes.movement_trial import Images, Shift, Trial, ways_within
from simulation.arrays import FloatArray, IntArray

_NEAR_PX, _FAR_PX = 6.0, 16.0
"""The longest shift of any change, and of one whose old place is another change."""

_MOST_JOINED = 8

_AGREED_PX, _AGREED_ERR = 0.7, 3.0
_GAP = 3.0
"""Distance over the smoothing, plus the shift, between changes of one movement."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChangedRegion:
    """Connected pixels of one sign.

    Parameters
    ----------
    row, col
        The strongest pixel.
    sign
        1 or -1.
    rows, cols
        All of its pixels, shape ``(n,)``.
    """

    row: int
    col: int
    sign: int
    rows: IntArray = field(repr=False)
    cols: IntArray = field(repr=False)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Movement:
    """One shift and the changes that it explains.

    Parameters
    ----------
    regions
        Their indices, the strongest first.
    displacement_px
        ``(y, x)`` on the grid: what was at p is now at p + d.
    covariance_px2
        Shape (2, 2); large along an edge, along which no shift is seen.
    share
        Of what stood out beyond the noise, explained; the least of the regions.
    """

    regions: tuple[int, ...]
    displacement_px: tuple[float, float]
    covariance_px2: FloatArray = field(repr=False)
    share: float

    @property
    def displacement_err_px(self) -> tuple[float, float]:
        """Standard errors of the displacement."""
        y, x = np.sqrt(np.diag(self.covariance_px2)).tolist()
        return y, x


def find_movements(images: Images, regions: Sequence[ChangedRegion]) -> tuple[Movement, ...]:
    """Find the changes that a shift explains.

    Parameters
    ----------
    images
        Before and after, at one sharpness and in one light.
    regions
        Connected pixels that differ, the strongest first.
    """
    if not regions:
        return ()
    ways = ways_within(_NEAR_PX)
    found: dict[int, Shift] = {}
    for index, region in enumerate(regions):
        shift = Trial(images, region.rows, region.cols, _NEAR_PX).shift(ways, 2)
        if shift is not None:
            found[index] = shift
    _add_joint(images, regions, found)
    near = _neighbours(regions, _GAP * images.smoothing_px + _NEAR_PX)
    _add_followers(images, regions, found, near)
    return _joined(images, regions, found, near)


def _add_joint(images: Images, regions: Sequence[ChangedRegion], found: dict[int, Shift]) -> None:
    """Things that moved over what is behind them: what appeared is what vanished elsewhere."""
    near = _neighbours(regions, _FAR_PX)
    ways = ways_within(_FAR_PX)
    for index in range(len(regions)):
        if index in found or not near[index]:
            continue
        group = [index, *near[index][: _MOST_JOINED - 1]]
        rows = np.concatenate([regions[one].rows for one in group])
        cols = np.concatenate([regions[one].cols for one in group])
        member = np.repeat(np.arange(len(group)), [len(regions[one].rows) for one in group])
        joint = Trial(images, rows, cols, _FAR_PX).joint_shift(ways, member)
        if joint is not None:
            for one in joint.members.tolist():
                found[group[one]] = joint.shift


def _neighbours(regions: Sequence[ChangedRegion], reach: float) -> list[list[int]]:
    """Changes within so many px of each."""
    trees = [cKDTree(np.stack([one.rows, one.cols], axis=1)) for one in regions]
    centre = np.array([(np.mean(one.rows), np.mean(one.cols)) for one in regions])
    radius = np.array([np.hypot(np.ptp(one.rows), np.ptp(one.cols)) / 2 for one in regions])
    near: list[list[int]] = [[] for _ in regions]
    for i in range(len(regions)):
        apart = np.linalg.norm(centre[i + 1 :] - centre[i], axis=1) - radius[i + 1 :] - radius[i]
        for j in (np.flatnonzero(apart < reach) + i + 1).tolist():
            if trees[i].count_neighbors(trees[j], reach) > 0:
                near[i].append(j)
                near[j].append(i)
    return near


def _add_followers(
    images: Images,
    regions: Sequence[ChangedRegion],
    found: dict[int, Shift],
    near: list[list[int]],
) -> None:
    """Changes that are explained by the shift of a neighbour."""
    queue = sorted(found, key=lambda index: -found[index].gain)
    while queue:
        leader = queue.pop(0)
        for index in near[leader]:
            if index in found:
                continue
            region, start = regions[index], found[leader].displacement_px
            reach = float(np.hypot(*start)) + 1
            shift = Trial(images, region.rows, region.cols, reach).following(start)
            if shift is not None:
                found[index] = shift
                queue.append(index)


def _joined(
    images: Images,
    regions: Sequence[ChangedRegion],
    found: dict[int, Shift],
    near: list[list[int]],
) -> tuple[Movement, ...]:
    """Neighbours with one shift are one movement."""
    movements = []
    free = dict(sorted(found.items(), key=lambda item: -item[1].gain))
    while free:
        first = next(iter(free))
        shift = free.pop(first)
        members, information = [first], shift.information.copy()
        weighted, share = information @ shift.displacement_px, shift.share
        queue = [first]
        while queue:
            for index in near[queue.pop(0)]:
                if index not in free:
                    continue
                other = free[index]
                covariance = np.linalg.inv(information)
                apart = other.displacement_px - covariance @ weighted
                spread = covariance + np.linalg.inv(other.information)
                spread = _AGREED_ERR**2 * spread + _AGREED_PX**2 * np.eye(2)
                if apart @ np.linalg.solve(spread, apart) > 1:
                    continue
                del free[index]
                members.append(index)
                queue.append(index)
                information = information + other.information
                weighted = weighted + other.information @ other.displacement_px
                share = min(share, other.share)
        covariance = np.linalg.inv(information)
        displacement = covariance @ weighted
        rows = np.concatenate([regions[one].rows for one in members])
        cols = np.concatenate([regions[one].cols for one in members])
        reach = float(np.linalg.norm(displacement)) + 1
        refined = Trial(images, rows, cols, reach).refined(displacement)
        if refined is not None:
            displacement, covariance = refined.displacement_px, np.linalg.inv(refined.information)
        y, x = displacement.tolist()
        movements.append(
            Movement(
                regions=tuple(sorted(members)),
                displacement_px=(y, x),
                covariance_px2=covariance,
                share=share,
            )
        )
    return tuple(movements)
