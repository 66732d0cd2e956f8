"""How similar two images are: the metrics of the paper's tables."""

from collections.abc import Callable
from math import inf, log10

import lazy_loader as lazy
import numpy as np

from analysis.results_file import InfiniteAsNull, StoredValues
from simulation.arrays import FloatArray, FloatImage

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
    ``data_range_dn``: span of the levels; 255 for what ``analysis.validation.processing`` makes.

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
