"""Changes out of the connected regions that each level finds: one entry for each change.

From the narrowest level to the widest: a wide region takes the narrower ones of its sign in whose
midst they lie, if it stands out further than they do together. The light of the others is taken
out, or every strong change would be found again by all wider filters; what is then left beyond
the threshold is a change of its own.

The share of false ones among them is by Y. Benjamini and Y. Hochberg, "Controlling the false
discovery rate", J. R. Statist. Soc. B 57 (1995), 289-300, with the peaks of the frame as the
hypotheses: their number times the probability of a height is the number of peaks that chance lifts
so high. A. Schwartzman, Y. Gavrilov and R. J. Adler, "Multiple testing of local maxima for
detection of peaks in 1D", Ann. Statist. 39 (2011), 3290-3319, show that this controls the share of
false peaks.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from math import hypot

import cv2
import numpy as np
from scipy.optimize import brentq

from analysis.changes._levels import DetectionLevel, signed_significance
from analysis.changes._significance import FilterWidth, expected_peaks
from analysis.changes.matching import away_from
from simulation.arrays import BoolArray, Float32Array, FloatArray, FloatImage, IntArray

_BEYOND_OUTLINES, _LEAST_BEYOND_PX = 0.2, 4
"""Share of the differing pixels of a region of a drawing, and their number, from which on it is a
change: where a scanner's noise decides between two levels, some pixels do not lie by an outline."""

_CORE = 0.5
_LEAST_PART = 0.1
"""Of a direction of length 1, below which a plane does not tell its sign."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Region:
    """Connected places beyond the threshold.

    Parameters
    ----------
    row, col
        The strongest place.
    significance
        Its standard deviations, signed.
    rows, cols
        All places, shape ``(n,)``.
    heights
        Standard deviations there, positive.
    direction
        Of colours its mean in the whitened planes, of length 1.
    """

    row: int
    col: int
    significance: float
    rows: IntArray
    cols: IntArray
    heights: FloatArray
    direction: FloatArray | None = None

    def core(self) -> BoolArray:
        """Which places have at least half the height; the others are its blurred skirt."""
        return np.asarray(self.heights >= _CORE * abs(self.significance))


def connected_regions(significance: FloatImage, threshold_sd: float) -> list[Region]:
    """Find the connected regions beyond a threshold, the most significant first.

    Places that touch at a corner are connected; those of opposite signs are not. ``significance``:
    signed standard deviations, shape ``(rows, cols)``. ``threshold_sd``: not negative; a region
    lies strictly beyond it.
    """
    found = [
        region for sign in (1.0, -1.0) for region in _of_sign(significance, threshold_sd, sign)
    ]
    # Ties in the order of rows and columns.
    return sorted(found, key=lambda one: (-abs(one.significance), one.row, one.col))


def _of_sign(significance: FloatImage, threshold_sd: float, sign: float) -> list[Region]:
    mask = significance > threshold_sd if sign > 0 else significance < -threshold_sd
    if not mask.any():
        return []
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    rows, cols = np.nonzero(mask)
    label = labels[rows, cols] - 1
    height = np.abs(significance[rows, cols])
    order = np.lexsort((cols, rows, -height, label))
    first = np.searchsorted(label[order], np.arange(count))
    regions = []
    for start, end in zip(first[:-1].tolist(), [*first[1:-1].tolist(), len(order)], strict=True):
        of_region = order[start:end]
        top = of_region[0]
        regions.append(
            Region(
                row=int(rows[top]),
                col=int(cols[top]),
                significance=float(sign * height[top]),
                rows=rows[of_region],
                cols=cols[of_region],
                heights=height[of_region],
            )
        )
    return regions


def _connected_colours(
    vectors: Float32Array, significance: FloatImage, threshold_sd: float
) -> list[Region]:
    """Find the connected regions of one change of colour beyond a threshold.

    What is connected has a direction in which it varies most; places on either side of it are
    apart, as those of opposite signs are. ``vectors``: whitened planes, shape ``(3, rows, cols)``,
    the luma first. ``threshold_sd``: not negative; a region lies strictly beyond it.
    """
    height = np.abs(significance)
    mask = height > threshold_sd
    if not mask.any():
        return []
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    rows, cols = np.nonzero(mask)
    label = labels[rows, cols] - 1
    own = vectors[:, rows, cols].astype(np.float64)
    moments = np.zeros((count - 1, len(own), len(own)))
    for first, second in combinations_with_replacement(range(len(own)), 2):
        sums = np.bincount(label, weights=own[first] * own[second], minlength=count - 1)
        moments[:, first, second] = moments[:, second, first] = sums
    along = np.linalg.eigh(moments)[1][:, :, -1]
    # Brighter is positive; of none in luma, whichever comes first.
    leading = np.argmax(np.abs(along) > _LEAST_PART, axis=1)
    along *= np.sign(np.take_along_axis(along, leading[:, None], axis=1))
    signed = np.zeros_like(height)
    projected = np.einsum("nk,kn->n", along[label], own)
    signed[rows, cols] = np.copysign(height[rows, cols], projected)
    return [
        replace(region, direction=_mean_direction(vectors, region))
        for region in connected_regions(signed, threshold_sd)
    ]


def _mean_direction(vectors: Float32Array, region: Region) -> FloatArray:
    core = region.core()
    own = vectors[:, region.rows[core], region.cols[core]].astype(np.float64)
    total = own @ region.heights[core]
    length = float(np.linalg.norm(total))
    if not length > 0:
        total, length = own[:, 0], float(np.linalg.norm(own[:, 0]))
    return np.asarray(total / length)


_SKIRT = 2.0
"""Widths of its level within which a change still has light."""

_SAME_COLOUR = 0.5
"""Cosine between the directions of two changes of colour, above which they are of one sign."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LinkedRegion:
    """A change: where it stands out most, of all levels.

    ``level``: number of the level that fits it best. ``row, col``: its strongest pixel, of the
    comparison's grid. ``significance``: standard deviations there, signed. ``rows, cols``: its
    pixels, shape ``(n,)``. ``light``: those and the ones that its blurred skirt reaches beyond the
    threshold, flat indices. ``direction``: of colours, that of the change in the level's whitened
    planes, of length 1; the sign of the significance is then the luma's.
    """

    level: int
    row: int
    col: int
    significance: float
    rows: IntArray
    cols: IntArray
    light: IntArray
    direction: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Standing:
    """What stands out at a level: signed significance, and of colours the whitened planes."""

    significance: FloatImage
    vectors: Float32Array | None = None

    @classmethod
    def of(cls, level: DetectionLevel) -> "_Standing":
        if level.colours is None:
            return cls(significance=level.significance)
        vectors = level.colours.vectors
        return cls(significance=signed_significance(vectors, level.valid), vectors=vectors)

    def regions(self, threshold_sd: float) -> list[Region]:
        if self.vectors is None:
            return connected_regions(self.significance, threshold_sd)
        return _connected_colours(self.vectors, self.significance, threshold_sd)

    def height_of(self, found: "LinkedRegion", place: tuple[int, int]) -> float:
        """Significance there in the direction of a change."""
        if self.vectors is None or found.direction is None:
            return float(self.significance[place]) * float(np.sign(found.significance))
        along = float(found.direction @ self.vectors[:, *place])
        return float(np.copysign(abs(self.significance[place]), along))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FoundChanges:
    """What stands out at any level.

    ``regions``: the most significant first. ``significance``: signed significance of every pixel at
    the level where it stands out most.
    """

    regions: tuple[LinkedRegion, ...]
    significance: Float32Array


def link_levels(levels: Sequence[DetectionLevel], threshold_sd: float) -> FoundChanges:
    """Find the changes beyond a threshold at any of the levels.

    ``levels``: the narrowest first; its places are the pixels of the comparison's grid.
    ``threshold_sd``: significance beyond which a place counts as changed.
    """
    narrowest = levels[0]
    standing = _Standing.of(narrowest)
    strongest = np.array(standing.significance, dtype=np.float32)
    found = [_linked(region, 0, levels, ()) for region in standing.regions(threshold_sd)]
    for number in range(1, len(levels)):
        found, significance = _with_wider(found, levels, number, threshold_sd)
        brought = levels[number].on_grid(significance, strongest.shape)
        brought[~narrowest.valid] = 0
        np.copyto(strongest, brought, where=np.abs(brought) > np.abs(strongest))
    found.sort(key=lambda one: (-abs(one.significance), one.row, one.col))
    return FoundChanges(regions=tuple(found), significance=strongest)


def _with_wider(
    found: list[LinkedRegion], levels: Sequence[DetectionLevel], number: int, threshold_sd: float
) -> tuple[list[LinkedRegion], FloatImage]:
    """Changes of a level and the narrower ones, and the level's significance without the latter."""
    level = levels[number]
    everything = _Standing.of(level)
    if not (np.abs(everything.significance) > threshold_sd).any():
        return found, everything.significance
    # Those that stand out less here than where they were found are done with.
    settled = [
        one for one in found if everything.height_of(one, _place(one, level)) <= _height(one)
    ]
    standing = _without(settled, everything, levels, number)
    regions = standing.regions(threshold_sd)
    taken = []
    for region, inside in zip(regions, _in_midst(found, regions, level), strict=True):
        # Several together, as the pieces of one wide change, have less than it has.
        if inside and abs(region.significance) > hypot(*map(_height, inside)):
            taken.append(_linked(region, number, levels, inside))
            gone = set(map(id, inside))
            found = [one for one in found if id(one) not in gone]
    standing = _without(found, everything, levels, number)
    claimed = pixels_of(taken, levels[0].valid.shape)[:: level.step_px, :: level.step_px]
    taken += [
        _linked(region, number, levels, ())
        for region in standing.regions(threshold_sd)
        if not claimed[region.row, region.col]
    ]
    return found + taken, standing.significance


def _height(found: LinkedRegion) -> float:
    return abs(found.significance)


def _place(found: LinkedRegion, level: DetectionLevel) -> tuple[int, int]:
    row, col = (round(at / level.step_px) for at in (found.row, found.col))
    return min(row, level.valid.shape[0] - 1), min(col, level.valid.shape[1] - 1)


def _without(
    found: Sequence[LinkedRegion],
    standing: _Standing,
    levels: Sequence[DetectionLevel],
    number: int,
) -> _Standing:
    """What stands out at a level with the light of changes taken out."""
    if not found:
        return standing
    level, narrowest = levels[number], levels[0]
    lit = np.zeros(narrowest.valid.size, dtype=np.bool_)
    for one in found:
        lit[one.light] = True
    apart = away_from(lit.reshape(narrowest.valid.shape), _SKIRT * narrowest.width_px)
    if standing.vectors is not None:
        return _colours_without(apart, narrowest, level)
    light = np.where(apart, np.float32(0), narrowest.difference_dn)
    own = level.smoothed_from(light, narrowest.width_px)
    return _Standing(significance=level.significance_without(own))


def _colours_without(
    apart: BoolArray, narrowest: DetectionLevel, level: DetectionLevel
) -> _Standing:
    """The same of whitened planes, which the light of changes adds to."""
    assert narrowest.colours is not None, "photographs in colour"
    assert level.colours is not None, "photographs in colour"
    light = np.stack(
        [
            level.smoothed_from(np.where(apart, np.float32(0), plane), narrowest.width_px)
            for plane in narrowest.colours.difference_dn
        ]
    )
    left = level.colours.vectors_without(light)
    return _Standing(significance=signed_significance(left, level.valid), vectors=left)


def _of_one_sign(one: LinkedRegion, region: Region) -> bool:
    if one.direction is None or region.direction is None:
        return one.significance * region.significance > 0
    return float(one.direction @ region.direction) > _SAME_COLOUR


def _in_midst(
    found: Sequence[LinkedRegion], regions: Sequence[Region], level: DetectionLevel
) -> list[list[LinkedRegion]]:
    """Narrower changes in the midst of each region, of its sign."""
    number = np.full(level.valid.shape, -1)
    for index, region in enumerate(regions):
        core = region.core()
        number[region.rows[core], region.cols[core]] = index
    inner: list[list[LinkedRegion]] = [[] for _ in regions]
    for one in found:
        index = int(number[_place(one, level)])
        if index >= 0 and _of_one_sign(one, regions[index]):
            inner[index].append(one)
    return inner


def _linked(
    region: Region, number: int, levels: Sequence[DetectionLevel], inside: Sequence[LinkedRegion]
) -> LinkedRegion:
    """A region with the pixels of its midst and of the narrower changes in it."""
    level, shape = levels[number], levels[0].valid.shape
    # Of the narrowest level every pixel beyond the threshold is the change's own.
    core = region.core() if number else np.ones(len(region.rows), dtype=np.bool_)
    pixels = [_on_grid(region.rows[core], region.cols[core], level.step_px, levels[0].valid)]
    pixels += [one.rows * shape[1] + one.cols for one in inside]
    light = [_on_grid(region.rows, region.cols, level.step_px, levels[0].valid)]
    light += [one.light for one in inside]
    rows, cols = np.divmod(np.unique(np.concatenate(pixels)), shape[1])
    return LinkedRegion(
        level=number,
        row=region.row * level.step_px,
        col=region.col * level.step_px,
        significance=region.significance,
        rows=rows,
        cols=cols,
        light=np.unique(np.concatenate(light)),
        direction=region.direction,
    )


def _on_grid(rows: IntArray, cols: IntArray, step: int, valid: BoolArray) -> IntArray:
    """Flat indices of the pixels nearest to places of a level."""
    offset = np.arange(step) - step // 2
    row = (rows[:, None, None] * step + offset[:, None]).repeat(step, axis=2).ravel()
    col = (cols[:, None, None] * step + offset).repeat(step, axis=1).ravel()
    inside = (row >= 0) & (row < valid.shape[0]) & (col >= 0) & (col < valid.shape[1])
    row, col = row[inside], col[inside]
    counts = valid[row, col]
    return np.asarray(row[counts] * valid.shape[1] + col[counts])


def pixels_of(found: Sequence[LinkedRegion], shape: tuple[int, ...]) -> BoolArray:
    """Mark the pixels of changes, on a grid of this shape."""
    mask = np.zeros(shape, dtype=np.bool_)
    for region in found:
        mask[region.rows, region.cols] = True
    return mask


_LOWEST_SD = 3.0
"""Below it, peaks run into one another and chance makes more than can be told apart."""

_HIGHEST_SD = 30.0


def q_values(significance: FloatArray, area_px: int, widths: Sequence[FilterWidth]) -> FloatArray:
    """Share of false ones expected among the peaks at least as significant as each.

    ``significance``: of all peaks beyond a threshold, falling, shape ``(n,)``.
    """
    if not len(significance):
        return np.zeros(0)
    by_chance = expected_peaks(significance, area_px, widths)
    share = by_chance / np.arange(1, len(significance) + 1)
    return np.minimum(np.minimum.accumulate(share[::-1])[::-1], 1.0)


def discovery_threshold(levels: Sequence[DetectionLevel], rate: float) -> float:
    """Lowest threshold in standard deviations at which this share of the changes is false.

    Where nothing stands out, the threshold is that which chance exceeds in this share of frames.
    ``levels``: the difference behind each width, the narrowest first. ``rate``: share of false
    changes among those listed, above 0 and below 1.
    """
    if not 0 < rate < 1:
        raise ValueError(f"false_discovery_rate must be between 0 and 1, got {rate}")
    area, widths = int(levels[0].valid.sum()), [level.filter_width for level in levels]
    found = link_levels(levels, _LOWEST_SD).regions
    heights = np.abs([region.significance for region in found])
    is_kept = q_values(heights, area, widths) <= rate
    allowed = rate * max(int(is_kept.sum()), 1)

    def excess(height: float) -> float:
        return float(np.log(expected_peaks(np.array(height), area, widths) / allowed))

    if excess(_LOWEST_SD) <= 0:
        return _LOWEST_SD
    return float(brentq(excess, _LOWEST_SD, _HIGHEST_SD))


def beyond_outlines(
    regions: Sequence[LinkedRegion], drawn_apart: tuple[BoolArray, BoolArray] | None
) -> BoolArray:
    """Tell the regions that are more than outlines a pixel away; all but of drawings.

    ``drawn_apart``: as of `Comparison`. A line that is sampled anew, or scanned again, steps from
    row to row elsewhere: over its length a wide filter takes that for a change.
    """
    if drawn_apart is None:
        return np.ones(len(regions), dtype=np.bool_)
    differs, more = (
        np.array([np.count_nonzero(mask[region.rows, region.cols]) for region in regions])
        for mask in drawn_apart
    )
    return np.asarray(more >= np.maximum(_BEYOND_OUTLINES * differs, _LEAST_BEYOND_PX))
