"""What the residuals of an edge fit show: outliers, sharpening, a PSF that is not Gaussian."""

from math import pi, sqrt
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.compiled import compiled_part

_NEIGHBOURS = 25  # pixels at nearly the same distance from the edge
COARSE = 2e-3  # of the contrast: from this step on, the median of levels is one of few
_CUT_SIGMAS = 4.0  # takes 0.1 % from the variance of Gaussian noise
_CUTS = 3
_OUTLIER_SIGMAS = 6.0
_OUTLIER_LEAST = 0.01  # of the contrast: smaller ones do not matter and may be structure
_OUTLIER_STEPS = 3.0  # what noise of half a step and rounding reach together: 4.5 sigma
_TUKEY_SIGMAS = 6.0  # 0.998 efficient on Gaussian noise
_BIN_PX = 0.5
_BIN_PIXELS = 8  # fewer give no mean
_SHARPENED_LEAST = 0.02  # overshoot of both sides, of the contrast
_NON_GAUSSIAN_P = 1e-5
_NON_GAUSSIAN_LEAST = 0.004  # rms of the residual profile, of the contrast


@compiled_part()
def noise_part(residuals: FloatArray, distances: FloatArray, is_coarse: bool = False) -> FloatArray:
    """Residuals less the running median over pixels at nearly the same distance.

    What depends on the distance from the edge alone (a PSF that is not the model's) is
    structure; what is left is noise and outliers. The median of coarse levels would be one of
    them: there it is the mean without outliers.
    """
    if is_coarse:
        return _without_means(residuals, distances)
    order = _by_distance(distances)
    sorted_noise = _without_running_median(residuals[order])
    noise = np.empty_like(residuals)
    for i in range(len(order)):
        noise[order[i]] = sorted_noise[i]
    return noise


@compiled_part()
def _by_distance(distances: FloatArray) -> IntArray:
    """Indices in the order of the distances: by counting into steps, then by insertion."""
    n = len(distances)
    least = distances.min()
    per_step = (n - 1) / max(distances.max() - least, 1e-300)
    first = np.zeros(n + 1, np.int64)
    for d in distances:
        first[int((d - least) * per_step) + 1] += 1
    for k in range(n):
        first[k + 1] += first[k]
    order = np.empty(n, np.int64)
    for i in range(n):
        step = int((distances[i] - least) * per_step)
        order[first[step]] = i
        first[step] += 1
    for i in range(1, n):
        index, d = order[i], distances[order[i]]
        k = i
        while k > 0 and distances[order[k - 1]] > d:
            order[k] = order[k - 1]
            k -= 1
        order[k] = index
    return order


@compiled_part(fastmath={"nnan", "nsz"})
def _without_running_median(values: FloatArray) -> FloatArray:
    """Values less the median of the ``_NEIGHBOURS`` around each; the ends are repeated."""
    half = _NEIGHBOURS // 2
    last = len(values) - 1
    window = np.full(_NEIGHBOURS + 1, np.inf)  # sorted, with a bound behind its last element
    for k in range(_NEIGHBOURS):
        value, place = values[min(max(k - half, 0), last)], k
        while place > 0 and window[place - 1] > value:
            window[place] = window[place - 1]
            place -= 1
        window[place] = value
    others = np.empty(_NEIGHBOURS + 1)  # with a bound before its first element
    others[0] = -np.inf
    rest = np.empty_like(values)
    for i in range(len(values)):
        rest[i] = values[i] - window[half]
        leaving = values[max(i - half, 0)]
        entering = values[min(i + half + 1, last)]
        # Without branches: a processor cannot foresee where noise belongs.
        for k in range(_NEIGHBOURS):
            here, following = window[k], window[k + 1]
            others[k + 1] = here if here < leaving else following
        for k in range(_NEIGHBOURS):
            before, here = others[k], others[k + 1]
            least = here if here < entering else entering
            window[k] = before if before > least else least
    return rest


@compiled_part()
def _without_means(residuals: FloatArray, distances: FloatArray) -> FloatArray:
    """Residuals less their mean over pixels at nearly the same distance, outliers left out."""
    n = len(residuals)
    least = distances.min()
    bins = max(n // _NEIGHBOURS, 1)
    per_px = (bins - 1e-9) / max(distances.max() - least, 1e-300)
    index = np.empty(n, np.int32)
    for i in range(n):
        index[i] = int((distances[i] - least) * per_px)
    noise = residuals
    limit = np.inf
    for _ in range(2):
        count, total = np.zeros(bins), np.zeros(bins)
        for i in range(n):
            if abs(noise[i]) <= limit:
                count[index[i]] += 1
                total[index[i]] += residuals[i]
        mean = total / np.maximum(count, 1.0)
        left = np.empty(n)
        for i in range(n):
            left[i] = residuals[i] - mean[index[i]]
        noise = left
        limit = _CUT_SIGMAS * sqrt(cut_variance(noise))
    return noise


@compiled_part()
def cut_variance(deviations: FloatArray) -> float:
    """Mean square about 0 without what lies beyond four of its standard deviations.

    Unlike the median of the moduli it is not 0 where rounding makes most values equal.
    """
    # The mean modulus of a normal is sqrt(2 / pi) of its sigma.
    moduli = 0.0
    for x in deviations:
        moduli += abs(x)
    variance = 0.5 * pi * (moduli / len(deviations)) ** 2
    for _ in range(_CUTS):
        total, count = 0.0, 0
        for x in deviations:
            if x * x <= _CUT_SIGMAS**2 * variance:
                total += x * x
                count += 1
        if count in (0, len(deviations)):
            return total / max(count, 1)
        variance = float(total / count)
    return float(variance)


@compiled_part()
def between(values: FloatArray, edges: FloatArray, least: float, below: float) -> FloatArray:
    """Those of the values whose pixel's unit edge is at least the one bound and below the other."""
    chosen = np.empty(len(values))
    count = 0
    for i in range(len(values)):
        if least <= edges[i] < below:
            chosen[count] = values[i]
            count += 1
    return chosen[:count]


@compiled_part()
def outlier_weights(
    noise: FloatArray, is_clipped: BoolArray, spread: FloatArray, contrast: float, step_dn: float
) -> tuple[bool, FloatArray]:
    """Whether single pixels stand out in the ``noise_part``, and Tukey biweights.

    ``spread`` is each pixel's noise up to a common factor: on a bright side full of shot noise
    the pixels of the dark side would else set the scale. Levels come in steps of ``step_dn``, 0
    where they are fine; clipped ones do not scatter.
    """
    relative = np.empty(len(noise))
    count = 0
    for i in range(len(noise)):
        if not is_clipped[i]:
            relative[count] = noise[i] / spread[i]
            count += 1
    scale = robust_sigma(relative[:count])
    least = max(_OUTLIER_LEAST * contrast, _OUTLIER_STEPS * step_dn)
    found = False
    weights = np.empty_like(noise)
    for i in range(len(noise)):
        found |= abs(noise[i]) > max(_OUTLIER_SIGMAS * scale * spread[i], least)
        reach = noise[i] / max(_TUKEY_SIGMAS * scale * spread[i], least)
        weights[i] = (1 - reach * reach) ** 2 if abs(reach) < 1 else 0.0
    return found, weights


class ProfileFigures(NamedTuple):
    """Figures of the profile across an edge, binned by the distance from it.

    ``overshoot`` is the smaller of the two sides', in DN; ``scatter`` the variance within the
    bins. Of the ``bins`` near the edge, ``chi2`` is the sum of count times squared mean residual
    over ``scatter`` and ``mean_square`` the mean of the squared means, DN^2.
    """

    overshoot: float
    scatter: float
    chi2: float
    mean_square: float
    bins: int
    pixels: int


def profile_flags(figures: ProfileFigures, contrast: float) -> tuple[str, ...]:
    """Flags ``sharpened`` and ``non_gaussian``, from the profile across the edge.

    ``contrast`` is the high minus the low level.
    """
    flags = []
    unsure = 6 * sqrt(figures.scatter / max(figures.pixels / 6, 1))
    if figures.overshoot > max(_SHARPENED_LEAST * contrast, unsure):
        flags.append("sharpened")
    if figures.bins > 4 and figures.scatter > 0:
        is_surprising = chdtrc(figures.bins - 4, figures.chi2) < _NON_GAUSSIAN_P
        if is_surprising and sqrt(figures.mean_square) > _NON_GAUSSIAN_LEAST * contrast:
            flags.append("non_gaussian")
    return tuple(flags)


@compiled_part()
def profile_figures(
    values: FloatArray,
    residuals: FloatArray,
    distances: FloatArray,
    weights: FloatArray,
    sigma_px: float,
) -> ProfileFigures:
    """Bin the profile across the edge.

    Parameters
    ----------
    values, residuals, distances
        Level, level minus model and signed distance (px) of each pixel, shape ``(n,)``.
    weights
        Pixels without weight do not count.
    sigma_px
        Total width of the edge.
    """
    first = np.floor(distances.min() / _BIN_PX)
    size = int(np.floor(distances.max() / _BIN_PX) - first) + 1
    count, total, distance_sum = np.zeros(size), np.zeros(size), np.zeros(size)
    squares = 0.0
    pixels = 0
    for i in range(len(values)):
        if not weights[i] > 0:
            continue
        pixels += 1
        k = int(np.floor(distances[i] / _BIN_PX) - first)
        count[k] += 1
        total[k] += residuals[i]
        distance_sum[k] += distances[i]
        squares += residuals[i] ** 2
    filled = bins = 0
    chi2 = mean_squares = 0.0
    for k in range(size):
        if count[k] == 0:
            continue
        filled += 1
        mean = total[k] / count[k]
        squares -= count[k] * mean * mean
        if count[k] >= _BIN_PIXELS and abs(distance_sum[k] / count[k]) < 5 * sigma_px + 1:
            bins += 1
            chi2 += count[k] * mean * mean
            mean_squares += mean * mean
    scatter = max(squares, 0.0) / max(pixels - filled, 1)
    overshoot = min(
        _overshoot(values, distances, weights, -1.0, sigma_px),
        _overshoot(values, distances, weights, 1.0, sigma_px),
    )
    return ProfileFigures(
        overshoot,
        scatter,
        chi2 / scatter if scatter > 0 else 0.0,
        mean_squares / max(bins, 1),
        bins,
        pixels,
    )


@compiled_part()
def _overshoot(
    values: FloatArray, distances: FloatArray, weights: FloatArray, side: float, sigma_px: float
) -> float:
    """How far the profile of one side goes beyond its far level; 0 where the side is missing."""
    inner, outer = 1.2 * sigma_px + 0.5, 3.0 * sigma_px + 1.5
    size = int(np.floor((outer - inner) / _BIN_PX)) + 1
    count, total = np.zeros(size), np.zeros(size)
    far = np.empty(len(values))
    n_far = 0
    for i in range(len(values)):
        d = side * distances[i] if weights[i] > 0 else 0.0
        if d > outer:
            far[n_far] = values[i]
            n_far += 1
        elif d > inner:
            k = int(np.floor((d - inner) / _BIN_PX))
            count[k] += 1
            total[k] += values[i]
    inside = 0.0
    for k in range(size):
        inside += count[k]
    if min(n_far, inside) < 10:
        return 0.0
    far_level = np.median(far[:n_far])
    highest = -np.inf
    for k in range(size):
        if count[k] >= 5:
            highest = max(highest, side * (total[k] / count[k] - far_level))
    return highest if np.isfinite(highest) else 0.0
