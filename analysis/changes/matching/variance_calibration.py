"""What a predicted variance has to be multiplied by, from the differences themselves.

Pixels are sorted into bins by their predicted variance. Where its terms do not hold, such as on the
sharpest edges or with heavy tails, the differences in the bin tell.
"""

from dataclasses import dataclass
from itertools import pairwise
from math import inf, pi, sqrt

import numpy as np

from analysis.changes.matching.pixels import away_from, sampled
from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, Float32Array, FloatArray
from simulation.compiled import compiled

_EDGES = np.concatenate([np.linspace(0, 0.9, 13), [0.95, 0.98, 0.99, 1.0]])
"""Quantiles of the predicted variance between which the bins lie."""

_TAIL, _TAIL_SD = 0.99, 2.5758293035489004
"""Share of normal values within so many standard deviations."""

_TAIL_SCATTER = 1.33
"""Standard deviation of the tail's quantile over the spread, over the root of 1 / n; a tail must
exceed it to count."""

_LEAST_STEP = 0.1
"""Pixels whose predicted variances agree to 10 % are of one kind; a bin of them alone could be
filled by one change."""

_LEAST_PX = 30
_STRUCTURE = 0.2
"""Share of the predicted variance beside noise from which on a tail counts in full: noise has none,
and faint changes, which lie anywhere, would pass for one."""

_SAMPLE_PX = 500_000
_CHANGE_SD, _CHANGE_REACH_PX = 4.5, 5.0
"""Pixels that are taken as changed, and how far around them."""

_STEP, _LARGE_PX = 2, 1_000_000
_ROUNDS = 4
"""A change that is found is left out, with what is around it; what is none comes back."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class VarianceCalibration:
    """Factors of the standard deviation by the logarithm of the predicted variance.

    Parameters
    ----------
    log_variance, log_factor
        Shape ``(bins,)``, the first rising.
    """

    log_variance: FloatArray
    log_factor: FloatArray

    def factor(self, variance_dn2: Float32Array) -> Float32Array:
        """Factor of the standard deviation at each pixel."""
        return _interpolated(variance_dn2, self.log_variance, self.log_factor)


@compiled(nogil=True)
def _interpolated(
    variance_dn2: Float32Array, log_variance: FloatArray, log_factor: FloatArray
) -> Float32Array:
    factor = np.empty(variance_dn2.shape, dtype=np.float32)
    last = len(log_variance) - 1
    place = 0
    for row in range(variance_dn2.shape[0]):
        for col in range(variance_dn2.shape[1]):
            at = np.log(variance_dn2[row, col])
            # Neighbours have like variances: the search begins where the last one ended.
            while place < last - 1 and at > log_variance[place + 1]:
                place += 1
            while place > 0 and at < log_variance[place]:
                place -= 1
            value = log_factor[place]
            if last > 0:
                low, high = log_variance[place], log_variance[place + 1]
                share = min(max((at - low) / (high - low), 0.0), 1.0)
                value += share * (log_factor[place + 1] - value)
            factor[row, col] = np.exp(value)
    return factor


def calibrate_variance(
    difference_dn: FloatArray,
    variance_dn2: FloatArray,
    noise_dn2: FloatArray,
    alike: float | None,
) -> VarianceCalibration:
    """Compare differences with their predicted variance.

    Parameters
    ----------
    difference_dn, variance_dn2
        Of a sample of pixels without a change, shape ``(n,)``.
    noise_dn2
        The part of the variance that is noise.
    alike
        Pixels of the sample to one that is independent of the others; None leaves the tails out.
    """
    ratio = np.abs(difference_dn) / np.sqrt(variance_dn2)
    log_variance = np.log(variance_dn2)
    edges = _apart(np.quantile(log_variance, _EDGES).tolist())
    middles, spreads, tails = [], [], []
    for low, high in pairwise(edges):
        inside = (log_variance >= low) & (log_variance < high)
        count = int(inside.sum())
        if count < _LEAST_PX:
            continue
        spread = robust_sigma(ratio[inside]) + 1e-6
        tail = 1.0
        if alike is not None:
            tail = float(np.quantile(ratio[inside], _TAIL)) / _TAIL_SD / spread
            tail = max(0.0, tail - _TAIL_SCATTER * sqrt(alike / count) - 1)
            share = 1 - float(np.mean(noise_dn2[inside] / variance_dn2[inside]))
            tail = 1 + tail * min(max(share, 0.0) / _STRUCTURE, 1.0)
        middles.append(float(np.median(log_variance[inside])))
        spreads.append(spread)
        tails.append(tail)
    if not middles:
        return VarianceCalibration(log_variance=np.zeros(1), log_factor=np.zeros(1))
    factors = np.array(spreads) * np.array(tails)
    return VarianceCalibration(log_variance=np.array(middles), log_factor=np.log(factors))


def _apart(edges: list[float]) -> list[float]:
    """Leave out edges that hardly differ from the one before; the last bin is open."""
    kept = edges[:1]
    for edge in edges[1:-1]:
        if edge - kept[-1] > _LEAST_STEP:
            kept.append(edge)
    return [*kept, inf]


def calibrated_factor(
    difference_dn: Float32Array,
    variance_dn2: Float32Array,
    noise_dn2: Float32Array,
    valid: BoolArray,
    smoothing_px: float,
) -> Float32Array:
    """Factor of the predicted standard deviation at every pixel, changes left out.

    Parameters
    ----------
    difference_dn, variance_dn2, noise_dn2
        Difference, its predicted variance and the part of it that is noise, shape
        ``(rows, cols)``.
    valid
        Pixels that count.
    smoothing_px
        Width of the Gaussian that makes neighbours alike.
    """
    # Smoothed images are known from every other pixel.
    seen = np.s_[::_STEP, ::_STEP] if valid.size > _LARGE_PX else np.s_[:, :]
    step = _STEP if valid.size > _LARGE_PX else 1
    difference, variance, part = difference_dn[seen], variance_dn2[seen], valid[seen]
    noise = noise_dn2[seen]
    independent = np.count_nonzero(valid) / (4 * pi * smoothing_px**2)
    kept = part
    for number in range(_ROUNDS):
        rows, cols = sampled(kept, _SAMPLE_PX)
        # A change in the tail would hide itself: the spread alone finds it first.
        alike = None if number == 0 else len(rows) / independent + 1
        calibration = calibrate_variance(
            difference[rows, cols].astype(np.float64),
            variance[rows, cols].astype(np.float64),
            noise[rows, cols].astype(np.float64),
            alike,
        )
        if number == _ROUNDS - 1:
            break
        reach = np.square(_CHANGE_SD * calibration.factor(variance)) * variance
        found = part & (np.square(difference) > reach)
        remaining = part & away_from(found, _CHANGE_REACH_PX / step)
        if number > 0 and np.array_equal(remaining, kept):
            break
        kept = remaining
    return calibration.factor(variance_dn2)
