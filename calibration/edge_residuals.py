"""What the residuals of an edge fit tell: outliers, sharpening, a PSF that is not Gaussian."""

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.ndimage import median_filter

__all__ = ["noise_part", "outlier_weights", "profile_flags", "robust_variance"]

Array = NDArray[np.float64]

_MAD_PER_SIGMA = 0.6744897501960817  # median absolute deviation of a unit normal
_NEIGHBOURS = 25  # pixels at nearly the same distance from the edge, for the running median
_OUTLIER_SIGMAS = 6.0
_OUTLIER_LEAST = 0.01  # of the contrast: smaller ones do not matter and may be structure
_TUKEY_SIGMAS = 6.0  # 0.998 efficient on Gaussian noise
_BIN_PX = 0.5
_SHARPENED_LEAST = 0.02  # overshoot of both sides, of the contrast
_NON_GAUSSIAN_P = 1e-5
_NON_GAUSSIAN_LEAST = 0.004  # rms of the residual profile, of the contrast


def noise_part(residuals: Array, distances: Array) -> Array:
    """Residuals less the running median over pixels at nearly the same distance.

    What depends on the distance from the edge alone (a PSF that is not the model's) is
    structure; what is left is noise and outliers.
    """
    order = np.argsort(distances, kind="stable")
    ordered = residuals[order]
    noise = np.empty_like(ordered)
    noise[order] = ordered - median_filter(ordered, size=_NEIGHBOURS, mode="nearest")
    return noise


def outlier_weights(noise: Array, spread: Array, contrast: float) -> Array | None:
    """Tukey biweights where single pixels stand out of the ``noise_part``, else None.

    ``spread`` is each pixel's noise up to a common factor: on a bright side full of shot noise
    the pixels of the dark side would else set the scale.
    """
    ratio = noise / spread
    scale = float(np.median(np.abs(ratio))) / _MAD_PER_SIGMA
    least = _OUTLIER_LEAST * contrast
    if not np.any(np.abs(noise) > np.maximum(_OUTLIER_SIGMAS * scale * spread, least)):
        return None
    reach = noise / np.maximum(_TUKEY_SIGMAS * scale * spread, least)
    return np.where(np.abs(reach) < 1, (1 - reach**2) ** 2, 0.0)


def robust_variance(noise: Array) -> float:
    """Variance of Gaussian noise from its median absolute deviation: outliers do not count."""
    return (float(np.median(np.abs(noise))) / _MAD_PER_SIGMA) ** 2


def profile_flags(
    *, values: Array, residuals: Array, distances: Array, sigma_px: float, contrast: float
) -> tuple[str, ...]:
    """Flags ``sharpened`` and ``non_gaussian``, from the profile across the edge.

    Parameters
    ----------
    values, residuals, distances
        Level, level minus model and signed distance (px) of each pixel, shape ``(n,)``.
    sigma_px
        Total width of the edge.
    contrast
        High minus low level.
    """
    place = np.floor(distances / _BIN_PX).astype(np.int64)
    place -= place.min()
    count = np.bincount(place)
    used = count >= 8
    mean = np.bincount(place, residuals)[used] / count[used]
    centre = np.bincount(place, distances)[used] / count[used]
    within = residuals - (np.bincount(place, residuals) / np.maximum(count, 1))[place]
    scatter = float(np.sum(within**2)) / max(values.size - int(np.count_nonzero(count)), 1)
    flags = []
    if _overshoot(values, distances, sigma_px, contrast) > max(
        _SHARPENED_LEAST, 6 * np.sqrt(scatter / max(values.size / 6, 1)) / contrast
    ):
        flags.append("sharpened")
    near = np.abs(centre) < 5 * sigma_px + 1
    bins = int(np.count_nonzero(near))
    if bins > 4 and scatter > 0:
        chi2 = float(np.sum(count[used][near] * mean[near] ** 2)) / scatter
        rms = float(np.sqrt(np.mean(mean[near] ** 2))) / contrast
        if stats.chi2.sf(chi2, bins - 4) < _NON_GAUSSIAN_P and rms > _NON_GAUSSIAN_LEAST:
            flags.append("non_gaussian")
    return tuple(flags)


def _overshoot(values: Array, distances: Array, sigma_px: float, contrast: float) -> float:
    """Smaller of the overshoots of the two sides, of the contrast; 0 where a side is missing."""
    inner, outer = 1.2 * sigma_px + 0.5, 3.0 * sigma_px + 1.5
    overshoots = []
    for side in (-1.0, 1.0):
        d = side * distances
        near = (d > inner) & (d <= outer)
        far = d > outer
        if np.count_nonzero(near) < 10 or np.count_nonzero(far) < 10:
            return 0.0
        far_level = float(np.median(values[far]))
        place = np.floor((d[near] - inner) / _BIN_PX).astype(np.int64)
        count = np.bincount(place)
        level = np.bincount(place, values[near])[count >= 5] / count[count >= 5]
        if level.size == 0:
            return 0.0
        overshoots.append(float(np.max(side * (level - far_level))) / contrast)
    return min(overshoots)
