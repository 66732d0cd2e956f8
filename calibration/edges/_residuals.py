"""What the levels and residuals of an edge tell: rounding, outliers, weights, a PSF not Gaussian.

The steps in which the pixels around an edge are stored, read from their own levels. A file tells
how many bits it has, not in which steps the plane that is measured comes: linear light from an sRGB
file has steps that grow with the level, the mean of N frames has an Nth of a step, and 12 bits in
16 have sixteen. The distinct levels near an edge show all of these, and where they show none - the
luma of three channels, a resampled image - rounding is fine beside the noise.
"""

from math import exp, log, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from scipy.special import chdtrc

from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.compiled import compiled, compiled_part

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
    """Residuals less the running median over pixels at nearly the same distance: noise, outliers.

    The median of coarse levels would be one of them: there it is the mean without outliers.
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
def _between(values: FloatArray, edges: FloatArray, least: float, below: float) -> FloatArray:
    """Those of the values whose pixel's unit edge is at least the one bound and below the other."""
    chosen = np.empty(len(values))
    count = 0
    for i in range(len(values)):
        if least <= edges[i] < below:
            chosen[count] = values[i]
            count += 1
    return chosen[:count]


@compiled_part()
def _outlier_weights(
    noise: FloatArray, is_clipped: BoolArray, spread: FloatArray, contrast: float, step_dn: float
) -> tuple[bool, FloatArray]:
    """Whether single pixels stand out in the ``noise_part``, and Tukey biweights.

    ``spread`` is each pixel's noise up to a common factor: shot noise of the bright side would else
    set the scale of both. Clipped pixels do not scatter.
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

    ``overshoot`` is the smaller of the two sides', in DN; of the ``bins`` near the edge, ``chi2``
    sums count times squared mean residual over ``scatter``, the variance within.
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
    """Bin the profile across the edge of a total width; pixels without weight do not count."""
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


_UNEVEN_SIGMAS = 3.1  # one in a thousand
_SIDE_PIXELS = 30
_LEAST_NOISE = 1e-6  # of the contrast: less is rounding of the arithmetic
_SIDE = 0.02  # of the contrast: nearer to a level than this, a pixel tells the noise of its side


class PixelWeights(NamedTuple):
    """Weights, shape ``(n,)``, the outliers' part in them, and whether there are outliers."""

    weights: FloatArray
    outliers: FloatArray
    has_outliers: bool


@compiled_part()
def known_weights(
    across: FloatArray, sigma: float, low: float, high: float, noise_line: FloatArray
) -> FloatArray:
    """Inverse variances from a noise-free guess of each pixel's level; ones without a line."""
    weights = np.ones(len(across))
    if len(noise_line) == 0:
        return weights
    for i in range(len(across)):
        rise = min(max(0.5 + across[i] / (4.0 * max(sigma, 0.3)), 0.0), 1.0)
        level = low + (high - low) * rise
        weights[i] = 1.0 / max(noise_line[0] + noise_line[1] * level, noise_line[2])
    return weights


@compiled_part()
def pixel_weights(
    noise: tuple[FloatArray, BoolArray],
    edges: FloatArray,
    known: FloatArray,
    contrast: float,
    step_dn: float,
) -> PixelWeights:
    """Weigh each pixel by its noise, with Tukey's biweights where single pixels stand out.

    Known weights are inverse variances, empty where the scatter has to tell them; the step is 0
    where levels are fine.
    """
    scatter, is_clipped = noise
    least = step_dn**2 / 12 + (_LEAST_NOISE * contrast) ** 2
    weights = known if len(known) > 0 else _side_weights(scatter, edges, least)
    spread = np.empty(len(weights))
    for i in range(len(weights)):
        spread[i] = 1.0 / sqrt(weights[i])
    found, outliers = _outlier_weights(scatter, is_clipped, spread, contrast, step_dn)
    return PixelWeights(weights * outliers if found else weights, outliers, found)


@compiled_part()
def _side_weights(scatter: FloatArray, edges: FloatArray, least_variance: float) -> FloatArray:
    """Inverse variances where one side of the edge is noisier than the other, else ones."""
    weights = np.ones(len(scatter))
    dark, bright = _between(scatter, edges, -1.0, _SIDE), _between(scatter, edges, 1 - _SIDE, 2.0)
    if min(len(dark), len(bright)) < _SIDE_PIXELS:
        return weights
    low = max(cut_variance(dark), least_variance)
    high = max(cut_variance(bright), least_variance)
    if min(low, high) <= 1e-12 * max(low, high):
        return weights
    # The logarithm of a ratio of two variances is nearly normal.
    scatter_of_log = sqrt(2.0 / len(dark) + 2.0 / len(bright))
    if abs(log(high / low)) < _UNEVEN_SIGMAS * scatter_of_log:
        return weights
    for i in range(len(weights)):
        weights[i] = sqrt(low * high) / (low + (high - low) * edges[i])
    return weights


_FIRST_PIXELS = 64
_FIRST_LEVELS = 44  # more among so many pixels: the noise is far above one step
_MOST_LEVELS = 512  # over the contrast: finer steps do not matter, and chance makes some
_FEWEST_LEVELS = 4
_WHOLE = 0.01  # of a step: how near to whole multiples the distances of an even grid are
_ALIKE = 1.35  # ratio of neighbouring steps: 1.25 in sRGB at code 10, two of an even grid
_SHARE_ALIKE = 0.75
_COARSE = 0.6  # of a step: scatter below which rounding is no independent noise
_COINCIDE = 1e-7  # of the range: levels nearer to each other are one


class LevelSteps(NamedTuple):
    """For each pixel the levels that are stored as its own; ``is_found`` false: no steps seen.

    ``lower`` and ``upper`` have shape ``(n,)``; ``step_dn`` is the mean distance between them.
    """

    is_found: bool
    lower: FloatArray
    upper: FloatArray
    step_dn: float


@compiled_part()
def level_steps(values: FloatArray) -> LevelSteps:
    """Find the steps of levels of shape ``(n,)``, where all are those of one grid.

    The grid is even, or changes slowly with the level; then few steps may be missing.
    """
    none = LevelSteps(False, values, values, 0.0)
    if len(values) < _FIRST_PIXELS:
        return none
    span = values.max() - values.min()
    near = _COINCIDE * span
    if len(_distinct(values, len(values) // _FIRST_PIXELS, near)) > _FIRST_LEVELS:
        return none
    levels = _distinct(values, 1, near)
    if not _FEWEST_LEVELS <= len(levels) <= _MOST_LEVELS:
        return none
    steps = levels[1:] - levels[:-1]
    least = steps.min()
    if np.abs(steps / least - np.rint(steps / least)).max() < _WHOLE:
        if least * _MOST_LEVELS < span:
            return none
        return LevelSteps(True, values - 0.5 * least, values + 0.5 * least, least)
    alike = 0
    for k in range(1, len(steps)):
        ratio = steps[k] / steps[k - 1]
        alike += int(1 / _ALIKE < ratio < _ALIKE)
    if alike < _SHARE_ALIKE * (len(steps) - 1) or len(steps) < 2 * _FEWEST_LEVELS:
        return none
    found = _between_neighbours(values, levels, steps)
    return found if found.step_dn * _MOST_LEVELS >= span else none


@compiled_part()
def _distinct(values: FloatArray, stride: int, near: float) -> FloatArray:
    """Distinct levels of every ``stride``-th pixel, rising; at most one above ``_MOST_LEVELS``."""
    levels = np.empty(_MOST_LEVELS + 1)
    count = 0
    for i in range(0, len(values), stride):
        value = values[i]
        k = np.searchsorted(levels[:count], value - near)
        if k < count and levels[k] <= value + near:
            continue
        for j in range(count, k, -1):
            levels[j] = levels[j - 1]
        levels[k] = value
        count += 1
        if count > _MOST_LEVELS:
            break
    return levels[:count]


@compiled_part()
def _between_neighbours(values: FloatArray, levels: FloatArray, steps: FloatArray) -> LevelSteps:
    """Half way to either neighbouring level; where that one is missing, half a step near by."""
    last = len(steps) - 1
    half = np.empty(len(steps))
    for k in range(len(steps)):
        near = steps[max(k - 2, 0) : min(k + 2, last) + 1].min()
        half[k] = 0.5 * (steps[k] if steps[k] < _ALIKE * _ALIKE * near else near)
    lower, upper = np.empty_like(values), np.empty_like(values)
    for i in range(len(values)):
        k = min(max(np.searchsorted(levels, values[i] - 0.5 * steps.min()), 0), len(levels) - 1)
        lower[i] = values[i] - half[max(k - 1, 0)]
        upper[i] = values[i] + half[min(k, last)]
    return LevelSteps(True, lower, upper, float(np.mean(upper - lower)))


@compiled_part()
def is_coarse(scatter: FloatArray, edges: FloatArray, steps: LevelSteps) -> bool:
    """Whether the noise of either side is too small for rounding to be noise of its own.

    Rounding error is white and uniform to exp(-2 pi^2 s^2 / step^2) (Widrow and Kollar,
    Quantization Noise, 2008, chapter 5): 0.7 % at half a step.
    """
    if not steps.is_found:
        return False
    relative = np.empty(len(scatter))
    for i in range(len(scatter)):
        relative[i] = scatter[i] / (steps.upper[i] - steps.lower[i])
    dark, bright = _between(relative, edges, -1.0, 0.5), _between(relative, edges, 0.5, 2.0)
    if min(len(dark), len(bright)) == 0:
        return False
    return bool(min(cut_variance(dark), cut_variance(bright)) < _COARSE**2)


_TERMS = 8
_LEAST_ROUNDED_NOISE = 0.095
"""Of a step: below, the error jumps at levels that no fit places so well."""


class Rounding(NamedTuple):
    """Steps of the stored levels and noise before rounding, in DN, of either side of an edge.

    All are 0 where rounding errors are random, or there are none.
    """

    dark_step_dn: float
    bright_step_dn: float
    dark_noise_dn: float
    bright_noise_dn: float

    @property
    def error_dn(self) -> float:
        """Standard deviation of the rounding errors over all phases of the level."""
        return float(0.5 * (self.dark_step_dn + self.bright_step_dn) / np.sqrt(12.0))


@compiled_part()
def rounding_of(steps: LevelSteps, edges: FloatArray, noise_dn: tuple[float, float]) -> Rounding:
    """Return the mean steps on either half of an edge; the noise is that before rounding."""
    count, total = np.zeros(2), np.zeros(2)
    for i in range(len(edges)):
        side = int(edges[i] >= 0.5)
        count[side] += 1
        total[side] += steps.upper[i] - steps.lower[i]
    return Rounding(total[0] / count[0], total[1] / count[1], noise_dn[0], noise_dn[1])


@compiled()
def rounding_bias(
    levels_dn: FloatArray, expected_dn: FloatArray, edges: FloatArray, rounding: Rounding
) -> FloatArray:
    """Mean rounding error of each pixel at the level that a fitted edge has there.

    It is 0 where the noise is below 0.1 of a step: what is lost there is not known. The phase of
    the steps is taken from the stored levels; ``expected_dn`` is before rounding and noise.

    References
    ----------
    B. Widrow and I. Kollar, Quantization Noise (2008), chapter 5: the Fourier series of the mean
    error against the level, each term damped by the noise's characteristic function.
    """
    bias = np.zeros(len(levels_dn))
    if rounding.dark_step_dn <= 0 or rounding.bright_step_dn <= 0:
        return bias
    for i in range(len(bias)):
        e = min(max(edges[i], 0.0), 1.0)
        step = (1 - e) * rounding.dark_step_dn + e * rounding.bright_step_dn
        noise = ((1 - e) * rounding.dark_noise_dn + e * rounding.bright_noise_dn) / step
        if noise < _LEAST_ROUNDED_NOISE:
            continue
        phase = 2 * pi * (expected_dn[i] - levels_dn[i]) / step
        sign = -1.0
        for k in range(1, _TERMS + 1):
            damping = exp(-2 * (pi * k * noise) ** 2)
            bias[i] += sign * step / (pi * k) * damping * sin(k * phase)
            sign = -sign
    return bias
