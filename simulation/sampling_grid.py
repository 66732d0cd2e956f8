"""Positions of a follow-up's pixels in its reference, and what models require of a reference."""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, floor, isfinite
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from simulation.arrays import AnyArray, FloatArray

_ZOOM_MIN = 0.99
"""Least zoom of a grid: measured zooms of captures at equal heights scatter around 1."""

_WHOLE_PIXEL_SLACK = 1e-9
"""Slack so that 300 / 1.2 counts as 250 pixels despite rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplingGrid:
    """An axis-aligned grid of follow-up pixels, in reference pixels.

    Pixel ``(row, col)`` of the follow-up is at reference coordinates ``(origin_y_px + row * zoom_y,
    origin_x_px + col * zoom_x)``; pixel centres are integers. The zooms are at least ``_ZOOM_MIN``;
    ``rows`` and ``cols`` are the size of the follow-up.
    """

    zoom_y: float
    zoom_x: float
    origin_y_px: float
    origin_x_px: float
    rows: int
    cols: int

    def __post_init__(self) -> None:
        for name in ("zoom_y", "zoom_x"):
            value = getattr(self, name)
            if not (value >= _ZOOM_MIN and isfinite(value)):
                raise ValueError(f"{name} must be a number of at least {_ZOOM_MIN}, got {value}")
        for name in ("origin_y_px", "origin_x_px"):
            if not isfinite(getattr(self, name)):
                raise ValueError(f"{name} must be finite, got {getattr(self, name)}")
        if self.rows < 1 or self.cols < 1:
            raise ValueError(f"a grid needs at least one pixel, got {self.rows} x {self.cols}")

    @classmethod
    def centred(cls, reference_shape: tuple[int, int], zoom: float) -> Self:
        """Make the grid of a camera moved straight back: both image centres coincide.

        Of a reference of N pixels along an axis, the follow-up has ``n = floor(N / zoom)``, pixel i
        at ``(i - (n - 1) / 2) * zoom + (N - 1) / 2``. The zoom is at least 1.
        """
        if not (zoom >= 1 and isfinite(zoom)):
            raise ValueError(f"zoom must be a finite number of at least 1, got {zoom}")
        rows, cols = (floor(size / zoom + _WHOLE_PIXEL_SLACK) for size in reference_shape)
        if rows < 1 or cols < 1:
            raise ValueError(f"an image of shape {reference_shape} is too small for zoom {zoom}")
        return cls(
            zoom_y=zoom,
            zoom_x=zoom,
            origin_y_px=(reference_shape[0] - 1) / 2 - (rows - 1) / 2 * zoom,
            origin_x_px=(reference_shape[1] - 1) / 2 - (cols - 1) / 2 * zoom,
            rows=rows,
            cols=cols,
        )

    @property
    def rows_px(self) -> FloatArray:
        """Reference row coordinate of every follow-up row."""
        return np.asarray(self.origin_y_px + np.arange(self.rows) * self.zoom_y, dtype=np.float64)

    @property
    def cols_px(self) -> FloatArray:
        """Reference column coordinate of every follow-up column."""
        return np.asarray(self.origin_x_px + np.arange(self.cols) * self.zoom_x, dtype=np.float64)

    @property
    def matrix(self) -> FloatArray:
        """Homography, shape (3, 3): follow-up pixel ``(x, y, 1)`` to reference pixel."""
        return np.array(
            [
                [self.zoom_x, 0.0, self.origin_x_px],
                [0.0, self.zoom_y, self.origin_y_px],
                [0.0, 0.0, 1.0],
            ]
        )


def reference_shape(image: AnyArray) -> tuple[int, int]:
    """Rows and columns of an image that a model accepts: its shape, type and size are checked."""
    if image.ndim not in (2, 3) or image.size == 0:
        raise ValueError(
            f"an image must be (rows, cols) or (rows, cols, channels), got {image.shape}"
        )
    if image.dtype.type not in (np.uint8, np.uint16, np.float32, np.float64):
        raise ValueError(f"an image must be uint8, uint16, float32 or float64, got {image.dtype}")
    return image.shape[0], image.shape[1]


def refuse_non_finite(image: AnyArray) -> None:
    """Raise ``ValueError`` if a value is NaN or infinite."""
    if image.dtype.kind != "f":
        return
    if image.flags.c_contiguous:
        # One pass at memory speed; huge values may overflow, and are looked at again.
        flat = image.reshape(-1)
        with np.errstate(over="ignore", invalid="ignore"):
            if np.isfinite(np.dot(flat, flat)):
                return
    # The extremes are NaN or infinite if any value is.
    if not (np.isfinite(image.min()) and np.isfinite(image.max())):
        raise ValueError("the image has NaN or infinite values")


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
    """Follow-up pixels at any positions in the reference, float64 in their shape.

    The models sample a grid. Shifted by fractions of a pixel, such grids interleave to an image so
    fine that a spline can read it anywhere, while every follow-up pixel is still the model's.
    ``simulate`` returns the follow-up on a grid, such as ``zoom_out_on_grid`` of an image; ``zoom``
    is the same everywhere, whatever the spacing of the positions. They lie in the reference, but
    for half a pixel.
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
