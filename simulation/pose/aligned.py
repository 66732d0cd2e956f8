"""Sampling along a warp that keeps the directions of rows and columns, as a plain zoom does.

The sampling kernel is a product of one along y and one along x, so that two banded matrices do what
`simulation.pose.sampling` does pixel by pixel, in a quarter of the time.
"""

import numpy as np

from simulation.arrays import FloatImage
from simulation.pose.sampling import Canvas, CoefficientWindow, mark
from simulation.pose.view import PoseView
from simulation.resampling import BandedMatrix, apply_separable


def keeps_axes(view: PoseView) -> bool:
    """Whether a view's rows and columns are those of the reference, at other distances."""
    matrix = view.matrix
    others = matrix[0, 1], matrix[1, 0], matrix[2, 0], matrix[2, 1]
    return bool(view.lens[0] == 0 and not any(others))


def render_aligned(
    view: PoseView,
    window: CoefficientWindow,
    canvas: Canvas,
    first: tuple[int, int],
    shape: tuple[int, int],
) -> None:
    """Write a tile as `simulation.pose.sampling.render` does, where the view `keeps_axes`."""
    mark(view.warp, window.size, canvas, first, shape)
    tile = tuple(slice(start, start + count) for start, count in zip(first, shape, strict=True))
    inside = ~canvas.outside[tile]
    # What is seen of the reference is a rectangle.
    rows, cols = (first[axis] + np.flatnonzero(inside.any(axis=1 - axis)) for axis in (0, 1))
    if len(rows) == 0:
        return
    (scale_x, _, shift_x), (_, scale_y, shift_y) = view.matrix[:2] / view.matrix[2, 2]
    height, width = window.coefficients.shape
    along_y = _sampling(scale_y * rows + shift_y - window.origin[0], window.table, height)
    along_x = _sampling(scale_x * cols + shift_x - window.origin[1], window.table, width)
    made = apply_separable(along_y, along_x, window.coefficients)
    canvas.image[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1] = made


def _sampling(at_px: FloatImage, table: FloatImage, count: int) -> BandedMatrix:
    """Matrix from ``count`` coefficients to the values at positions among them."""
    before = np.floor(at_px)
    powers = (at_px - before)[:, None] ** np.arange(len(table))
    weights = np.asarray(powers @ table[:, :6], dtype=np.float64)
    return BandedMatrix(before.astype(np.int64) - 2, weights, count)
