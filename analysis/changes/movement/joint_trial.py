"""Whether one shift explains several changes: what vanished here has appeared there.

A thing covers what it moves to and uncovers what it was before, which no shift explains; what is
seen of the thing itself either came from a place that has changed too, or went to one.
"""

from dataclasses import dataclass, replace
from math import inf

import numpy as np

from analysis.changes.movement.shift_fit import (
    fit_shift,
    joint_search_costs,
    search_costs,
    shift_residuals,
)
from analysis.changes.movement.trial import (
    LEAST_GAINS,
    LEAST_SHARES,
    Fit,
    Shift,
    Trial,
    lowest,
)
from simulation.arrays import BoolArray, FloatArray, IntArray

_MOST_SEARCHED = 300
_JOINT_STARTS, _ROUNDS, _REFINING_ROUNDS, _LEAST_PIXELS = 3, 4, 10, 6
_CONVERGED_PX = 0.01
_REFINED_PX = 1.0
"""How far the shift of all pixels together may be from that of the changes apart."""

_TRIMMED, _LEAST_TRIMMED = 0.7, 4.0
"""Share of the pixels that decide a shift, and squares that are never too large."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointShift:
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


class JointTrial(Trial):
    """Several changes, the strongest first."""

    def joint_shift(self, ways: IntArray, member: IntArray) -> "JointShift | None":
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
        return JointShift(shift=shift, members=np.flatnonzero(kept))

    def even_shift(self, ways: IntArray, member: IntArray) -> Shift | None:
        """Find the shift of an even thing, which arrived at one change and has left the other.

        What it arrived at may come from where nothing seems to have changed, within the thing: so
        both changes have to be explained, each in its own sense.
        """
        member = self._member_of_own(member)
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
