"""Iteratively reweighted multivariate alteration detection of two images on one grid."""

import numpy as np
from scipy.ndimage import binary_erosion, gaussian_filter
from scipy.stats import chi2

from simulation.arrays import BoolArray, FloatArray

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
