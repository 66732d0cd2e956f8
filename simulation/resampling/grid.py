"""Positions of a follow-up's pixels in its reference."""

from dataclasses import dataclass
from math import floor, isfinite
from typing import Self

import numpy as np

from simulation.arrays import FloatArray

ZOOM_MIN = 0.99
"""Least zoom of a grid: measured zooms of captures at equal heights scatter around 1."""

_WHOLE_PIXEL_SLACK = 1e-9
"""Slack so that 300 / 1.2 counts as 250 pixels despite rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplingGrid:
    """An axis-aligned grid of follow-up pixels, in reference pixels.

    Pixel ``(row, col)`` of the follow-up is at reference coordinates
    ``(origin_y_px + row * zoom_y, origin_x_px + col * zoom_x)``; pixel centres are integers.

    Parameters
    ----------
    zoom_y, zoom_x
        Distance between follow-up pixels, in reference pixels; at least ``ZOOM_MIN``.
    origin_y_px, origin_x_px
        Reference coordinates of the follow-up's first pixel.
    rows, cols
        Size of the follow-up.

    Raises
    ------
    ValueError
        If a zoom is below ``ZOOM_MIN``, a value is not finite or a size is not positive.
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
            if not (value >= ZOOM_MIN and isfinite(value)):
                raise ValueError(f"{name} must be a number of at least {ZOOM_MIN}, got {value}")
        for name in ("origin_y_px", "origin_x_px"):
            if not isfinite(getattr(self, name)):
                raise ValueError(f"{name} must be finite, got {getattr(self, name)}")
        if self.rows < 1 or self.cols < 1:
            raise ValueError(f"a grid needs at least one pixel, got {self.rows} x {self.cols}")

    @classmethod
    def centred(cls, reference_shape: tuple[int, int], zoom: float) -> Self:
        """Make the grid of a camera moved straight back: both image centres coincide.

        Parameters
        ----------
        reference_shape
            ``(rows, cols)`` of the reference, N below.
        zoom
            Ratio of the distances, at least 1. The follow-up has ``n = floor(N / zoom)``
            pixels, pixel i at ``(i - (n - 1) / 2) * zoom + (N - 1) / 2``, on both axes.

        Raises
        ------
        ValueError
            If ``zoom`` is not a finite number of at least 1, or leaves no pixel.
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
