"""Flat scenes that are known exactly everywhere: cubic B-splines of coefficients on a fine grid."""

from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

SAMPLES_PER_PX = 4
"""Coefficients along one pixel of the reference."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SplineScene:
    """A scene whose middle is the middle of the reference; 1 is white, mirrored at its borders.

    ``coefficients`` has `SAMPLES_PER_PX` to a pixel of the reference, whose frame is ``shape``.
    """

    name: str
    shape: tuple[int, int]
    coefficients: FloatArray = field(repr=False)

    def at(self, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
        """Light at positions in reference pixels; both of one shape."""
        rows, cols = self.coefficients.shape
        x = (x_px - (self.shape[1] - 1) / 2) * SAMPLES_PER_PX + (cols - 1) / 2
        y = (y_px - (self.shape[0] - 1) / 2) * SAMPLES_PER_PX + (rows - 1) / 2
        return spline_at(self.coefficients, x, y)


def spline_at(
    coefficients: FloatArray | NDArray[np.float32], x: FloatArray, y: FloatArray
) -> FloatArray:
    """Cubic B-spline at positions in units of its coefficients; mirrored at its borders."""
    flat = _spline_at(coefficients, np.ravel(x), np.ravel(y))
    return np.asarray(flat.reshape(np.shape(x)))


@njit(cache=True)
def _spline_at(
    coefficients: FloatArray | NDArray[np.float32], x: FloatArray, y: FloatArray
) -> FloatArray:
    rows, cols = coefficients.shape
    levels = np.empty(len(x))
    across, down = np.empty(4), np.empty(4)
    col, row = np.empty(4, dtype=np.int64), np.empty(4, dtype=np.int64)
    for i in range(len(x)):
        _taps(x[i], cols, across, col)
        _taps(y[i], rows, down, row)
        level = 0.0
        for j in range(4):
            line = 0.0
            for k in range(4):
                line += across[k] * coefficients[row[j], col[k]]
            level += down[j] * line
        levels[i] = level
    return levels


@njit(cache=True)
def _taps(position: float, count: int, weight: FloatArray, index: NDArray[np.int64]) -> None:
    first = int(np.floor(position))
    t = position - first
    weight[0] = (1 - t) ** 3 / 6
    weight[1] = (4 - 6 * t * t + 3 * t**3) / 6
    weight[2] = (1 + 3 * t + 3 * t * t - 3 * t**3) / 6
    weight[3] = t**3 / 6
    if first >= 1 and first + 2 < count:
        for j in range(4):
            index[j] = first - 1 + j
        return
    for j in range(4):
        position_index = (first - 1 + j) % (2 * count)
        mirrored = 2 * count - 1 - position_index
        index[j] = position_index if position_index < count else mirrored
