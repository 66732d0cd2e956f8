"""Changes that are movements: what a shift of a few pixels explains better than an added signal.

What is seen somewhere after may be what was elsewhere before, and what was there before may be
seen elsewhere after: a change is a movement if either holds, by the same shift, on nearly all that
stands out, and if the thing itself is seen at both places. Parallax and things that moved are found
so; what vanished and what appeared is one movement. A thing covers what it moves to and uncovers
what it was before, which no shift explains.

What is gone before a plain ground seems to have come from anywhere around it: the ground that was
uncovered is found beside it. Where the other place has changed as well, what is there has come or
gone; of the rest, of before and after the one decides that has structure in the change which its
surroundings do not have: what is there must be found, at its other place, in the other photograph.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import ceil, inf
from typing import Self

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates
from scipy.spatial import cKDTree

from analysis.changes._trial import (
    LEAST_GAINS,
    LEAST_SHARES,
    Fit,
    Images,
    Shift,
    Trial,
    fit_shift,
    joint_search_costs,
    lowest,
    search_costs,
    shift_residuals,
    ways_within,
)
from analysis.changes.matching import Window
from simulation.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surroundings:
    """A part of the frame around a change.

    ``crop``: the part; images of it have shape ``(rows, cols)``. ``inside, ring``: pixels of the
    change, and of its surroundings. ``outside_px``: distance of each pixel from the change.
    """

    crop: Window
    inside: BoolArray
    ring: BoolArray
    outside_px: FloatArray

    @classmethod
    def of(
        cls,
        rows: IntArray,
        cols: IntArray,
        valid: BoolArray,
        ring_px: tuple[float, float],
        margin_px: int,
    ) -> Self:
        """Cut a change out with a margin.

        ``ring_px``: distances from the change of its surroundings.
        """
        top, left = max(int(rows.min()) - margin_px, 0), max(int(cols.min()) - margin_px, 0)
        bottom, right = int(rows.max()) + margin_px + 1, int(cols.max()) + margin_px + 1
        crop = slice(top, bottom), slice(left, right)
        inside = np.zeros(valid[crop].shape, dtype=np.bool_)
        inside[rows - top, cols - left] = True
        outside_px: FloatArray = distance_transform_edt(~inside)
        ring = (outside_px >= ring_px[0]) & (outside_px <= ring_px[1]) & valid[crop]
        return cls(crop=crop, inside=inside, ring=ring, outside_px=outside_px)

    @property
    def top(self) -> int:
        """First row of the part."""
        return int(self.crop[0].start)

    @property
    def left(self) -> int:
        """First column of the part."""
        return int(self.crop[1].start)

    def structure(self, side: FloatArray, least_dn2: float = 0.0) -> float:
        """Mean square in the change about the plane through its surroundings, over that of those.

        ``least_dn2``: what the surroundings have at least, by noise.
        """
        y, x = np.nonzero(self.ring)
        if len(y) < 3:
            return 0.0
        terms = np.stack([np.ones(len(y)), y, x], axis=1)
        plane, *_ = np.linalg.lstsq(terms, side[self.ring], rcond=None)
        around = float(np.mean((side[self.ring] - terms @ plane) ** 2))
        own_y, own_x = np.nonzero(self.inside)
        within = side[self.inside] - (plane[0] + plane[1] * own_y + plane[2] * own_x)
        least = max(around, least_dn2, float(np.finfo(np.float32).tiny))
        return float(np.mean(within**2)) / least


_MOST_SEARCHED = 300
_JOINT_STARTS, _ROUNDS, _REFINING_ROUNDS, _LEAST_PIXELS = 3, 4, 10, 6
_CONVERGED_PX = 0.01
_REFINED_PX = 1.0
"""How far the shift of all pixels together may be from that of the changes apart."""

_TRIMMED, _LEAST_TRIMMED = 0.7, 4.0
"""Share of the pixels that decide a shift, and squares that are never too large."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _JointShift:
    """One shift, and which of the changes it explains."""

    shift: Shift
    members: IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Chi2:
    """Chi-squared of each change, shape ``(n,)``, and its independent values."""

    chi2: FloatArray
    values: FloatArray

    def only(self, kept: BoolArray) -> "_Chi2":
        """Some of them together."""
        return _Chi2(
            chi2=np.sum(self.chi2[kept], keepdims=True),
            values=np.sum(self.values[kept], keepdims=True),
        )

    def share(self, left: "_Chi2") -> FloatArray:
        """Share of what stands out beyond the noise that is not left; -1 without any pixel."""
        stood_out = np.maximum(self.chi2 - self.values, 1e-9)
        share = 1 - np.maximum(left.chi2 - self.values, 0.0) / stood_out
        return np.where(self.values > 0, share, -1.0)


class _JointTrial(Trial):
    """Several changes, the strongest first."""

    def joint_shift(self, ways: IntArray, member: IntArray) -> "_JointShift | None":
        """Find one shift of several changes; each pixel came from a changed place or went to one.

        ``member`` numbers the change of each pixel that was given.
        """
        member = self._member_of_own(member)
        pixels, sparse = self._pixels(1.0)[: self._own], 1 + self._own // _MOST_SEARCHED
        costs = joint_search_costs(pixels[::sparse], self._images, self._changed, ways)
        rest = self._by_member(self._static[: self._own], member)
        best, most = None, 0.0
        for start in lowest(costs, ways, _JOINT_STARTS):
            fit, square = self._joint_fit(start, np.ones(self._own, dtype=np.bool_), 1.0)
            kept = rest.share(self._by_member(square, member)) > LEAST_SHARES[0]
            # Without those that have nothing to do with it.
            fit, square = self._joint_fit(fit.shift[:2], kept[member], 1.0)
            left = self._by_member(square, member)
            kept &= rest.share(left) > LEAST_SHARES[0]
            explained = float((rest.chi2 - left.chi2)[kept].sum())
            if np.count_nonzero(kept) > 1 and explained > most:
                best, most = (fit, left, kept), explained
        if best is None:
            return None
        fit, left, kept = best
        spots = sum(self.spot_cost_on(pixels[member == one]) for one in np.flatnonzero(kept))
        gain = spots - float(left.chi2[kept].sum()) - LEAST_GAINS[2]
        share = float(rest.only(kept).share(left.only(kept))[0])
        if gain <= 0 or share < LEAST_SHARES[2]:
            return None
        shift = self.explained(replace(fit, share=share, gain=gain))
        return _JointShift(shift=shift, members=np.flatnonzero(kept))

    def even_shift(self, ways: IntArray, member: IntArray) -> Shift | None:
        """Find the shift of an even thing, which arrived at one change and has left the other.

        What it arrived at may come from where nothing seems to have changed, within the thing: so
        both changes have to be explained, each in its own sense.
        """
        member = self._member_of_own(member)
        if not 0 < np.count_nonzero(member) < len(member):
            return None  # of the smaller one no pixel is looked at, or it lies upon the other
        sparse = 1 + self._own // _MOST_SEARCHED
        rest = self._by_member(self._static[: self._own], member)
        best: Fit | None = None
        for arrived in (0, 1):
            pixels = np.where(
                (member == arrived)[:, np.newaxis],
                self._pixels(1.0)[: self._own],
                self._pixels(-1.0)[: self._own],
            )
            costs = search_costs(pixels[::sparse], self._images, self._valid, ways)
            shift, prior = np.append(lowest(costs, ways, 1)[0], np.zeros(4)), np.full(7, inf)
            prior[:2], prior[6] = 1e-6, self._reach_px + 1
            shift = fit_shift(pixels, self._splines, self._valid, shift, prior)
            slopes = np.empty((self._own, 6))
            residuals = shift_residuals(pixels, self._splines, self._valid, shift, slopes)
            left = self._by_member(residuals**2, member)
            share = float(rest.share(left).min())
            spots = sum(self.spot_cost_on(pixels[member == one]) for one in (0, 1))
            gain = spots - float(left.chi2.sum()) - LEAST_GAINS[2]
            if share >= LEAST_SHARES[2] and gain > (0.0 if best is None else best.gain):
                best = Fit(
                    shift=shift,
                    sense=1.0,
                    is_whole=False,
                    count=2,
                    share=share,
                    cost=float(left.chi2.sum()),
                    own_cost=float(left.chi2.sum()),
                    slopes=slopes[:, :2],
                    excess=max(1.0, float(np.mean(residuals**2))),
                    gain=gain,
                )
        return None if best is None else self.explained(best)

    def _member_of_own(self, member: IntArray) -> IntArray:
        """The change of each pixel that is looked at: the strongest, of those that share one."""
        number = np.zeros(self._valid.shape, dtype=np.int64)
        rows, cols = self._given
        number[rows[::-1], cols[::-1]] = member[::-1]
        return np.asarray(number[self._y[: self._own], self._x[: self._own]])

    def _by_member(self, square: FloatArray, member: IntArray) -> "_Chi2":
        count = int(member.max(initial=0)) + 1
        return _Chi2(
            chi2=np.asarray(self._norm * np.bincount(member, square, count), dtype=np.float64),
            values=np.asarray(self._norm * np.bincount(member, minlength=count), dtype=np.float64),
        )

    def refined(self, start: FloatArray) -> Shift | None:
        """A shift of all pixels together, near one that explains them apart."""
        fit, _ = self._joint_fit(start, np.ones(self._own, dtype=np.bool_), _TRIMMED)
        is_near = np.linalg.norm(fit.shift[:2] - start) < _REFINED_PX
        return self.explained(fit) if is_near and fit.slopes.any() else None

    def _joint_fit(
        self, start: FloatArray, used: BoolArray, most: float
    ) -> tuple["Fit", FloatArray]:
        """Fit a rigid shift to the pixels with the better sense; and the squares of all pixels."""
        shift, prior = np.append(start, np.zeros(4)), np.full(7, inf)
        prior[:2], prior[6] = 1e-6, self._reach_px + 1
        chosen, square, is_moved = self._better_senses(shift)
        for _ in range(_ROUNDS if most == 1 else _REFINING_ROUNDS):
            used = used & is_moved
            if np.count_nonzero(used) < _LEAST_PIXELS:
                break
            fitted = chosen[_trimmed(used, square, most)]
            found = fit_shift(fitted, self._splines, self._valid, shift, prior)
            chosen, square, is_moved = self._better_senses(found)
            way, shift = np.abs(found - shift).max(), found
            if way < _CONVERGED_PX:
                break
        used = _trimmed(used & is_moved, square, most)
        fitted = chosen[used]
        slopes = np.empty((len(fitted), 6))
        left = shift_residuals(fitted, self._splines, self._valid, shift, slopes)
        grid = np.zeros((self._own, 2))
        grid[used] = slopes[:, :2]
        return Fit(
            shift=shift,
            sense=1.0,
            is_whole=False,
            count=2,
            share=0.0,
            cost=0.0,
            own_cost=0.0,
            slopes=grid,
            excess=max(1.0, float(np.mean(left**2)) if len(left) else 1.0),
        ), square

    def _better_senses(self, shift: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Pixels with the sense that leaves less, its squares, and whether it is not rest."""
        chosen = self._pixels(1.0)[: self._own].copy()
        square = self._static[: self._own].copy()
        is_moved = np.zeros(self._own, dtype=np.bool_)
        slopes = np.empty((self._own, 6))
        for sense in (1.0, -1.0):
            pixels = self._pixels(sense)[: self._own]
            left = shift_residuals(pixels, self._splines, self._valid, shift, slopes) ** 2
            better = (left < square) & self._changed_elsewhere(pixels, shift)
            chosen[better], square[better], is_moved[better] = pixels[better], left[better], True
        return chosen, square, is_moved


def _trimmed(used: BoolArray, square: FloatArray, share: float) -> BoolArray:
    """Without the worst: beside what is covered or uncovered a pixel shows some of that."""
    if share == 1 or not used.any():
        return used
    values = square[used]
    last = int(share * (len(values) - 1))
    return np.asarray(used & (square <= max(_LEAST_TRIMMED, np.partition(values, last)[last])))


_RING_PX = (2.0, 8.0)
"""Distances from the change of the surroundings with which it is compared."""

_AS_STRUCTURED = 0.7
"""A side counts that has at least so much of the structure of the other one."""

_EXPLAINED, _EXPLAINED_TOO = 0.8, 0.85
"""Share of the squared difference of the photographs that the shift has to explain, of all of a
change and of what has changed at its other place too. What moved is explained to 1.0, and less
where the pose errs; of 200 things that were put into photographs or taken out of them six have more
than 0.8 of what changed too explained, two more than 0.87, and of 100 that moved 71 and 65."""

_CHANGED_TOO, _LEAST_CHANGED = 0.3, 6
"""Share and number of a change's pixels whose other place has changed, from which those decide."""

_MARGIN_PX = 12


def _is_seen_twice(
    images: Images,
    changed: BoolArray,
    places: tuple[IntArray, IntArray],
    displacement_px: FloatArray,
) -> bool:
    """Say whether what a change shows is at its other place in the other photograph.

    ``places``: rows and columns of the one that is asked about. ``displacement_px``: ``(y, x)``
    from before to after.
    """
    rows, cols = places
    margin = _MARGIN_PX + ceil(float(np.abs(displacement_px).max()))
    around = Surroundings.of(rows, cols, images.valid, _RING_PX, margin)
    sides = [
        np.asarray(one[around.crop], np.float64) for one in (images.before_dn, images.after_dn)
    ]
    variance = float(np.mean(np.square(images.sd_dn[rows, cols], dtype=np.float64)))
    structures = [around.structure(side) for side in sides]
    inside, marked = around.inside, changed[around.crop]
    apart = np.square(sides[1] - sides[0])[inside]
    if apart.sum() <= variance * len(rows):
        return False
    at = np.stack([rows - around.top, cols - around.left]).astype(np.float64)
    shift = displacement_px[:, np.newaxis]
    for own, other, sign in ((0, 1, 1.0), (1, 0, -1.0)):
        there = at + sign * shift
        left = np.square(
            sides[own][inside] - map_coordinates(sides[other], there, order=1, mode="nearest")
        )
        row, col = np.rint(there).astype(np.int64)
        too = marked[np.clip(row, 0, marked.shape[0] - 1), np.clip(col, 0, marked.shape[1] - 1)]
        least = _EXPLAINED_TOO
        if np.count_nonzero(too) < max(_LEAST_CHANGED, _CHANGED_TOO * len(too)):
            if structures[own] < _AS_STRUCTURED * max(structures):
                continue
            too, least = np.ones_like(too), _EXPLAINED
        noise = variance * np.count_nonzero(too)
        squares, left_over = apart[too].sum() - noise, left[too].sum() - noise
        if squares > 0 and 1 - left_over / squares >= least:
            return True
    return False


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

    ``row, col``: the strongest pixel. ``sign``: 1 or -1. ``rows, cols``: all of its pixels, shape
    ``(n,)``.
    """

    row: int
    col: int
    sign: int
    rows: IntArray = field(repr=False)
    cols: IntArray = field(repr=False)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Movement:
    """One shift and the changes that it explains.

    ``regions``: their indices, the strongest first. ``displacement_px``: ``(y, x)`` on the grid:
    what was at p is now at p + d. ``covariance_px2``: shape (2, 2); large along an edge, along
    which no shift is seen. ``share``: of what stood out beyond the noise, explained; the least of
    the regions.
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

    ``images``: before and after, at one sharpness and in one light. ``regions``: connected pixels
    that differ, the strongest first.
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
        if _is_seen_twice(
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
    images: Images, regions: Sequence[ChangedRegion], found: dict[int, Shift], near: list[list[int]]
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
        joint = _JointTrial(images, rows, cols, _FAR_PX).joint_shift(ways, member)
        if joint is not None:
            groups.append([group[one] for one in joint.members.tolist()])
            found |= dict.fromkeys(groups[-1], joint.shift)
    return groups


def _add_even(
    images: Images, regions: Sequence[ChangedRegion], found: dict[int, Shift], far: list[list[int]]
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
            shift = _JointTrial(images, rows, cols, _FAR_PX).even_shift(ways, member)
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
    images: Images, regions: Sequence[ChangedRegion], found: dict[int, Shift], near: list[list[int]]
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
    images: Images, regions: Sequence[ChangedRegion], found: dict[int, Shift], near: list[list[int]]
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
    refined = _JointTrial(images, rows, cols, reach).refined(shift.displacement_px)
    best = shift if refined is None else refined
    y, x = best.displacement_px.tolist()
    return Movement(
        regions=tuple(members),
        displacement_px=(y, x),
        covariance_px2=np.asarray(np.linalg.inv(best.information), dtype=np.float64),
        share=shift.share,
    )
