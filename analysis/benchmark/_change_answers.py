"""What programs say of changes: their answers, and the places that are none.

A place is a connected region (8 neighbours) of pixels above the threshold. So that a region that
covers a frame is not a single place, each full percent of the frame above the threshold counts as
one more. As the threshold falls, regions appear, grow together and cover more; what counts is the
first time, from above, that there are too many.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_dilation, label

from analysis.benchmark._data_set import BenchmarkData, ChangesTask, Places, TrueChanges, TrueSpot
from analysis.benchmark._program_files import given_levels
from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray

_PERCENT = 100


@dataclass(frozen=True, slots=True, kw_only=True)
class _PlaceCounts:
    """Places of one map for thresholds just below each of its levels, which fall.

    ``counts[i]`` holds for thresholds from ``levels[i + 1]`` to below ``levels[i]``. The last count
    is infinite where the map was not followed further.
    """

    levels: FloatArray
    counts: FloatArray


def place_counts(change_map: Float32Array, most: float) -> _PlaceCounts:
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
    return _PlaceCounts(levels=np.array(levels), counts=np.array(counts, np.float64))


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
    def of(cls, found: Sequence[_PlaceCounts]) -> "PlaceSteps":
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


_LARGEST_DN = 4095.0
FALSE_PIXELS = 1e-4
"""Share of unchanged pixels that may be above the threshold where pixels are counted."""

_EIGHT = np.ones((3, 3), dtype=np.int64)
_MIXED_PX = 2
"""Beside what the reference does not show: as far as lenses spread it."""

_AROUND_PX = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class _ChangedSpot:
    """A spot as the camera sees it: the peak of the difference it makes, in DN and in noises.

    ``amplitude_dn`` is 0 where the camera's levels are clipped: nobody can find that spot.
    """

    truth: TrueSpot
    amplitude_dn: float
    noise_dn: float

    @property
    def found_px(self) -> float:
        """Within this a score belongs to the spot."""
        return max(2.0, 1.5 * self.truth.sigma_px)

    @property
    def away_px(self) -> float:
        """Further away a region or a detection is false."""
        return 3 * self.truth.sigma_px + 4

    def distance_px(self, x_px: float, y_px: float) -> float:
        """From a place to the spot's centre."""
        return hypot(x_px - self.truth.x_px, y_px - self.truth.y_px)


@dataclass(frozen=True, slots=True, kw_only=True)
class TruePair:
    """A pair and its truth; ``is_painted`` are the pixels that differ by half a spot's peak.

    ``is_unseen`` are those that the reference does not show, and those beside them. Nobody can say
    whether they changed: whatever a program says of them counts for nothing.
    """

    name: str
    truth: TrueChanges
    shape: tuple[int, int]
    spots: tuple[_ChangedSpot, ...]
    is_painted: BoolArray | None
    is_unseen: BoolArray | None

    @classmethod
    def read(
        cls, data: BenchmarkData, task: ChangesTask, truth: TrueChanges, scale: float
    ) -> "TruePair":
        """Read what is known of a pair; ``scale`` are the levels of a DN in the truth.

        Raises
        ------
        ResultsFileError
            If a picture of the data set cannot be used.
        """
        levels_dn = _linear_dn(data, task)
        shape = (levels_dn.shape[0], levels_dn.shape[1])
        is_unseen = None
        if truth.unseen is not None:
            marked = data.levels(truth.unseen, shape) != 0
            is_unseen = np.asarray(binary_dilation(marked, _EIGHT, _MIXED_PX), np.bool_)
        if not truth.changed:
            return cls(
                name=task.task,
                truth=truth,
                shape=shape,
                spots=(),
                is_painted=None,
                is_unseen=is_unseen,
            )
        made_dn = np.abs(data.levels(f"truth/changes/{task.task}.tif", shape) / scale)
        spots, is_painted = [], np.zeros(shape, np.bool_)
        for spot in truth.spots:
            peak = _ChangedSpot(truth=spot, amplitude_dn=0.0, noise_dn=0.0)
            near = within(shape, spot, peak.found_px)
            amplitude_dn = float(made_dn[near].max(initial=0.0))
            above_black = max(_around(levels_dn, spot) - task.black_level, 0.0)
            variance = task.noise.variance_at_black_dn2 + task.noise.variance_per_dn * above_black
            spots.append(
                _ChangedSpot(truth=spot, amplitude_dn=amplitude_dn, noise_dn=sqrt(variance))
            )
            is_half = (made_dn >= amplitude_dn / 2) & (made_dn > 0)
            is_painted |= within(shape, spot, peak.away_px) & is_half
        return cls(
            name=task.task,
            truth=truth,
            shape=shape,
            spots=tuple(spots),
            is_painted=is_painted,
            is_unseen=is_unseen,
        )

    @property
    def seen(self) -> list[_ChangedSpot]:
        """The spots that make a difference."""
        return [spot for spot in self.spots if spot.amplitude_dn > 0]

    def is_false(self, x_px: float, y_px: float) -> bool:
        """Whether a place is far from every spot, and both photographs show it."""
        if self.is_unseen is not None:
            row, col = (
                min(max(round(at), 0), size - 1)
                for at, size in zip((y_px, x_px), self.shape, strict=True)
            )
            if self.is_unseen[row, col]:
                return False
        return all(spot.distance_px(x_px, y_px) > spot.away_px for spot in self.spots)

    def scores_in(self, path: Path) -> Float32Array:
        """Read a program's map of the pair; NaN where nothing counts.

        Raises
        ------
        ResultsFileError
            If the map cannot be used.
        """
        scores = given_levels(path, self.shape)
        if self.is_unseen is not None:
            scores = np.where(self.is_unseen, np.float32(np.nan), scores)
        return scores


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedPair:
    """What a program's map says of a pair.

    ``counts`` and ``top`` (its highest pixels, of ``judged_px``) are of unchanged pairs alone;
    ``spot_scores`` and ``painted`` (the scores of painted pixels) of changed ones, -inf where the
    map has NaN.
    """

    path: Path
    largest: float
    judged_px: int
    counts: _PlaceCounts | None
    top: Float32Array
    spot_scores: FloatArray
    painted: Float32Array


def judged(pair: TruePair, path: Path, frames: int, pixels: int) -> JudgedPair | None:
    """Read a program's map of a pair; None where it judges no pixel.

    Parameters
    ----------
    pair
        The pair.
    path
        The map.
    frames, pixels
        Of all unchanged pairs: how many they are, and their pixels.

    Raises
    ------
    ResultsFileError
        If the map cannot be used.
    """
    scores = pair.scores_in(path)
    levels = scores[~np.isnan(scores)]
    if not levels.size:
        return None
    counts, top, painted = None, levels[:0], levels[:0]
    if pair.truth.changed:
        painted = np.where(np.isnan(scores), -np.inf, scores)[pair.is_painted].astype(np.float32)
    else:
        # Scenes are drawn again: a pair may count several times, in frames that are fewer.
        counts = place_counts(scores, 2.0 * frames + 1)
        kept = min(int(FALSE_PIXELS * pixels) + 1, levels.size)
        top = np.partition(levels, levels.size - kept)[levels.size - kept :]
    return JudgedPair(
        path=path,
        largest=float(levels.max()),
        judged_px=levels.size,
        counts=counts,
        top=top,
        spot_scores=np.array([_score_at(scores, spot) for spot in pair.seen]),
        painted=painted,
    )


def false_regions(pair: TruePair, path: Path, threshold: float) -> int:
    """Count the regions of a map above a threshold that lie far from every spot.

    Raises
    ------
    ResultsFileError
        If the map cannot be used.
    """
    scores = pair.scores_in(path)
    regions, count = label(np.nan_to_num(scores, nan=-np.inf) > threshold, _EIGHT)
    near = np.zeros(pair.shape, np.bool_)
    for spot in pair.spots:
        near |= within(pair.shape, spot.truth, spot.away_px)
    touching = np.unique(regions[near])
    return int(count - np.count_nonzero(touching))


@dataclass(frozen=True, slots=True, kw_only=True)
class _OwnDetections:
    """How a program's own detections fit a pair: spots found, of how many, and false places."""

    found: int
    spots: int
    false_places: int


def own_detections(pair: TruePair, places: Places) -> _OwnDetections:
    """Hold a program's own detections against a pair's spots."""
    found = sum(
        any(spot.distance_px(*place) <= spot.found_px for place in places) for spot in pair.seen
    )
    false_places = sum(pair.is_false(*place) for place in places)
    return _OwnDetections(found=found, spots=len(pair.seen), false_places=false_places)


def within(shape: tuple[int, int], spot: TrueSpot, radius_px: float) -> BoolArray:
    """Which pixels lie within a radius of a spot's centre, its rim included."""
    y, x = np.ogrid[: shape[0], : shape[1]]
    is_near = (x - spot.x_px) ** 2 + (y - spot.y_px) ** 2 <= radius_px**2
    return np.asarray(is_near, np.bool_)


def _score_at(scores: Float32Array, spot: _ChangedSpot) -> float:
    """Largest score near a spot; -inf where the map has none."""
    near = scores[within((scores.shape[0], scores.shape[1]), spot.truth, spot.found_px)]
    judged_ = near[~np.isnan(near)]
    return float(judged_.max()) if judged_.size else -np.inf


def _linear_dn(data: BenchmarkData, task: ChangesTask) -> FloatArray:
    """Levels of the follow-up on the linear scale."""
    if task.encoding == "linear":
        return data.levels(task.followup).astype(np.float64)
    encoded = data.encoded(task.followup).astype(np.float64) / task.max_level
    low, high = encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4
    return _LARGEST_DN * np.where(encoded <= 0.04045, low, high)


def _around(levels_dn: FloatArray, spot: TrueSpot) -> float:
    """Median level around a spot's centre."""
    row, col = round(spot.y_px), round(spot.x_px)
    around = levels_dn[
        max(row - _AROUND_PX, 0) : row + _AROUND_PX + 1,
        max(col - _AROUND_PX, 0) : col + _AROUND_PX + 1,
    ]
    return float(np.median(around))
