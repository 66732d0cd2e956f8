"""What the paper does to two images before it compares them: common pixels, processing, metrics.

``as-in-paper``: every follow-up is scaled up by bicubic interpolation onto the reference's pixels,
a captured one by the homography of its features, a simulated one simply by the zoom.
``reference-grid`` is the same, but the captured one lies where features, pixels and the lens's
distortion together put it. ``followup-grid`` simulates the reference on the captured follow-up's
own pixels, so that neither has to be interpolated.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, log10
from typing import Literal, get_args

import lazy_loader as lazy
import numpy as np
from scipy.ndimage import gaussian_filter

from analysis.errors import OverlapError
from analysis.results_file import InfiniteAsNull, StoredValues
from calibration.registration import OVERLAP_MIN_PX, DistortedPose
from simulation.arrays import AnyArray, FloatArray, FloatImage, IntArray
from simulation.compiled import compiled, compiled_part

BACKGROUND_SIGMA_PX = 10.0
"""Width of the Gaussian that is subtracted, from the paper."""

FULL_SCALE_DN = 255.0
"""Levels run from 0 to this after ``normalise``, from the paper."""


def process_for_comparison(image: AnyArray) -> FloatArray:
    """Processed image of the paper: normalised, background subtracted, centre half.

    ``image``: shape ``(rows, cols)``, the area that both images cover. Returns levels around 0;
    full scale is 255.
    """
    return crop_centre_half(subtract_background(normalise(image)))


def normalise(image: AnyArray) -> FloatArray:
    """Image stretched to [0, 255]: its own minimum to 0, its own maximum to 255.

    The extremes are those of the array handed in. Images that are compared must therefore be cut to
    the area both cover first.
    """
    values = np.asarray(image, dtype=np.float64)
    if values.size == 0 or not np.isfinite(values).all():
        raise ValueError("only finite pixels can be normalised")
    low, high = values.min(), values.max()
    if low == high:
        raise ValueError(f"a constant image ({low}) cannot be normalised")
    return np.asarray((values - low) * (FULL_SCALE_DN / (high - low)))


def subtract_background(image: AnyArray, sigma_px: float = BACKGROUND_SIGMA_PX) -> FloatArray:
    """Image minus its own blur by a Gaussian of ``sigma_px``, mirrored at the border."""
    values = np.asarray(image, dtype=np.float64)
    return np.asarray(values - gaussian_filter(values, sigma_px, mode="reflect"))


def crop_centre_half(image: FloatArray) -> FloatArray:
    """Middle half of each axis, shape ``(rows // 2, cols // 2)``.

    The PSF is that of the image centre, and the borders carry the marks of filtering.
    """
    rows, cols = image.shape
    top, left = rows // 4, cols // 4
    return image[top : top + rows // 2, left : left + cols // 2]


# Every report knows these metrics, few compute them: loading scikit-image takes half a second.
_skimage = lazy.load("skimage")

_SSIM_WINDOW_PX = 7
"""Side of scikit-image's default SSIM window."""


class ImageMetrics(StoredValues):
    """How alike two images are.

    Parameters
    ----------
    correlation
        Pearson's coefficient, in [-1, 1].
    mse_dn2
        Mean squared difference, in the square of the images' unit.
    nmi
        Normalised mutual information ``(H(a) + H(b)) / H(a, b)``, in [1, 2]; 100 bins.
    psnr_db
        ``10 log10(data_range_dn^2 / mse_dn2)``; infinite for equal images.
    ssim
        Mean structural similarity, 7 x 7 uniform window, in [-1, 1].
    data_range_dn
        Span of the levels that PSNR and SSIM refer to.
    """

    correlation: float
    mse_dn2: float
    nmi: float
    psnr_db: InfiniteAsNull
    ssim: float
    data_range_dn: float


def compare_images(a: FloatImage, b: FloatImage, data_range_dn: float = 255.0) -> ImageMetrics:
    """All metrics of two images.

    ``a, b``: shape ``(rows, cols)``, equal, at least 7 x 7; finite and not constant.
    ``data_range_dn``: span of the levels; 255 for what ``process_for_comparison`` makes.

    References
    ----------
    C. Studholme et al., "An overlap invariant entropy measure of 3D medical image alignment",
    1999; Z. Wang et al., "Image quality assessment: from error visibility to structural
    similarity", 2004; both as in scikit-image.
    """
    first, second = _checked_pair(a, b)
    if min(first.shape) < _SSIM_WINDOW_PX:
        raise ValueError(f"images must have at least 7 x 7 pixels, got {first.shape}")
    if not (data_range_dn > 0 and np.isfinite(data_range_dn)):
        raise ValueError(f"data_range_dn must be positive, got {data_range_dn}")
    mse_dn2 = mean_squared_error(first, second)
    # scikit-image declares no types for these two.
    nmi: Callable[..., float] = _skimage.metrics.normalized_mutual_information
    ssim: Callable[..., float] = _skimage.metrics.structural_similarity
    return ImageMetrics(
        correlation=correlation(first, second),
        mse_dn2=mse_dn2,
        nmi=float(nmi(first, second)),
        psnr_db=10 * log10(data_range_dn**2 / mse_dn2) if mse_dn2 > 0 else inf,
        ssim=float(ssim(first, second, data_range=data_range_dn)),
        data_range_dn=float(data_range_dn),
    )


def correlation(a: FloatImage, b: FloatImage) -> float:
    """Pearson's correlation coefficient, in [-1, 1]."""
    first, second = _checked_pair(a, b)
    first, second = first - first.mean(), second - second.mean()
    norm = float(np.sqrt(np.vdot(first, first) * np.vdot(second, second)))
    if norm == 0:
        raise ValueError("a constant image has no correlation with another")
    return float(np.clip(np.vdot(first, second) / norm, -1.0, 1.0))


def mean_squared_error(a: FloatImage, b: FloatImage) -> float:
    """Mean squared difference, in the square of the images' unit."""
    first, second = _checked_pair(a, b)
    return float(np.mean((first - second) ** 2))


def _checked_pair(a: FloatImage, b: FloatImage) -> tuple[FloatArray, FloatArray]:
    if a.ndim != 2 or a.shape != b.shape or a.size == 0:
        raise ValueError(f"two grey images of the same shape are needed, got {a.shape}, {b.shape}")
    first, second = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if not (np.isfinite(first).all() and np.isfinite(second).all()):
        raise ValueError("an image contains NaN or infinite values")
    return first, second


Procedure = Literal["as-in-paper", "reference-grid", "followup-grid"]
PROCEDURES: tuple[Procedure, ...] = get_args(Procedure)
"""Names of the three procedures."""

_KEYS_A = -0.5
"""Slope parameter of the cubic, as in Pillow's BICUBIC."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SharedWindow:
    """A rectangle of follow-up pixels that the reference covers wholly.

    ``y_px`` and ``x_px`` are their reference coordinates, of the rectangle's shape.
    """

    rows: slice
    cols: slice
    y_px: FloatArray
    x_px: FloatArray


def shared_window(pose: DistortedPose) -> SharedWindow:
    """Largest rectangle about the middle of what both images show."""
    place_y, place_x = pose.followup_places_px()
    rows, cols = pose.reference_shape
    margin_px = max(pose.zoom - 1, 0.0) / 2
    inside = (
        (place_y >= margin_px)
        & (place_y <= rows - 1 - margin_px)
        & (place_x >= margin_px)
        & (place_x <= cols - 1 - margin_px)
    )
    if not inside.any():
        raise OverlapError("the images do not overlap", shared_px=0)
    down, across = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    top, bottom, left, right = down[0], down[-1] + 1, across[0], across[-1] + 1
    while top < bottom and left < right and not inside[top:bottom, left:right].all():
        # The side with most pixels outside gives way.
        outside = ~inside[top:bottom, left:right]
        sides = [outside[0], outside[-1], outside[:, 0], outside[:, -1]]
        worst = int(np.argmax([side.mean() for side in sides]))
        top, bottom = top + (worst == 0), bottom - (worst == 1)
        left, right = left + (worst == 2), right - (worst == 3)
    if min(bottom - top, right - left) < OVERLAP_MIN_PX:
        shared_px = int(max(bottom - top, 0) * max(right - left, 0))
        raise OverlapError("the images overlap too little", shared_px=shared_px)
    here = np.s_[top:bottom, left:right]
    return SharedWindow(
        rows=slice(int(top), int(bottom)),
        cols=slice(int(left), int(right)),
        y_px=place_y[here],
        x_px=place_x[here],
    )


def bicubic_at(image: AnyArray, y_px: FloatArray, x_px: FloatArray) -> FloatArray:
    """Interpolate an image bicubically at any positions; its border is repeated outside.

    References
    ----------
    R. G. Keys, "Cubic convolution interpolation for digital image processing", 1981.
    """
    found = np.empty(np.shape(y_px))
    _interpolate(
        np.ascontiguousarray(image, dtype=np.float64), np.ravel(y_px), np.ravel(x_px), found.ravel()
    )
    return found


def scaled_up(image: AnyArray, zoom: float, shape: tuple[int, int]) -> FloatArray:
    """An image scaled up by a zoom to a size, both centred: the paper's plain upscaling."""
    y, x = (
        (np.arange(size) - (size - 1) / 2) / zoom + (count - 1) / 2
        for size, count in zip(shape, image.shape, strict=True)
    )
    return bicubic_at(image, *np.meshgrid(y, x, indexing="ij"))


@compiled(nogil=True)
def _interpolate(levels: FloatArray, y_px: FloatArray, x_px: FloatArray, found: FloatArray) -> None:
    rows, cols = levels.shape
    row, col = np.empty(4, np.int64), np.empty(4, np.int64)
    weight_y, weight_x = np.empty(4), np.empty(4)
    for i in range(found.size):
        _four_taps(y_px[i], rows, row, weight_y)
        _four_taps(x_px[i], cols, col, weight_x)
        total = 0.0
        for v in range(4):
            for u in range(4):
                total += weight_y[v] * weight_x[u] * levels[row[v], col[u]]
        found[i] = total


@compiled_part()
def _four_taps(position_px: float, size: int, pixel: IntArray, weight: FloatArray) -> None:
    """Pixels around a position, and Keys' weights of them."""
    first = int(np.floor(position_px)) - 1
    for k in range(4):
        pixel[k] = min(max(first + k, 0), size - 1)
        weight[k] = _keys(abs(position_px - (first + k)))


@compiled_part()
def _keys(x: float) -> float:
    a = _KEYS_A
    if x <= 1:
        return float(((a + 2) * x - (a + 3)) * (x * x) + 1)
    return float((((x - 5) * x + 8) * x - 4) * a) if x < 2 else 0.0
