"""Marks of a detector's map: its highest local maxima, apart from each other."""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.ndimage import maximum_filter

from simulation.arrays import BoolArray, Float32Array, FloatArray

MOST_MARKS = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class Disc:
    """A change's place: follow-up pixels, ``(0, 0)`` the centre of the first one, and radius."""

    x_px: float
    y_px: float
    radius_px: float

    def __post_init__(self) -> None:
        if not self.radius_px > 0:
            raise ValueError(f"radius_px must be positive, got {self.radius_px}")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Marks:
    """Scores and places of a map's marks, shape (k,), highest first; pixel centres at integers."""

    scores: FloatArray
    x_px: FloatArray
    y_px: FloatArray

    def is_within(self, disc: Disc) -> BoolArray:
        """Which of them lie in a disc, its rim included, shape (k,)."""
        return np.hypot(self.x_px - disc.x_px, self.y_px - disc.y_px) <= disc.radius_px


def marks_of(change_map: Float32Array, count: int, apart_px: float) -> Marks:
    """Find the highest local maxima of a map.

    A mark is a pixel that none within ``apart_px`` exceeds; of equal ones so near to each other the
    first by rows counts. NaN and -inf are pixels that do not count.

    Parameters
    ----------
    change_map
        Shape (rows, cols), higher where it looks more changed.
    count
        Marks at most, from 1 to ``MOST_MARKS``.
    apart_px
        Least distance of two marks, in pixels, at least 1.

    Raises
    ------
    ValueError
        If the map is not two-dimensional, or an argument is out of its range.
    """
    if change_map.ndim != 2 or change_map.size == 0:
        raise ValueError(f"a map has rows and columns, got shape {change_map.shape}")
    if not 1 <= count <= MOST_MARKS:
        raise ValueError(f"count must be from 1 to {MOST_MARKS}, got {count}")
    if not apart_px >= 1:
        raise ValueError(f"apart_px must be at least 1, got {apart_px}")
    levels = np.where(np.isnan(change_map), -np.inf, change_map)
    # A square inside of the disc takes two passes; its few maxima are asked for the disc singly.
    side = 2 * int(apart_px / sqrt(2)) + 1
    is_candidate = (levels == maximum_filter(levels, size=side)) & (levels > -np.inf)
    y, x = np.nonzero(is_candidate)
    is_left = np.ones(y.size, dtype=np.bool_)
    chosen: list[int] = []
    for each in np.argsort(-levels[y, x], kind="stable").tolist():
        if len(chosen) == count:
            break
        if is_left[each] and _is_highest(levels, int(y[each]), int(x[each]), apart_px):
            chosen.append(each)
            is_left &= np.hypot(x - x[each], y - y[each]) > apart_px
    return Marks(
        scores=levels[y, x][chosen].astype(np.float64),
        x_px=x[chosen].astype(np.float64),
        y_px=y[chosen].astype(np.float64),
    )


def _is_highest(levels: Float32Array, y: int, x: int, radius_px: float) -> bool:
    """Whether no pixel of the disc around one exceeds it."""
    reach = int(radius_px)
    top, left = max(y - reach, 0), max(x - reach, 0)
    around = levels[top : y + reach + 1, left : x + reach + 1]
    rows, cols = np.indices(around.shape)
    is_near = np.hypot(rows + top - y, cols + left - x) <= radius_px
    return not np.any(around[is_near] > levels[y, x])
