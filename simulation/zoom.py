"""Zoom-out: the image a camera would take of the same scene from ``zoom`` times further away.

Four models, all linear and noise-free: sums of separable terms, one for a Gaussian PSF.

``bicubic``
    Pillow's antialiased bicubic alone; the baseline.
``paper``
    The same, then a Gaussian blur by ``Sigma (1 - 1 / zoom^2)`` in follow-up px^2; the paper's
    ``Sigma`` is the diagonal of the PSF's covariance.
``matched``
    The near image times ``H(zoom f) / H(f)``, which for a Gaussian is a blur by
    ``Sigma (zoom^2 - 1)``, then point samples of the quintic spline through the result: no
    antialiasing, as a real distant camera has none beyond its own PSF. The theory and the
    comparison are in ``docs/theory-simulation.md``.
``lmmse``
    The best linear estimate from the reference pixels around, for scenes with a first-order
    covariance (``docs/theory-lmmse.md``); ``lmmse_operator`` takes the reference's noise too.

Aligned pairs for super-resolution are a crop, and the same crop seen from further away. The
low-resolution image is simulated with the pixels around the crop, so that it is as accurate at its
borders as in its middle, and on a grid centred on the crop: both images show the same square of the
scene.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from math import ceil, floor, sqrt
from typing import TypedDict, Unpack, cast

import numpy as np

from simulation.arrays import AnyArray, FloatArray, FloatImage
from simulation.choices import DEFAULT_MODEL, MODELS, GaussianForm, Model
from simulation.psf import Psf, PsfField
from simulation.resampling import (
    BandedMatrix,
    BlurCovariance,
    antialiased_cubic,
    blur,
    gaussian_terms,
    put_separable,
)
from simulation.sampling_grid import SamplingGrid, reference_shape, refuse_non_finite
from simulation.seen_scene import SCENE_CORRELATION_PX
from simulation.zoom_kernels import lmmse_terms, spline_terms

_PAPER_TAIL_TOLERANCE = 2.2e-4
"""Largest kernel weight cut off: photographs stay within 0.05 of 255 of the exact filter."""

_BORDER_SLACK_PX = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class SeparableSum:
    """A linear operator on images: the sum over its terms of ``Wy image Wx^T``."""

    terms: tuple[tuple[BandedMatrix, BandedMatrix], ...]

    def apply(self, image: FloatImage, threads: int = 1) -> FloatImage:
        """Return the transformed image, in the dtype of ``image``, shape (rows, cols)."""
        out = np.empty((self.terms[0][0].rows, self.terms[0][1].rows), dtype=image.dtype)
        put_separable(tuple((y, (x,)) for y, x in self.terms), image, out, threads=threads)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class ZoomOperator:
    """A zoom-out ready to be applied to images of one size: its stages, first to last."""

    stages: tuple[SeparableSum, ...]

    def __repr__(self) -> str:
        (first_y, first_x), (last_y, last_x) = self.stages[0].terms[0], self.stages[-1].terms[0]
        return (
            f"ZoomOperator({first_x.columns} x {first_y.columns} to "
            f"{last_x.rows} x {last_y.rows} px)"
        )

    def apply(self, image: FloatImage, threads: int = 1) -> FloatImage:
        """Return the follow-up of ``image``, shape (rows, cols), float32 or float64."""
        if len(self.stages) == 2 and all(len(stage.terms) == 1 for stage in self.stages):
            # Both stages along x at once: the image is transposed once and back once.
            (((first_y, first_x),), ((then_y, then_x),)) = (s.terms for s in self.stages)
            made = np.empty((first_y.rows, then_x.rows), dtype=image.dtype)
            put_separable(((first_y, (first_x, then_x)),), image, made, threads=threads)
            out = np.empty((then_y.rows, then_x.rows), dtype=image.dtype)
            put_separable(((then_y, ()),), made, out, threads=threads)
            return out
        for stage in self.stages:
            image = stage.apply(image, threads)
        return image

    def follow_up(self, image: AnyArray, threads: int = 1) -> FloatImage:
        """Return the follow-up of a finite reference of any kind, plane by plane."""
        if threads < 1:
            raise ValueError(f"threads must be at least 1, got {threads}")
        dtype = np.dtype(np.float64 if image.dtype == np.float64 else np.float32)
        if image.ndim == 2:
            return self.apply(image.astype(dtype, copy=False), threads)
        planes = [
            self.apply(image[:, :, channel].astype(dtype), threads)
            for channel in range(image.shape[2])
        ]
        return cast("FloatImage", np.stack(planes, axis=2))


def zoom_out_image(
    image: AnyArray,
    zoom: float,
    psf: Psf | None = None,
    model: Model = DEFAULT_MODEL,
    *,
    gaussian: GaussianForm = "transfer",
    threads: int = 1,
) -> FloatImage:
    """Image of the same scene from ``zoom`` times further away, both image centres coinciding.

    The reference has the shape ``(rows, cols)`` or ``(rows, cols, channels)``, of uint8, uint16,
    float32 or float64, linear in light; ``zoom`` is the ratio of the distances, at least 1. The PSF
    is the total one (optics and pixel) of the camera, the same at both distances; ``bicubic`` needs
    none. The Gaussian ``"sampled"`` blurs model ``paper`` as ``scipy.ndimage.gaussian_filter``
    would, for comparison. ``threads`` share the rows; the result is the same bit by bit.

    The result is in the input's units, float64 for float64 input, else float32: ``floor(N / zoom)``
    pixels on each axis, at the positions given by ``SamplingGrid.centred``. At ``zoom`` 1 it equals
    the input. A ValueError if the zoom is below 1, the image too small for it, of another kind or
    not finite, the model unknown, or the PSF missing.
    """
    rows, cols = reference_shape(image)
    grid = SamplingGrid.centred((rows, cols), zoom)
    return zoom_out_on_grid(image, grid, psf, model, gaussian=gaussian, threads=threads)


def zoom_out_on_grid(
    image: AnyArray,
    grid: SamplingGrid,
    psf: Psf | None = None,
    model: Model = DEFAULT_MODEL,
    *,
    gaussian: GaussianForm = "transfer",
    threads: int = 1,
) -> FloatImage:
    """Like ``zoom_out_image``, on the pixels of a follow-up: any zoom, offset, size per axis.

    A zoom just below 1 blurs as 1 does; the grid may leave the reference by half a pixel.
    """
    operator = zoom_operator(reference_shape(image), grid, psf, model, gaussian=gaussian)
    refuse_non_finite(image)
    return operator.follow_up(image, threads)


@lru_cache(maxsize=32)
def zoom_operator(
    shape: tuple[int, int],
    grid: SamplingGrid,
    psf: Psf | None = None,
    model: Model = DEFAULT_MODEL,
    *,
    gaussian: GaussianForm = "transfer",
) -> ZoomOperator:
    """Operator of a zoom-out of references ``(rows, cols)``, for repeated use; cached."""
    if model not in MODELS:
        raise ValueError(f"model must be one of {', '.join(MODELS)}, got {model!r}")
    _check_grid(shape, grid)
    if model in ("matched", "lmmse") and gaussian != "transfer":
        raise ValueError(f"a {gaussian} Gaussian is only for model 'paper'")
    if model == "matched":
        return ZoomOperator((_matched(shape, grid, _needed(psf, model)),))
    if model == "lmmse":
        return lmmse_operator(shape, grid, _needed(psf, model))
    if model == "bicubic":
        return ZoomOperator((_antialiased(shape, grid),))
    return _paper(shape, grid, _needed(psf, model), gaussian)


@lru_cache(maxsize=32)
def lmmse_operator(
    shape: tuple[int, int],
    grid: SamplingGrid,
    psf: Psf,
    *,
    noise_ratio: float = 0.0,
    scene_correlation_px: float = SCENE_CORRELATION_PX,
) -> ZoomOperator:
    """Operator of model ``lmmse`` for a noisy reference or another scene; cached.

    ``noise_ratio`` is the variance of a reference pixel's noise over that of the scene. With noise,
    zoom 1 smooths. ``scene_correlation_px``, the correlation length of the scene, hardly matters.
    """
    _check_grid(shape, grid)
    terms = lmmse_terms(
        shape, grid, psf, noise_ratio=noise_ratio, scene_correlation_px=scene_correlation_px
    )
    if terms is None:
        # Without a limit to its window, and at such zooms without aliasing to speak of.
        return ZoomOperator((_matched(shape, grid, psf),))
    if noise_ratio == 0 and grid == SamplingGrid.centred(shape, 1.0):
        return ZoomOperator((_identity(shape),))
    return ZoomOperator((SeparableSum(terms),))


def _check_grid(shape: tuple[int, int], grid: SamplingGrid) -> None:
    for name, positions, size in (
        ("rows", grid.rows_px, shape[0]),
        ("columns", grid.cols_px, shape[1]),
    ):
        outermost = max(-positions[0], positions[-1] - (size - 1))
        if outermost > 0.5 + _BORDER_SLACK_PX:
            raise ValueError(f"the grid's {name} extend beyond the reference by {outermost:.3g} px")


def _identity(shape: tuple[int, int]) -> SeparableSum:
    return SeparableSum(((blur(np.ones(1), shape[0]), blur(np.ones(1), shape[1])),))


def _matched(shape: tuple[int, int], grid: SamplingGrid, psf: Psf) -> SeparableSum:
    if grid == SamplingGrid.centred(shape, 1.0):
        # The spline through the pixels reproduces the pixel values except for rounding.
        return _identity(shape)
    return SeparableSum(spline_terms(shape, grid, psf))


def _antialiased(shape: tuple[int, int], grid: SamplingGrid) -> SeparableSum:
    return SeparableSum(
        (
            (
                antialiased_cubic(grid.rows_px, grid.zoom_y, shape[0]),
                antialiased_cubic(grid.cols_px, grid.zoom_x, shape[1]),
            ),
        )
    )


def _paper(
    shape: tuple[int, int], grid: SamplingGrid, psf: Psf, gaussian: GaussianForm
) -> ZoomOperator:
    """Antialiased resizing, then the blur, which mirrors at the image's edge, not the grid's."""
    zoom_y, zoom_x = max(grid.zoom_y, 1.0), max(grid.zoom_x, 1.0)
    # The paper's Sigma has no correlation.
    xx, yy = np.diag(psf.covariance_px2).tolist()
    (kernel,) = gaussian_terms(
        BlurCovariance(yy_px2=yy * (1 - zoom_y**-2), xx_px2=xx * (1 - zoom_x**-2)),
        tail_tolerance=_PAPER_TAIL_TOLERANCE,
        form=gaussian,
    )
    above, below = _pixels_around(grid.rows_px, grid.zoom_y, shape[0], len(kernel.along_y) // 2)
    left, right = _pixels_around(grid.cols_px, grid.zoom_x, shape[1], len(kernel.along_x) // 2)
    wider = replace(
        grid,
        origin_y_px=grid.origin_y_px - above * grid.zoom_y,
        origin_x_px=grid.origin_x_px - left * grid.zoom_x,
        rows=grid.rows + above + below,
        cols=grid.cols + left + right,
    )
    blurs = (
        blur(kernel.along_y, wider.rows).of_rows(slice(above, above + grid.rows)),
        blur(kernel.along_x, wider.cols).of_rows(slice(left, left + grid.cols)),
    )
    return ZoomOperator((_antialiased(shape, wider), SeparableSum((blurs,))))


def _pixels_around(positions_px: FloatArray, zoom: float, size: int, reach: int) -> tuple[int, int]:
    """Pixels that the grid can be extended by on either side, ``reach`` at most."""
    before = (positions_px[0] + 0.5 + _BORDER_SLACK_PX) / zoom
    after = (size - 0.5 + _BORDER_SLACK_PX - positions_px[-1]) / zoom
    return min(max(floor(before), 0), reach), min(max(floor(after), 0), reach)


def _needed(psf: Psf | None, model: Model) -> Psf:
    if psf is None:
        raise ValueError(f"model {model!r} needs a PSF")
    return psf


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


class _SrComputation(TypedDict, total=False):
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


def _crop_origins(size_px: int, crop_px: int, stride_px: int) -> list[int]:
    """First pixels of crops along one axis: every ``stride_px``, the last one at the border."""
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
    **how: Unpack[_SrComputation],
) -> Iterator[SrPair]:
    """Cut an image into crops, row by row, each with its low-resolution partner.

    The image has the shape ``(rows, cols)`` or ``(rows, cols, channels)`` and is finite and linear
    in light; ``crop_px`` is the side of the high-resolution crops, ``stride_px`` the distance
    between their origins. Of a PSF field, which must be of the image's size, every crop takes the
    PSF in the middle of that one of 5 x 5 parts of the frame in which its centre lies.
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
    for top in _crop_origins(rows, crop_px, stride_px):
        for left in _crop_origins(cols, crop_px, stride_px):
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
