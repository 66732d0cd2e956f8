"""Changes that are movements: what a shift of a few pixels explains better than an added signal.

What is seen somewhere after may be what was elsewhere before, and what was there before may be
seen elsewhere after: a change is a movement if either holds, by the same shift, on nearly all that
stands out, and if the thing itself is seen at both places. Parallax and things that moved are found
so; what vanished and what appeared is one movement.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import cKDTree

from analysis.changes.movement.joint_trial import JointTrial
from analysis.changes.movement.seen_twice import is_seen_twice
from analysis.changes.movement.trial import Images, Shift, Trial, ways_within
from simulation.arrays import FloatArray, IntArray

_NEAR_PX, _FAR_PX = 6.0, 21.0
"""The longest shift of any change, and of one whose old place is another change."""

_MOST_JOINED, _MOST_JOINED_PX = 8, 1000
"""Changes that are tried together, and pixels of each."""

_SKIRT, _STRIP_SHARE = 2.0, 0.5
"""Of what lies beside a movement and is part of it: its distance beyond the displacement over the
smoothing, and its pixels over those of the movement, at most."""

_MOST_PAIRED = 3
"""Neighbours with which a change is tried as the two sides of an even thing."""

_MOST_MEASURED = 40
"""Pixels of a change between which distances are measured."""


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
    reach = _GAP * images.smoothing_px + _NEAR_PX
    near, far = (_neighbours(regions, most) for most in (reach, _FAR_PX))
    for group in _add_joint(images, regions, found, far):
        for index in group:
            near[index] += [other for other in group if other not in (index, *near[index])]
    for pair in _add_even(images, regions, found, far):
        for index in pair:
            near[index] += [other for other in pair if other not in (index, *near[index])]
    _add_followers(images, regions, found, near)
    changed = np.zeros(images.valid.shape, dtype=np.bool_)
    for region in regions:
        changed[region.rows, region.cols] = True
    found = {
        index: shift
        for index, shift in found.items()
        if is_seen_twice(
            images, changed, (regions[index].rows, regions[index].cols), shift.displacement_px
        )
    }
    movements = _joined(images, regions, found, near)
    return _with_strips(movements, regions, images.smoothing_px)


def _with_strips(
    movements: Sequence[Movement], regions: Sequence[ChangedRegion], smoothing_px: float
) -> tuple[Movement, ...]:
    """Add what a thing covers or uncovers on its way, which no shift explains.

    That lies within the displacement of what the shift explains, and is less of it.
    """
    free = set(range(len(regions))).difference(*(one.regions for one in movements))
    made = []
    for movement in movements:
        pixels = _pixels_of(regions, movement.regions)
        reach = float(np.hypot(*movement.displacement_px)) + _SKIRT * smoothing_px
        tree = cKDTree(pixels)
        strips = [
            index
            for index in sorted(free)
            if len(regions[index].rows) <= _STRIP_SHARE * len(pixels)
            and np.max(tree.query(_pixels_of(regions, (index,)))[0]) <= reach
        ]
        free -= set(strips)
        made.append(replace(movement, regions=tuple(sorted((*movement.regions, *strips)))))
    return tuple(made)


def _pixels_of(regions: Sequence[ChangedRegion], chosen: Sequence[int]) -> IntArray:
    """Rows and columns of some changes, shape ``(n, 2)``."""
    return np.concatenate(
        [np.stack([regions[one].rows, regions[one].cols], axis=1) for one in chosen]
    )


def _add_joint(
    images: Images,
    regions: Sequence[ChangedRegion],
    found: dict[int, Shift],
    near: list[list[int]],
) -> list[list[int]]:
    """Things that moved over what is behind them: what appeared is what vanished elsewhere.

    Returns those that one shift explains.
    """
    ways, groups = ways_within(_FAR_PX), []
    small = [len(region.rows) <= _MOST_JOINED_PX for region in regions]
    for index in range(len(regions)):
        group = [index, *(other for other in near[index] if small[other])][:_MOST_JOINED]
        if index in found or not small[index] or len(group) < 2:
            continue
        rows = np.concatenate([regions[one].rows for one in group])
        cols = np.concatenate([regions[one].cols for one in group])
        member = np.repeat(np.arange(len(group)), [len(regions[one].rows) for one in group])
        joint = JointTrial(images, rows, cols, _FAR_PX).joint_shift(ways, member)
        if joint is not None:
            groups.append([group[one] for one in joint.members.tolist()])
            found |= dict.fromkeys(groups[-1], joint.shift)
    return groups


def _add_even(
    images: Images,
    regions: Sequence[ChangedRegion],
    found: dict[int, Shift],
    far: list[list[int]],
) -> list[tuple[int, int]]:
    """Even things, of which only what they covered and uncovered has changed.

    Returns the pairs of changes.
    """
    ways, pairs = ways_within(_FAR_PX), []
    for index, region in enumerate(regions):
        others = [
            other
            for other in far[index]
            if other > index and other not in found and regions[other].sign != region.sign
        ]
        for other in others[:_MOST_PAIRED]:
            if index in found or other in found:
                continue
            its = regions[other]
            rows, cols = np.append(region.rows, its.rows), np.append(region.cols, its.cols)
            member = np.repeat([0, 1], [len(region.rows), len(its.rows)])
            shift = JointTrial(images, rows, cols, _FAR_PX).even_shift(ways, member)
            if shift is not None:
                found |= {index: shift, other: shift}
                pairs.append((index, other))
    return pairs


def _neighbours(regions: Sequence[ChangedRegion], reach: float) -> list[list[int]]:
    """Changes within so many px of each."""
    # Of each some pixels: where a change is wide, a few more or less are no matter.
    some = [
        np.stack([one.rows, one.cols], axis=1)[:: 1 + len(one.rows) // _MOST_MEASURED]
        for one in regions
    ]
    tree = cKDTree(np.concatenate(some))
    owner = np.repeat(np.arange(len(some)), [len(one) for one in some])
    near: list[list[int]] = []
    for index, pixels in enumerate(some):
        close = tree.query_ball_point(pixels, reach, return_sorted=False)
        others = np.zeros(len(some), dtype=np.bool_)
        for found in close:
            others[owner[found]] = True
        others[index] = False
        near.append(np.flatnonzero(others).tolist())
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
        together = Shift(
            displacement_px=np.asarray(np.linalg.solve(information, weighted), dtype=np.float64),
            information=information,
            share=share,
            gain=shift.gain,
        )
        movements.append(_movement(images, regions, sorted(members), together))
    return tuple(movements)


def _movement(
    images: Images, regions: Sequence[ChangedRegion], members: list[int], shift: Shift
) -> Movement:
    """Fit the shift once more, to all pixels together."""
    rows = np.concatenate([regions[one].rows for one in members])
    cols = np.concatenate([regions[one].cols for one in members])
    reach = float(np.linalg.norm(shift.displacement_px)) + 1
    refined = JointTrial(images, rows, cols, reach).refined(shift.displacement_px)
    best = shift if refined is None else refined
    y, x = best.displacement_px.tolist()
    return Movement(
        regions=tuple(members),
        displacement_px=(y, x),
        covariance_px2=np.asarray(np.linalg.inv(best.information), dtype=np.float64),
        share=shift.share,
    )
