"""The most likely edge for pixels of which an interval is known: rounded or clipped ones.

Clipped pixels of an edge: what their levels still tell, and how much of the edge is left. At the
saturation level a pixel is at least that bright, at black at most that dark. Least squares take the
level of a clipped pixel for its own and find the edge too narrow: by 0.6 to 3 % where a third of
the pixels is clipped. Their likelihood has no such bias, and its error grows with what is not seen.

Where the noise is below half a step, what rounding adds is neither independent of the level nor of
mean 0: a flat side comes out at one or two codes whose mean is off by up to half a step, and least
squares take that for a change of the width. The likelihood of a pixel is therefore the probability
that its level plus Gaussian noise of standard deviation s lies in the interval that is stored as
its code,

    P = Phi((upper - mu) / s) - Phi((lower - mu) / s),

an ordered probit model. It is maximised over the edge's parameters and log s together, s changing
from one side of the edge to the other in proportion to the unit edge. A clipped pixel's interval
has no end: all that it tells is "at least that bright", or "at most that dark" (a censored
observation).

References
----------
A. Agresti, Analysis of Ordinal Categorical Data, 2nd ed. (2010), section 5.1; J. W. Pratt,
Concavity of the log likelihood, J. Am. Stat. Assoc. 76 (1981): log P is concave in mu.
J. Tobin, Estimation of relationships for limited dependent variables, Econometrica 26 (1958):
censored observations.
"""

from math import erfc, exp, log, pi, sqrt
from typing import NamedTuple

import numpy as np

from calibration.edges._model import (
    LOG_SIGMA,
    LOW,
    EdgeJacobian,
    EdgeLevels,
    edge_jacobian,
    inverse_element,
    solved,
)
from calibration.edges._residuals import LevelSteps, cut_variance
from calibration.edges._segments import BandPixels
from simulation.arrays import BoolArray, FloatArray
from simulation.compiled import compiled, compiled_part

BLOCK = 8


@compiled_part()
def cosine_transform() -> FloatArray:
    """The orthonormal cosine transform of eight values, shape ``(8, 8)``, by rising frequency."""
    matrix = np.empty((BLOCK, BLOCK))
    for k in range(BLOCK):
        scale = sqrt((1.0 if k == 0 else 2.0) / BLOCK)
        for n in range(BLOCK):
            matrix[k, n] = scale * np.cos(pi * (2 * n + 1) * k / (2 * BLOCK))
    return matrix


@compiled_part()
def _put_cosines(transform: FloatArray, block: FloatArray) -> None:
    """Put the cosines of a block of 64 values, row by row, in their place."""
    by_row = np.zeros(BLOCK**2)
    for k in range(BLOCK):
        for m in range(BLOCK):
            for n in range(BLOCK):
                by_row[k * BLOCK + n] += transform[k, m] * block[m * BLOCK + n]
    for k in range(BLOCK):
        for n in range(BLOCK):
            total = 0.0
            for m in range(BLOCK):
                total += by_row[k * BLOCK + m] * transform[n, m]
            block[k * BLOCK + n] = total


NEARLY_SATURATED = 0.995  # of the saturation level
_BLACK_DN = 0.0
_CENSORED_FROM = 0.005  # of the pixels: fewer move sigma by less than a tenth of its error
_FINE_STEP = 0.1  # of the noise: an interval as narrow is as good as a level
_LEAST_STEP = 1e-3  # of the contrast, where there is no noise
_USUAL_NOISE = 0.3  # of a step, before rounding, where rounding matters
_UNBOUNDED = 1e6  # contrasts


class _LevelIntervals(NamedTuple):
    """Between which levels each pixel was before it was stored; shape ``(n,)`` each.

    ``step_dn`` is the usual width of those that are not clipped, ``usual_noise_dn`` the noise that
    is expected before rounding.
    """

    lower: FloatArray
    upper: FloatArray
    is_clipped: BoolArray
    step_dn: float
    usual_noise_dn: float


@compiled_part()
def clipped_pixels(stored: FloatArray, saturation_dn: float) -> BoolArray:
    """Which pixels are at the saturation level or at black; none where the former is not known.

    Levels below 0 are those of a dark level that was taken off: then 0 is no bound.
    """
    if not np.isfinite(saturation_dn):
        return np.zeros(len(stored), np.bool_)
    is_bound = stored >= NEARLY_SATURATED * saturation_dn
    if stored.min() >= _BLACK_DN:
        for i in range(len(stored)):
            is_bound[i] |= stored[i] <= _BLACK_DN
    return is_bound


@compiled_part()
def are_censored(is_clipped: BoolArray) -> bool:
    """Whether so many pixels are clipped that it matters, and others are left."""
    count = np.count_nonzero(is_clipped)
    return bool(_CENSORED_FROM * len(is_clipped) < count < len(is_clipped))


@compiled_part()
def level_intervals(
    stored: FloatArray,
    steps: LevelSteps,
    scatter: FloatArray,
    is_clipped: BoolArray,
    contrast_dn: float,
) -> _LevelIntervals:
    """Intervals of levels from the steps in which they are stored, without end where clipped.

    ``scatter`` is the residuals less what depends on the distance from the edge alone; where no
    steps were found, intervals are narrow beside the noise.
    """
    told, count = np.empty(len(scatter)), 0
    for i in range(len(scatter)):
        if not is_clipped[i]:
            told[count] = scatter[i]
            count += 1
    noise = np.sqrt(cut_variance(told[:count]))
    lower, upper, step = steps.lower.copy(), steps.upper.copy(), steps.step_dn
    if not steps.is_found:
        step = max(_FINE_STEP * noise, _LEAST_STEP * contrast_dn)
        lower, upper = stored - 0.5 * step, stored + 0.5 * step
    # The bound is one and the same for all, or levels just below it would count twice.
    least, largest = stored.min(), stored.max()
    middle = 0.5 * (least + largest)
    bright, dark = np.inf, -np.inf
    for i in range(len(stored)):
        if is_clipped[i] and stored[i] > middle:
            bright = min(bright, lower[i] if steps.is_found else stored[i])
        elif is_clipped[i]:
            dark = max(dark, upper[i] if steps.is_found else stored[i])
    for i in range(len(stored)):
        if is_clipped[i] and stored[i] > middle:
            lower[i], upper[i] = bright, largest + _UNBOUNDED * contrast_dn
        elif is_clipped[i]:
            lower[i], upper[i] = least - _UNBOUNDED * contrast_dn, dark
    has_clipped = bright < np.inf or dark > -np.inf
    usual = _USUAL_NOISE * step
    return _LevelIntervals(
        lower, upper, is_clipped, step, max(usual, noise) if has_clipped else usual
    )


def seen_rise(low_dn: float, high_dn: float, saturation_dn: float) -> float:
    """Share of the rise from dark to bright that lies between black and saturation; 1 for all."""
    top = min(high_dn, NEARLY_SATURATED * saturation_dn)
    return (top - max(low_dn, _BLACK_DN)) / (high_dn - low_dn)


_LEAST_NOISE = 0.03  # of a step: what noise-free edges at random angles look like
_LOG_NOISE_PRIOR = 1.0  # standard deviation of log s about that
_LOG_RATIO_PRIOR = 0.5  # of the logarithm of both sides' ratio: shot noise of 4:1 has 0.7
_FAR = 10.0  # standard deviations: from here on, ratios of probabilities that are near to 0
_FRACTIONS = 16  # of the continued fraction, exact to the last digit from _FAR on
_MAX_STEPS = 40
_MAX_DAMPINGS = 12
_GAIN = 1e-4  # of the logarithm of the likelihood: 0.014 standard errors
_START = 4.0  # of the usual noise: a smoother likelihood, from which the walls are approached
_FLAT = 0.05  # of a step from its level: a pixel that tells nothing but the level
_EVEN_CODE = 128  # taken off before the transform
_SQRT_HALF = sqrt(0.5)
_INV_SQRT_2PI = 1 / sqrt(2 * pi)


class Intervals(NamedTuple):
    """What is known of ``n`` observations before rounding; shape ``(n,)`` each.

    The observations are the pixels, or where there are ``code_levels_dn`` the cosines of blocks of
    8 x 8 codes. ``weights`` multiply the log likelihood, ``step_dn`` is the usual interval,
    ``extra_variance`` noise known beside that which is estimated.
    """

    pixels: BandPixels
    lower: FloatArray
    upper: FloatArray
    weights: FloatArray
    step_dn: float
    usual_noise_dn: float
    extra_variance: FloatArray
    code_levels_dn: FloatArray


class LikelyParameters(NamedTuple):
    """Maximum of the likelihood, valid only if ``is_found``, and the noise of either side."""

    is_found: bool
    parameters: FloatArray
    log_sigma_variance: float
    log_likelihood: float
    noise_dn: tuple[float, float]


class _Equations(NamedTuple):
    hessian: FloatArray
    gradient: FloatArray
    log_likelihood: float


@compiled_part()
def _mills_ratio(x: float) -> float:
    """Upper normal tail over density from ``_FAR`` on (Abramowitz and Stegun 1964, 26.2.14)."""
    below = x
    for k in range(_FRACTIONS, 0, -1):
        below = x + k / below
    return 1 / below


@compiled_part()
def _interval_terms(
    below: float, above: float, s: float
) -> tuple[float, float, float, float, float, float]:
    """Log P of an interval ``below`` to ``above`` the level, and its first and second derivatives.

    By level, by log s, level twice, log s twice, mixed.
    """
    a, b, sign = below / s, above / s, 1.0
    if a + b < 0:
        a, b, sign = -b, -a, -1.0
    if a > _FAR:
        decay = exp(0.5 * (a - b) * (a + b))
        p = _mills_ratio(a) - _mills_ratio(b) * decay  # over the density at a
        log_p = log(_INV_SQRT_2PI * p) - 0.5 * a * a
        pa, pb = 1 / p, decay / p
    else:
        p = 0.5 * (erfc(a * _SQRT_HALF) - erfc(b * _SQRT_HALF))
        log_p = log(p)
        pa = _INV_SQRT_2PI * exp(-0.5 * a * a) / p
        pb = _INV_SQRT_2PI * exp(-0.5 * b * b) / p
    first, second = pb - pa, b * pb - a * pa
    third, fourth = b * b * pb - a * a * pa, b * b * b * pb - a * a * a * pa
    return (
        log_p,
        -sign * first / s,
        -second,
        -(second + first * first) / (s * s),
        second - fourth - second * second,
        sign * (first - third - first * second) / s,
    )


@compiled_part()
def _equations(data: Intervals, parameters: FloatArray, is_square: bool) -> _Equations:
    """Log likelihood with the priors of the noise, its gradient and its negative Hessian."""
    count = len(parameters)
    edge_count = count - 2
    model = _observed(data, parameters[:edge_count], is_square)
    hessian, gradient = np.zeros((count, count)), np.zeros(count)
    row = np.empty(count)
    least2 = (_LEAST_NOISE * data.step_dn) ** 2
    total = 0.0
    for i in range(len(data.weights)):
        w = data.weights[i]
        if w == 0.0:
            continue
        e = model.edges[i]
        s2 = np.exp(2 * ((1 - e) * parameters[edge_count] + e * parameters[edge_count + 1]))
        all2 = s2 + least2 + data.extra_variance[i]
        s = sqrt(all2)
        level = model.levels[i]
        term, by_level, by_s, by_levels, by_ss, mixed = _interval_terms(
            data.lower[i] - level, data.upper[i] - level, s
        )
        total += w * term
        free = s2 / all2
        for j in range(edge_count):
            row[j] = model.jacobian[i, j]
        row[edge_count], row[edge_count + 1] = free * (1 - e), free * e
        for j in range(edge_count):
            gradient[j] += w * by_level * row[j]
            for k in range(j + 1):
                hessian[j, k] -= w * by_levels * row[j] * row[k]
        for j in range(edge_count, count):
            gradient[j] += w * by_s * row[j]
            for k in range(edge_count):
                hessian[j, k] -= w * mixed * row[j] * row[k]
            for k in range(edge_count, j + 1):
                hessian[j, k] -= w * by_ss * row[j] * row[k]
    total += _add_priors(hessian, gradient, parameters, data.usual_noise_dn)
    for j in range(count):
        for k in range(j):
            hessian[k, j] = hessian[j, k]
    return _Equations(hessian, gradient, total)


@compiled_part()
def _observed(data: Intervals, parameters: FloatArray, is_square: bool) -> EdgeJacobian:
    """The model of the observations: of the pixels, or of the cosines of their codes."""
    model = edge_jacobian(data.pixels, parameters, is_square)
    code_levels = data.code_levels_dn
    if len(code_levels) == 0:
        return model
    levels, edges, jacobian = model.levels, model.edges, model.jacobian
    last = len(code_levels) - 1
    for i in range(len(levels)):
        k = min(max(np.searchsorted(code_levels, levels[i]) - 1, 0), last - 1)
        slope = 1.0 / (code_levels[k + 1] - code_levels[k])
        levels[i] = k + slope * (levels[i] - code_levels[k]) - _EVEN_CODE
        for j in range(jacobian.shape[1]):
            jacobian[i, j] *= slope
    transform = cosine_transform()
    values = np.empty(BLOCK**2)
    for k in range(0, len(levels), BLOCK**2):
        # Of a block away from the edge the first cosine alone is not 0.
        mean = np.mean(edges[k : k + BLOCK**2])
        for i in range(BLOCK**2):
            edges[k + i] = mean
        _put_cosines(transform, levels[k : k + BLOCK**2])
        for j in range(jacobian.shape[1]):
            for i in range(BLOCK**2):
                values[i] = jacobian[k + i, j]
            _put_cosines(transform, values)
            for i in range(BLOCK**2):
                jacobian[k + i, j] = values[i]
    return EdgeJacobian(levels, edges, jacobian)


@compiled_part()
def _add_priors(
    hessian: FloatArray, gradient: FloatArray, parameters: FloatArray, usual_noise_dn: float
) -> float:
    """What is known of the noise where the codes tell nothing: a side of one code alone."""
    dark, bright = len(parameters) - 2, len(parameters) - 1
    total = 0.0
    for j in (dark, bright):
        away = (parameters[j] - log(usual_noise_dn)) / _LOG_NOISE_PRIOR
        total -= 0.5 * away * away
        gradient[j] -= away / _LOG_NOISE_PRIOR
        hessian[j, j] += 1 / _LOG_NOISE_PRIOR**2
    apart = (parameters[bright] - parameters[dark]) / _LOG_RATIO_PRIOR
    gradient[bright] -= apart / _LOG_RATIO_PRIOR
    gradient[dark] += apart / _LOG_RATIO_PRIOR
    hessian[bright, bright] += 1 / _LOG_RATIO_PRIOR**2
    hessian[dark, dark] += 1 / _LOG_RATIO_PRIOR**2
    hessian[bright, dark] -= 1 / _LOG_RATIO_PRIOR**2
    return float(total - 0.5 * apart * apart)


@compiled()
def maximise_intervals(
    data: Intervals, starts: tuple[FloatArray, FloatArray], has_optical: bool
) -> tuple[LikelyParameters, LikelyParameters]:
    """Maximise the likelihood of the plain edge, and of the one behind pixel squares."""
    total = _most_likely(data, starts[0], False)
    if not has_optical:
        return total, LikelyParameters(False, starts[1], 0.0, -np.inf, (0.0, 0.0))
    return total, _most_likely(data, starts[1], True)


@compiled_part()
def is_more_likely(one: LikelyParameters, other: LikelyParameters) -> bool:
    """Whether an edge was found, and fits better than another."""
    return bool(one.is_found and one.log_likelihood > other.log_likelihood)


@compiled_part()
def _most_likely(data: Intervals, start: FloatArray, is_square: bool) -> LikelyParameters:
    """Maximise the likelihood of one edge by damped Newton steps."""
    edge_count = len(start)
    best = np.full(edge_count + 2, log(_START * data.usual_noise_dn))
    for k in range(edge_count):
        best[k] = start[k]
    here = _equations(data, best, is_square)
    damping = 1e-3
    if not np.isfinite(here.log_likelihood):
        return LikelyParameters(False, start, 0.0, -np.inf, (0.0, 0.0))
    for _ in range(_MAX_STEPS):
        has_moved = False
        gain = 0.0
        for _ in range(_MAX_DAMPINGS):
            change = solved(here.hessian, here.gradient, damping)
            if not np.isfinite(change[0]):
                damping *= 10.0
                continue
            trial = best + change
            trial[LOG_SIGMA] = min(max(trial[LOG_SIGMA], best[LOG_SIGMA] - 1), best[LOG_SIGMA] + 1)
            there = _equations(data, trial, is_square)
            gain = there.log_likelihood - here.log_likelihood
            if gain >= 0:
                best, here = trial, there
                damping *= 0.1
                has_moved = True
                break
            damping *= 10.0
        if not has_moved or gain < _GAIN:
            break
    variance = inverse_element(here.hessian, LOG_SIGMA)
    least = _LEAST_NOISE * data.step_dn
    dark, bright = np.exp(best[edge_count]), np.exp(best[edge_count + 1])
    return LikelyParameters(
        bool(np.all(np.isfinite(best)) and variance > 0 and best[LOW + 1] > best[LOW]),
        best[:edge_count].copy(),
        variance,
        here.log_likelihood,
        (sqrt(dark**2 + least**2), sqrt(bright**2 + least**2)),
    )


@compiled_part()
def expected_residuals(data: Intervals, fit: LikelyParameters, is_square: bool) -> FloatArray:
    """Mean deviation from the model before rounding that each pixel's interval implies, in DN.

    Its mean is 0 at any level, where that of the rounded pixels is off by up to half a step.
    """
    model = edge_jacobian(data.pixels, fit.parameters, is_square)
    dark, bright = log(fit.noise_dn[0]), log(fit.noise_dn[1])
    out = np.empty(len(data.weights))
    for i in range(len(out)):
        s = np.exp((1 - model.edges[i]) * dark + model.edges[i] * bright)
        level = model.levels[i]
        out[i] = s * s * _interval_terms(data.lower[i] - level, data.upper[i] - level, s)[1]
    return out


@compiled_part()
def pixel_intervals(
    pixels: BandPixels,
    stored: FloatArray,
    levels: _LevelIntervals,
    weights: FloatArray,
    found: EdgeLevels,
) -> Intervals:
    """The levels that the stored codes stand for, less the shading that was taken off."""
    shading = stored - pixels.values
    contrast = found.levels.max() - found.levels.min()
    return Intervals(
        pixels,
        levels.lower - shading,
        levels.upper - shading,
        _one_code_weights(levels, weights, found.edges, contrast),
        levels.step_dn,
        levels.usual_noise_dn,
        np.zeros(len(stored)),
        np.empty(0),
    )


@compiled_part()
def _one_code_weights(
    levels: _LevelIntervals, weights: FloatArray, edges: FloatArray, contrast: float
) -> FloatArray:
    """Weights where a flat side that is one code throughout counts as one pixel.

    The noise does not reach the next code there: its rounding errors are all the same.
    """
    weights = weights.copy()
    lower, step_dn = levels.lower, levels.step_dn
    reach = _FLAT * step_dn / contrast
    # Which side a pixel is flat on: 0 or 1, -1 for none.
    side = np.full(len(weights), -1)
    count, least, largest = np.zeros(2), np.full(2, np.inf), np.full(2, -np.inf)
    for i in range(len(weights)):
        if levels.is_clipped[i] or reach <= edges[i] <= 1 - reach:
            continue
        k = int(edges[i] >= reach)
        side[i] = k
        if weights[i] > 0:
            count[k] += 1
            least[k], largest[k] = min(least[k], lower[i]), max(largest[k], lower[i])
    for i in range(len(weights)):
        k = side[i]
        if k >= 0 and count[k] > 0 and largest[k] - least[k] < 0.5 * step_dn:
            weights[i] /= count[k]
    return weights
