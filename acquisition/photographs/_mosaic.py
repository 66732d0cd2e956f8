"""Whether grey levels are those of a raw mosaic that its file does not call one.

Programs of machine-vision cameras save BayerRG8 and the like as a grey picture. The colours of a
scene and of its light differ, so that two of every square of four pixels, the green ones on a
diagonal, agree on average, and the others do not.
"""

import numpy as np

from simulation.arrays import AnyArray

UNNAMED_MOSAIC = "unnamed mosaic"
"""The kind of a remark on such a picture."""

_LARGEST_PX = 1024
_SMALLEST_PX = 32
_DIFFERENT = 0.04
"""Of the mean level. Nothing in a scene goes with single pixels, and rows and columns of sensors
differ by a percent at most."""
_ALIKE = 0.25
"""Of the difference between the colours."""
_STANDARD_ERRORS = 8.0
_MOSTLY = 0.75
"""Of all squares have the same colour brighter."""


def seems_mosaic(pixels: AnyArray) -> bool:
    """Whether a picture, shape ``(rows, cols)``, alternates as a Bayer mosaic does."""
    rows, cols = (2 * (side // 2) for side in pixels.shape)
    if pixels.dtype.kind not in "uif" or min(rows, cols) < _SMALLEST_PX:
        return False
    top, left = (2 * (max(side - _LARGEST_PX, 0) // 4) for side in (rows, cols))
    middle = pixels[top : min(top + _LARGEST_PX, rows), left : min(left + _LARGEST_PX, cols)]
    cells = np.stack(
        [middle[row::2, col::2].astype(np.float32).ravel() for row, col in np.ndindex(2, 2)]
    )
    means = cells.mean(axis=1)
    if not means.mean() > 0:
        return False
    return _are_green(cells, means, (0, 3), (1, 2)) or _are_green(cells, means, (1, 2), (0, 3))


def _are_green(
    cells: AnyArray, means: AnyArray, greens: tuple[int, int], others: tuple[int, int]
) -> bool:
    green = (cells[greens[0]] + cells[greens[1]]) / 2
    apart = abs(float(means[greens[0]] - means[greens[1]]))
    largest = max(others, key=lambda cell: abs(float(means[cell]) - float(green.mean())))
    change = cells[largest] - green
    size = abs(float(change.mean()))
    error = float(change.std()) / np.sqrt(change.size)
    return bool(
        size > max(_DIFFERENT * float(means.mean()), _STANDARD_ERRORS * error)
        and apart < _ALIKE * size
        and np.mean(np.sign(change) == np.sign(change.mean())) > _MOSTLY
    )
