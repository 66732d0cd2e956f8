"""Detectors that come with the library.

Each has the arguments of a `Detector`, is pure and gives a map. All but ``changes`` see
the reference on the follow-up's pixels by a cubic spline; where it shows nothing the map is 0.
"""

from types import MappingProxyType
from typing import Any, Final

import numpy as np
from scipy.ndimage import binary_erosion, correlate1d, gaussian_filter
from scipy.stats import chi2
from skimage.metrics import structural_similarity

from analysis.changes import ChangeOptions, changes_between
from analysis.detectors._spec import Detector
from analysis.detectors.answers import FollowupView, followup_view, in_light_of
from analysis.errors import AnalysisError
from calibration.registration import DistortedPose
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatArray

_SMOOTHING_PX = 1.0
_ROUNDS = 30
_SETTLED = 1e-3
_RIDGE = 1e-6
_LEAST_VARIANCE = 1e-9
_WINDOW_PX = 7
"""Reach of the smoothing and the neighbours: so far from the border of the overlap, pixels count
for the statistics."""

_LEAST_PX_PER_BAND = 10.0
"""Pixels that the statistics of a band need; canonical correlations of fewer fit the noise."""

_FLAT = 1e-10
"""Variance of what are equal levels but for rounding, over their mean square or, among some of the
pixels, over that of the image."""


def ir_mad_statistic(before: FloatArray, after: FloatArray, overlap: BoolArray) -> FloatArray:
    """Return the sum of the squared MAD variates over their variances at each pixel.

    Without change it is distributed as chi-squared with nine degrees of freedom: both images are
    smoothed by 1 px, and the bands of a pixel are itself and its eight neighbours, so that some
    blur can be explained. An affine change of levels changes nothing. It is 0 everywhere where an
    image is flat or the overlap too small to tell: 90 pixels, 3 px from its border.

    Parameters
    ----------
    before, after
        Finite, shape ``(rows, cols)`` each.
    overlap
        Pixels that both show.

    References
    ----------
    A. A. Nielsen, "The regularized iteratively reweighted MAD method for change detection in multi-
    and hyperspectral data", IEEE Trans. Image Processing 16 (2007), 463-478.
    """
    inside = binary_erosion(overlap, np.ones((_WINDOW_PX, _WINDOW_PX), dtype=np.bool_)).ravel()
    smooth = [gaussian_filter(_normalised(image), _SMOOTHING_PX) for image in (before, after)]
    bands = [_neighbours(image) for image in smooth]
    count = bands[0].shape[1]
    weight = inside.astype(np.float64)
    statistic = np.zeros(len(weight))
    for _ in range(_ROUNDS):
        # Reweighting may leave nothing but the flat part of an image.
        too_few = weight.sum() < _LEAST_PX_PER_BAND * count
        if too_few or any(_variance(band[:, 0], weight) <= _FLAT for band in bands):
            break
        statistic = _squared_variates(bands[0], bands[1], weight)
        earlier, weight = weight, inside * chi2.sf(statistic, count)
        if np.abs(weight - earlier).max() < _SETTLED:
            break
    return statistic.reshape(after.shape)


def _squared_variates(x: FloatArray, y: FloatArray, weight: FloatArray) -> FloatArray:
    """One round: canonical variates by weighted statistics, and the squares of what differs."""
    total, count = weight.sum(), x.shape[1]
    x, y = x - weight @ x / total, y - weight @ y / total
    xx, yy, xy = ((a * weight[:, None]).T @ b / total for a, b in ((x, x), (y, y), (x, y)))
    for own in (xx, yy):
        own[np.diag_indices(count)] += _RIDGE * np.trace(own)
    root_x, root_y = np.linalg.cholesky(xx), np.linalg.cholesky(yy)
    mixed = np.linalg.solve(root_x, np.linalg.solve(root_y, xy.T).T)
    left, correlation, right = np.linalg.svd(mixed)
    variates = x @ np.linalg.solve(root_x.T, left) - y @ np.linalg.solve(root_y.T, right.T)
    variance = np.maximum(2 * (1 - correlation), _LEAST_VARIANCE)
    return np.asarray(np.sum(variates**2 / variance, axis=1))


def _variance(values: FloatArray, weight: FloatArray) -> float:
    share = weight / weight.sum()
    return float(share @ (values - share @ values) ** 2)


def _normalised(image: FloatArray) -> FloatArray:
    """Mean 0 and variance 1, so that nothing depends on the levels' scale; 0 if it is flat."""
    mean, largest = float(image.mean()), float(np.abs(image).max())
    steps = image - mean
    spread = float(np.sqrt(np.mean(steps**2)))
    if spread <= np.sqrt(_FLAT) * largest:
        return np.zeros_like(image)
    return steps / spread


def _neighbours(image: FloatArray) -> FloatArray:
    """A pixel and its eight neighbours as bands, shape (pixels, 9)."""
    padded = np.pad(image, 1, mode="reflect")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    return np.ascontiguousarray(windows.reshape(-1, 9))


SMOOTHING_PX: Final = 1.0
"""Of the absolute difference: the optimal filter for a spot of this width in white noise."""

_NCC_WINDOW_PX: Final = 9
"""Side of the square window of the local correlation."""

_SSIM_SIGMA_PX: Final = 1.5
_SSIM_REACH: Final = 3.5
_FLAT_WINDOW: Final = 1e-10
"""Variance of a window over its mean square, below which it holds rounding alone."""

_EQUAL: Final = 1e-12
"""Range of levels over the largest, below which they differ by the rounding of the resampling."""

_ROUNDED: Final = 1e-6
"""Standard deviation over the largest level that float32 cannot tell from none."""

_LARGEST: Final = float(np.finfo(np.float32).max)


def absolute_difference(
    reference: Float32Array, followup: Float32Array, homography: FloatArray
) -> Float32Array:
    """Absolute difference, in the follow-up's levels.

    The reference is brought to the follow-up's light by one gain and one offset; the difference is
    smoothed by a Gaussian of 1 px before its sign is dropped.
    """
    seen = followup_view(reference, _shape(followup), homography)
    return _map(_difference(followup, seen), seen.inside)


class _ColourDifference:
    """The largest of the absolute differences of red, green and blue.

    Each as of `absolute_difference`, with a gain and an offset of its own.
    """

    colour: Final = True

    def __call__(
        self, reference: Float32Array, followup: Float32Array, homography: FloatArray
    ) -> Float32Array:
        """See `Detector`."""
        seen = [
            followup_view(reference[:, :, channel], _shape(followup), homography)
            for channel in range(3)
        ]
        found = [_difference(followup[:, :, channel], one) for channel, one in enumerate(seen)]
        return _map(np.max(found, axis=0), seen[0].inside)


def ncc(reference: Float32Array, followup: Float32Array, homography: FloatArray) -> Float32Array:
    """One minus the normalised correlation in a window of 9 x 9 px around each pixel, from 0 to 2.

    Of two windows without texture it is 0, of one with and one without it is 1.
    """
    seen = followup_view(reference, _shape(followup), homography)
    images = (seen.levels, followup.astype(np.float64))
    # Sums of squares lose fewer digits about the mean.
    x, y = (image - image.mean() for image in images)
    mean_x, mean_y = _window_mean(x), _window_mean(y)
    powers = _window_mean(x * x), _window_mean(y * y)
    xx, yy = powers[0] - mean_x**2, powers[1] - mean_y**2
    xy = _window_mean(x * y) - mean_x * mean_y
    flat_x, flat_y = (
        own <= _FLAT_WINDOW * (power + image.mean() ** 2)
        for own, power, image in zip((xx, yy), powers, images, strict=True)
    )
    textured = ~(flat_x | flat_y)
    root = np.sqrt(np.where(textured, xx, 1.0)) * np.sqrt(np.where(textured, yy, 1.0))
    correlation = np.where(textured, xy / root, np.where(flat_x & flat_y, 1.0, 0.0))
    return _map(1 - np.clip(correlation, -1, 1), seen.inside)


def ssim(reference: Float32Array, followup: Float32Array, homography: FloatArray) -> Float32Array:
    """One minus the map of structural similarity, as scikit-image computes it.

    With Gaussian weights of 1.5 px and the range of both images' levels; light is not matched. A
    frame smaller than the 11 x 11 px that the weights reach is mirrored at its borders.

    References
    ----------
    Z. Wang, A. C. Bovik, H. R. Sheikh, E. P. Simoncelli, "Image quality assessment: from error
    visibility to structural similarity", IEEE Trans. Image Processing 13 (2004), 600-612.
    """
    seen = followup_view(reference, _shape(followup), homography)
    target = followup.astype(np.float64)
    before = np.where(seen.inside, seen.levels, target)
    dissimilarity = structural_dissimilarity(before, target)
    return _map(dissimilarity, seen.inside)


def structural_dissimilarity(before: FloatArray, after: FloatArray) -> FloatArray:
    """One minus the map of SSIM of two images on one grid; 0 where neither has any structure."""
    highest, lowest = (float(of([before, after])) for of in (np.max, np.min))
    span = highest - lowest
    if span <= _EQUAL * max(abs(highest), abs(lowest)):
        return np.zeros_like(after)
    reach = int(_SSIM_REACH * _SSIM_SIGMA_PX + 0.5)
    lacking = [max(0, 2 * reach + 1 - size) for size in after.shape]
    padding = [(lack - lack // 2, lack // 2) for lack in lacking]
    images = [np.pad(image / span, padding, mode="symmetric") for image in (before, after)]
    compare: Any = structural_similarity  # it states no types
    _, similarity = compare(
        *images, data_range=1.0, gaussian_weights=True, sigma=_SSIM_SIGMA_PX, full=True
    )
    rows, cols = (
        slice(before_px, before_px + size)
        for (before_px, _), size in zip(padding, after.shape, strict=True)
    )
    # From -1 to 1 but for rounding.
    return 1 - np.clip(np.asarray(similarity, dtype=np.float64)[rows, cols], -1, 1)


def ir_mad(reference: Float32Array, followup: Float32Array, homography: FloatArray) -> Float32Array:
    """Sum of squared MAD variates over their variances, in the images behind a Gaussian of 1 px.

    The bands of a pixel are itself and its eight neighbours. See `ir_mad_statistic`.
    """
    seen = followup_view(reference, _shape(followup), homography)
    target = followup.astype(np.float64)
    return _map(ir_mad_statistic(seen.levels, target, seen.inside), seen.inside)


def changes(
    reference: Float32Array, followup: Float32Array, homography: FloatArray
) -> Float32Array:
    """Absolute significance of this project's own comparison, without a calibrated PSF.

    In standard deviations. Pixels that it does not compare, at borders or clipped, are 0; so is the
    whole map where nothing can be compared, as between flat images.
    """
    if _is_flat(reference) or _is_flat(followup):
        return np.zeros_like(followup)
    pose = DistortedPose(
        matrix=homography / homography[2, 2],
        k1=0.0,
        reference_shape=_shape(reference),
        followup_shape=_shape(followup),
    )
    try:
        found = changes_between(reference, followup, None, ChangeOptions(pose=pose))
    except AnalysisError:
        return np.zeros_like(followup)
    return np.abs(found.significance).astype(np.float32, copy=False)


FUNCTIONS: Final = MappingProxyType[str, Detector](
    {
        "absolute-difference": absolute_difference,
        "colour-difference": _ColourDifference(),
        "ncc": ncc,
        "ssim": ssim,
        "ir-mad": ir_mad,
        "changes": changes,
    }
)


def _difference(followup: Float32Array, seen: FollowupView) -> FloatArray:
    """Absolute difference of one plane, in the follow-up's light."""
    brought = in_light_of(followup, seen.levels, seen.inside)
    return np.abs(gaussian_filter(followup - brought, SMOOTHING_PX))


def _shape(image: AnyArray) -> tuple[int, int]:
    return image.shape[0], image.shape[1]


def _is_flat(image: Float32Array) -> bool:
    """Whether what differs among its levels is their rounding to float32."""
    steps = image.astype(np.float64) - float(image.mean(dtype=np.float64))
    return bool(steps.std() <= _ROUNDED * np.abs(image).max())


def _map(values: FloatArray, inside: BoolArray) -> Float32Array:
    return np.where(inside, np.clip(values, -_LARGEST, _LARGEST), 0).astype(np.float32)


def _window_mean(image: FloatArray) -> FloatArray:
    """Mean of the window around each pixel; no running sums, which a bright pixel would spoil."""
    weights = np.full(_NCC_WINDOW_PX, 1 / _NCC_WINDOW_PX)
    along = correlate1d(image, weights, axis=0, mode="reflect")
    return np.asarray(correlate1d(along, weights, axis=1, mode="reflect"))
