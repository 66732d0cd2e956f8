"""Aligned pairs for super-resolution: a crop, and the same crop seen from further away.

The low-resolution image is simulated with the pixels around the crop, so that it is as accurate
at its borders as in its middle, and on a grid centred on the crop: both images show the same
square of the scene.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from math import ceil, floor, sqrt
from typing import TypedDict, Unpack

import numpy as np

from simulation.arrays import AnyArray, FloatImage
from simulation.choices import DEFAULT_MODEL, Model
from simulation.psf import Psf, PsfField
from simulation.resampling import SamplingGrid, reference_shape, refuse_non_finite
from simulation.zoom import ZoomOperator, zoom_operator

_WHOLE_PIXEL_SLACK = 1e-9
_MARGIN_PX = 24.0  # the spline's own reach at the reference's resolution
_MARGIN_ZOOMS = 24.0  # the antialiasing cubic and the blur's tail, in follow-up pixels
_MARGIN_SIGMAS = 6.0


_PLACES = 5
"""Positions per axis at which a field's PSF is taken: the kernels of each are solved once, which
takes 0.1-5 s, where a crop takes milliseconds."""


_OPERATORS = 128
"""Cached: a frame with a field takes some 70, of 25 PSFs; solving those anew for each frame made
pairs 200 times slower."""


class SrComputation(TypedDict, total=False):
    """How the partners are computed; what is not given has the default."""

    model: Model
    """The capture model; ``DEFAULT_MODEL`` by default."""

    threads: int
    """How many share the rows of a crop, 1 by default; the result is the same."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SrPair:
    """A high-resolution crop and its simulated low-resolution partner.

    Low-resolution pixel ``i`` is at ``(i - (n - 1) / 2) * zoom + (N - 1) / 2`` of the crop, on
    both axes, with ``N`` and ``n`` the sizes of the two.
    """

    top_px: int
    left_px: int
    high: AnyArray
    low: FloatImage

    def __repr__(self) -> str:
        (rows, cols), (low_rows, low_cols) = self.high.shape[:2], self.low.shape[:2]
        return (
            f"SrPair({cols} x {rows} and {low_cols} x {low_rows} px, "
            f"top_px={self.top_px}, left_px={self.left_px})"
        )


def crop_origins(size_px: int, crop_px: int, stride_px: int) -> list[int]:
    """First pixels of crops along one axis: every ``stride_px``, the last one at the border.

    Raises
    ------
    ValueError
        If the crop is larger than the axis, or crop or stride is not positive.
    """
    if crop_px < 1 or stride_px < 1:
        raise ValueError(f"crop and stride must be positive, got {crop_px} and {stride_px}")
    if crop_px > size_px:
        raise ValueError(f"a crop of {crop_px} px does not fit in {size_px} px")
    origins = list(range(0, size_px - crop_px + 1, stride_px))
    if origins[-1] != size_px - crop_px:
        origins.append(size_px - crop_px)
    return origins


def sr_pairs(
    image: AnyArray,
    zoom: float,
    psf: Psf | PsfField,
    *,
    crop_px: int,
    stride_px: int,
    **how: Unpack[SrComputation],
) -> Iterator[SrPair]:
    """Cut an image into crops, row by row, each with its low-resolution partner.

    Parameters
    ----------
    image
        Shape ``(rows, cols)`` or ``(rows, cols, channels)``; linear in light.
    zoom
        How many times further away the low-resolution camera is, at least 1.
    psf
        Total PSF of the camera. Of a field, which must be of the image's size, every crop takes
        the PSF in the middle of that one of 5 x 5 parts of the frame in which its centre lies.
    crop_px, stride_px
        Side of the high-resolution crops, and the distance between their origins.
    how
        ``model`` and ``threads``.

    Raises
    ------
    ValueError
        If the crop does not fit into the image, or leaves no low-resolution pixel; if a field
        belongs to another frame, or the image is not finite.
    """
    rows, cols = image.shape[:2]
    if isinstance(psf, PsfField) and (psf.width_px, psf.height_px) != (cols, rows):
        raise ValueError(
            f"a field of {psf.width_px} x {psf.height_px} px is not that of an image of "
            f"{cols} x {rows} px"
        )
    model, threads = how.get("model", DEFAULT_MODEL), how.get("threads", 1)
    small = floor(crop_px / zoom + _WHOLE_PIXEL_SLACK)
    if small < 1:
        raise ValueError(f"a crop of {crop_px} px leaves no pixel at zoom {zoom:g}")
    refuse_non_finite(image)
    centred = SamplingGrid.centred((crop_px, crop_px), zoom)
    for top in crop_origins(rows, crop_px, stride_px):
        for left in crop_origins(cols, crop_px, stride_px):
            own = _psf_at(psf, top + (crop_px - 1) / 2, left + (crop_px - 1) / 2)
            margin = _margin_px(zoom, own)
            # Crops away from the border have the same window and grid: one cached operator.
            window_top, window_left = max(top - margin, 0), max(left - margin, 0)
            window = image[
                window_top : top + crop_px + margin, window_left : left + crop_px + margin
            ]
            grid = replace(
                centred,
                origin_y_px=top - window_top + centred.origin_y_px,
                origin_x_px=left - window_left + centred.origin_x_px,
            )
            yield SrPair(
                top_px=top,
                left_px=left,
                high=image[top : top + crop_px, left : left + crop_px],
                low=_crop_operator(reference_shape(window), grid, own, model).follow_up(
                    window, threads
                ),
            )


@lru_cache(maxsize=_OPERATORS)
def _crop_operator(
    shape: tuple[int, int], grid: SamplingGrid, psf: Psf, model: Model
) -> ZoomOperator:
    return zoom_operator(shape, grid, psf, model)


def _psf_at(psf: Psf | PsfField, y_px: float, x_px: float) -> Psf:
    """PSF of the part of the frame in which a position lies."""
    if not isinstance(psf, PsfField):
        return psf
    y_px, x_px = (
        (floor((at_px + 0.5) * _PLACES / size) + 0.5) * size / _PLACES - 0.5
        for at_px, size in ((y_px, psf.height_px), (x_px, psf.width_px))
    )
    return psf.at(x_px, y_px)


def _margin_px(zoom: float, psf: Psf) -> int:
    """Pixels around a crop that its low-resolution pixels may depend on."""
    widest = sqrt(max(np.diag(psf.covariance_px2).tolist()))
    return ceil(_MARGIN_PX + _MARGIN_ZOOMS * zoom + _MARGIN_SIGMAS * widest * zoom)
