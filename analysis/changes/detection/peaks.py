"""Connected places of one sign beyond a threshold, at one level."""

from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import cv2
import numpy as np

from simulation.arrays import BoolArray, Float32Array, FloatArray, FloatImage, IntArray

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


def connected_colours(
    vectors: Float32Array, significance: FloatImage, threshold_sd: float
) -> list[Region]:
    """Find the connected regions of one change of colour beyond a threshold.

    What is connected has a direction in which it varies most; places on either side of it are
    apart, as those of opposite signs are.

    Parameters
    ----------
    vectors
        Whitened planes, shape ``(3, rows, cols)``, the luma first.
    significance
        Of those, of any sign.
    threshold_sd
        Not negative; a region lies strictly beyond it.
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
