"""Detectors that come with the project: the ones that everybody tries first, and our own.

Each has the arguments of a `Detector`, is pure and gives a map. All but ``changes`` see
the reference on the follow-up's pixels by a cubic spline; where it shows nothing the map is 0.
"""

from types import MappingProxyType
from typing import Any, Final

import numpy as np
from scipy.ndimage import correlate1d, gaussian_filter
from skimage.metrics import structural_similarity

from analysis.changes import ChangeOptions, changes_between
from analysis.detectors.detector import Detector
from analysis.detectors.followup_view import FollowupView, followup_view, in_light_of
from analysis.detectors.ir_mad import ir_mad_statistic
from analysis.errors import AnalysisError
from calibration.registration import DistortedPose
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatArray

SMOOTHING_PX: Final = 1.0
"""Of the absolute difference: the optimal filter for a spot of this width in white noise."""

NCC_WINDOW_PX: Final = 9
"""Side of the square window of the local correlation."""

_SSIM_SIGMA_PX: Final = 1.5
_SSIM_REACH: Final = 3.5
_FLAT: Final = 1e-10
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


class ColourDifference:
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
        own <= _FLAT * (power + image.mean() ** 2)
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
        "colour-difference": ColourDifference(),
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
    weights = np.full(NCC_WINDOW_PX, 1 / NCC_WINDOW_PX)
    along = correlate1d(image, weights, axis=0, mode="reflect")
    return np.asarray(correlate1d(along, weights, axis=1, mode="reflect"))
