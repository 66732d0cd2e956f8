"""Changes out of the regions that each level finds: one entry a change, at the level that fits it.

From the narrowest level to the widest: a wide region takes the narrower ones of its sign in whose
midst they lie, if it stands out further than they do together. The light of the others is taken
out, or every strong change would be found again by all wider filters; what is then left beyond
the threshold is a change of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot

import numpy as np

from analysis.changes.detection.level_colours import signed_significance
from analysis.changes.detection.levels import DetectionLevel
from analysis.changes.detection.peaks import Region, connected_colours, connected_regions
from analysis.changes.matching import away_from
from simulation.arrays import BoolArray, Float32Array, FloatArray, FloatImage, IntArray

_SKIRT = 2.0
"""Widths of its level within which a change still has light."""

_SAME_COLOUR = 0.5
"""Cosine between the directions of two changes of colour, above which they are of one sign."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LinkedRegion:
    """A change: where it stands out most, of all levels.

    Parameters
    ----------
    level
        Number of the level that fits it best.
    row, col
        Its strongest pixel, of the comparison's grid.
    significance
        Standard deviations there, signed.
    rows, cols
        Its pixels, shape ``(n,)``.
    light
        Those and the ones that its blurred skirt reaches beyond the threshold, flat indices.
    direction
        Of colours, that of the change in the level's whitened planes, of length 1; the sign of the
        significance is then the luma's.
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
        return connected_colours(self.vectors, self.significance, threshold_sd)

    def height_of(self, found: "LinkedRegion", place: tuple[int, int]) -> float:
        """Significance there in the direction of a change."""
        if self.vectors is None or found.direction is None:
            return float(self.significance[place]) * float(np.sign(found.significance))
        along = float(found.direction @ self.vectors[:, *place])
        return float(np.copysign(abs(self.significance[place]), along))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FoundChanges:
    """What stands out at any level.

    Parameters
    ----------
    regions
        The most significant first.
    significance
        Signed significance of every pixel at the level where it stands out most.
    """

    regions: tuple[LinkedRegion, ...]
    significance: Float32Array


def link_levels(levels: Sequence[DetectionLevel], threshold_sd: float) -> FoundChanges:
    """Find the changes beyond a threshold at any of the levels.

    Parameters
    ----------
    levels
        The narrowest first; its places are the pixels of the comparison's grid.
    threshold_sd
        Significance beyond which a place counts as changed.
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
    settled = [one for one in found if _height_at(one, everything, level) <= _height(one)]
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


def _height_at(found: LinkedRegion, standing: _Standing, level: DetectionLevel) -> float:
    """Significance that a change has at a level, in its own direction."""
    return standing.height_of(found, _place(found, level))


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
        return _colours_without(apart, standing.vectors, narrowest, level)
    light = np.where(apart, np.float32(0), narrowest.difference_dn)
    own = level.smoothed_from(light, narrowest.width_px) / level.sd_dn
    left = standing.significance - np.where(level.valid, own, np.float32(0))
    return _Standing(significance=np.asarray(left))


def _colours_without(
    apart: BoolArray, vectors: Float32Array, narrowest: DetectionLevel, level: DetectionLevel
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
    left = vectors - level.colours.whitened(light)
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
