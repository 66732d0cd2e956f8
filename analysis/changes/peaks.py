"""Connected pixels of one sign beyond a threshold, and the strongest of each."""

from dataclasses import dataclass

import cv2
import numpy as np

from simulation.arrays import BoolArray, FloatArray, FloatImage, IntArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ConnectedPeaks:
    """The most significant first; shape ``(n,)`` each.

    Parameters
    ----------
    row, col
        The strongest pixel.
    significance
        Its standard deviations, positive.
    area_px
        Number of connected pixels.
    """

    row: IntArray
    col: IntArray
    significance: FloatArray
    area_px: IntArray

    def __len__(self) -> int:
        return len(self.row)


def connected_peaks(significance: FloatImage, threshold_sd: float) -> ConnectedPeaks:
    """Find the connected regions beyond a threshold.

    Pixels that touch at a corner are connected; those of opposite signs are not.

    Parameters
    ----------
    significance
        Signed standard deviations, shape ``(rows, cols)``.
    threshold_sd
        Not negative; a region lies strictly beyond it.
    """
    above, below = (_regions(significance * sign, threshold_sd) for sign in (1, -1))
    both = np.concatenate([above, below])
    # Ties in the order of rows and columns.
    both = both[np.lexsort((both[:, 1], both[:, 0], -both[:, 2]))]
    row, col, area = (both[:, column].astype(np.int64) for column in (0, 1, 3))
    return ConnectedPeaks(row=row, col=col, significance=both[:, 2], area_px=area)


def _regions(height: FloatImage, threshold_sd: float) -> FloatArray:
    """Row, column, height and area of each region, shape (n, 4)."""
    mask: BoolArray = np.asarray(height > threshold_sd)
    if not mask.any():
        return np.zeros((0, 4))
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    rows, cols = np.nonzero(mask)
    label, values = labels[rows, cols] - 1, height[rows, cols]
    order = np.lexsort((cols, rows, -values, label))
    first = np.searchsorted(label[order], np.arange(count - 1))
    top = order[first]
    area = np.bincount(label, minlength=count - 1)
    return np.stack([rows[top], cols[top], values[top], area], axis=1).astype(np.float64)
