"""False places of change maps against the threshold, and the threshold that allows so many.

A place is a connected region (8 neighbours) of pixels above the threshold. So that a region that
covers a frame is not a single place, each full percent of the frame above the threshold counts as
one more. As the threshold falls, regions appear, grow together and cover more; what counts is the
first time, from above, that there are too many.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simulation.arrays import Float32Array, FloatArray, IntArray

_PERCENT = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceCounts:
    """Places of one map for thresholds just below each of its levels, which fall.

    ``counts[i]`` holds for thresholds from ``levels[i + 1]`` to below ``levels[i]``. The last count
    is infinite where the map was not followed further.
    """

    levels: FloatArray
    counts: FloatArray


def place_counts(change_map: Float32Array, most: float) -> PlaceCounts:
    """Follow the places of a map from its highest level down, until there are more than ``most``.

    Parameters
    ----------
    change_map
        Shape (rows, cols); NaN are pixels that do not count.
    most
        Number of places beyond which nobody asks.
    """
    cols = change_map.shape[1]
    flat = change_map.ravel()
    judged = np.flatnonzero(~np.isnan(flat))
    order = judged[np.argsort(-flat[judged], kind="stable")]
    values = flat[order]
    ends = np.append(np.flatnonzero(np.diff(values)) + 1, values.size)
    starts = np.append(0, ends[:-1])
    regions = _Regions(cols, flat.size)
    levels: list[float] = []
    counts: list[float] = []
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True) if values.size else ():
        for pixel in order[start:end].tolist():
            regions.add(pixel)
        count = regions.count + _PERCENT * end // values.size
        if not counts or count != counts[-1]:
            levels.append(float(values[start]))
            counts.append(count if count <= most else np.inf)
        if count > most:
            break
    return PlaceCounts(levels=np.array(levels), counts=np.array(counts, np.float64))


class _Regions:
    """Connected regions of pixels that are added one by one."""

    def __init__(self, cols: int, pixels: int) -> None:
        self._cols, self._pixels = cols, pixels
        self._parent: dict[int, int] = {}
        self.count = 0

    def add(self, pixel: int) -> None:
        parent, cols = self._parent, self._cols
        parent[pixel] = pixel
        self.count += 1
        col = pixel % cols
        across = (-1, 0, 1) if 0 < col < cols - 1 else (0, 1) if col == 0 else (-1, 0)
        for down in (-cols, 0, cols):
            for side in across if cols > 1 else (0,):
                other = pixel + down + side
                if other != pixel and other in parent:
                    first, second = self._root(pixel), self._root(other)
                    if first != second:
                        parent[second] = first
                        self.count -= 1

    def _root(self, pixel: int) -> int:
        parent = self._parent
        while parent[pixel] != pixel:
            parent[pixel] = parent[parent[pixel]]
            pixel = parent[pixel]
        return pixel


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceSteps:
    """All changes of the number of places of several maps, from the highest level down.

    ``levels`` fall; at each the number of places of map ``maps`` changes by ``steps``.
    """

    levels: FloatArray
    maps: IntArray
    steps: FloatArray

    @classmethod
    def of(cls, found: Sequence[PlaceCounts]) -> "PlaceSteps":
        """Put the counts of several maps in one order."""
        levels = np.concatenate([one.levels for one in found])
        maps = np.repeat(np.arange(len(found)), [one.levels.size for one in found])
        steps = np.concatenate([np.diff(one.counts, prepend=0.0) for one in found])
        order = np.argsort(-levels, kind="stable")
        return cls(levels=levels[order], maps=maps[order].astype(np.int64), steps=steps[order])

    def threshold(self, places_a_map: float, weights: FloatArray) -> float:
        """Lowest threshold down to which there are at most so many places a map on average.

        Pixels above it count as changed. It is -inf where there are never too many.

        Parameters
        ----------
        places_a_map
            The number allowed.
        weights
            How often each map counts, shape (maps,).
        """
        drawn = weights[self.maps]
        counts = np.zeros(drawn.size)  # no weight times an infinite step is no step
        np.multiply(drawn, self.steps, out=counts, where=drawn > 0)
        counts = np.cumsum(counts)
        # Maps of one level change together.
        is_end = np.append(self.levels[1:] != self.levels[:-1], True)
        allowed = places_a_map * weights.sum() * (1 + 1e-12)
        beyond = np.flatnonzero(is_end & (counts > allowed))
        return float(self.levels[beyond[0]]) if beyond.size else -np.inf


def level_exceeded_by(ordered: Sequence[Float32Array], pixels: int, share: float) -> float:
    """Lowest level that at most a share of the pixels of several maps exceed.

    Parameters
    ----------
    ordered
        The highest levels of each map; of all together at least the highest ``share`` and one more.
    pixels
        The number of pixels of all maps.
    share
        Between 0 and 1.
    """
    falling = np.sort(np.concatenate(ordered))[::-1]
    allowed = int(share * pixels)
    return float(falling[allowed]) if allowed < falling.size else -np.inf
