"""Connected places of one sign beyond a threshold, at one level."""

from dataclasses import dataclass

import cv2
import numpy as np

from simulation.arrays import BoolArray, FloatArray, FloatImage, IntArray

_CORE = 0.5


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
    """

    row: int
    col: int
    significance: float
    rows: IntArray
    cols: IntArray
    heights: FloatArray

    def core(self) -> BoolArray:
        """Which places have at least half the height; the others are its blurred skirt."""
        return np.asarray(self.heights >= _CORE * abs(self.significance))


def connected_regions(significance: FloatImage, threshold_sd: float) -> list[Region]:
    """Find the connected regions beyond a threshold, the most significant first.

    Places that touch at a corner are connected; those of opposite signs are not.

    Parameters
    ----------
    significance
        Signed standard deviations, shape ``(rows, cols)``.
    threshold_sd
        Not negative; a region lies strictly beyond it.
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
