"""Any zoom-out model at positions off a grid, such as those of a captured follow-up's pixels.

The models sample a grid. Shifted by fractions of a pixel, such grids interleave to an image so
fine that a spline can read it anywhere, while every follow-up pixel is still the model's.
"""

from collections.abc import Callable
from math import ceil, floor
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from simulation.arrays import FloatArray
from simulation.resampling.grid import SamplingGrid

_FINE_PITCH_PX = 0.5
"""Pitch of the fine image in reference px; the spline reads it with errors below 1e-3 there."""

_MARGIN_PIXELS = 6
"""Follow-up pixels around the positions, to exclude a model's own border."""


def simulate_at(
    simulate: Callable[[SamplingGrid], NDArray[np.floating[Any]]],
    reference_shape: tuple[int, int],
    zoom: float,
    y_px: FloatArray,
    x_px: FloatArray,
) -> FloatArray:
    """Follow-up pixels at any positions in the reference.

    Parameters
    ----------
    simulate
        Returns the follow-up on a grid, such as ``zoom_out_on_grid`` of an image.
    reference_shape
        ``(rows, cols)`` of the reference.
    zoom
        Reference pixels per follow-up pixel, at least ``ZOOM_MIN``; the same everywhere, whatever
        the spacing of the positions.
    y_px, x_px
        Reference coordinates of the pixels, inside the reference, any shape.

    Returns
    -------
    ndarray of float64, of that shape

    Raises
    ------
    ValueError
        If a position is outside the reference by more than half a pixel.
    """
    factor = max(ceil(zoom / _FINE_PITCH_PX), 1)
    axes = [
        _axis(positions, size, zoom)
        for positions, size in zip((y_px, x_px), reference_shape, strict=True)
    ]
    (top_px, rows), (left_px, cols) = axes
    pitch_px = zoom / factor
    fine = np.empty((rows * factor, cols * factor))
    for down in range(factor):
        for right in range(factor):
            grid = SamplingGrid(
                zoom_y=zoom,
                zoom_x=zoom,
                origin_y_px=top_px + down * pitch_px,
                origin_x_px=left_px + right * pitch_px,
                # The last shifted grid may extend beyond the border by a pixel.
                rows=_count(top_px + down * pitch_px, reference_shape[0], zoom, rows),
                cols=_count(left_px + right * pitch_px, reference_shape[1], zoom, cols),
            )
            part = simulate(grid)
            missing = (rows - grid.rows, cols - grid.cols)
            fine[down::factor, right::factor] = np.pad(
                part, ((0, missing[0]), (0, missing[1])), mode="edge"
            )
    positions = [(y_px - top_px) / pitch_px, (x_px - left_px) / pitch_px]
    return np.asarray(map_coordinates(fine, positions, order=5, mode="nearest"))


def _axis(positions_px: FloatArray, size: int, zoom: float) -> tuple[float, int]:
    """First position and number of pixels of a grid around positions, inside the reference."""
    low, high = float(positions_px.min()), float(positions_px.max())
    if not (low >= -0.5 and high <= size - 0.5):
        raise ValueError(
            f"positions from {low:.3g} to {high:.3g} px are outside a reference of {size} px"
        )
    before = min(_MARGIN_PIXELS, floor((low + 0.5) / zoom))
    first = low - before * zoom
    count = floor((high - first) / zoom + 1e-9) + 1 + _MARGIN_PIXELS
    return first, _count(first, size, zoom, count)


def _count(first_px: float, size: int, zoom: float, wanted: int) -> int:
    """Number of pixels from ``first_px`` on inside the reference, at most ``wanted``."""
    return max(min(wanted, floor((size - 0.5 - first_px) / zoom + 1e-9) + 1), 1)
