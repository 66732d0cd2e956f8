"""The noise of a camera's frames by their light, from the frames themselves."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

QUANTISATION_DN2 = 1.0 / 12.0
"""Variance of rounding to whole DN (EMVA 1288 release 4.0, section 2.4)."""

USED_RANGE = 0.9
"""Fraction of the range up to which pixels are used: the variance of those that clip collapses."""

_BINS = 128
_ROUNDS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseLine:
    """Variance of one frame: dark noise and rounding, and shot noise that grows with the light.

    ``offset_dn2 + slope_dn * light``, with the light in DN above black.

    References
    ----------
    EMVA Standard 1288, release 4.0 linear, 2021, section 2.4.
    """

    offset_dn2: float
    slope_dn: float

    def variance_dn2(self, light_dn: NDArray[np.float64]) -> NDArray[np.float64]:
        """Variance at each light; light below black has that of black."""
        return self.offset_dn2 + self.slope_dn * np.maximum(light_dn, 0.0)


Sample = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Mean level and unbiased temporal variance of one frame, by pixel."""


def fit_noise_line(
    samples: Iterable[Sample], *, black_level_dn: float, saturation_dn: float
) -> NoiseLine:
    """Fit the line to all pixels of several exposures together.

    Means and variances are averaged over pixels of like level first: a single variance of N
    frames scatters by ``sqrt(2 / (N - 1))`` of itself, that of thousands of pixels does not. The
    line never falls, and is at black at least the variance of rounding.
    """
    top_dn = black_level_dn + USED_RANGE * (saturation_dn - black_level_dn)
    count, light, variance = np.zeros(_BINS), np.zeros(_BINS), np.zeros(_BINS)
    for mean_dn, variance_dn2 in samples:
        is_used = mean_dn < top_dn
        level = mean_dn[is_used].astype(np.float64)
        # Square-root bins: shot noise is then as fine in each.
        share = np.sqrt(np.maximum(level - black_level_dn, 0.0) / (top_dn - black_level_dn))
        index = np.minimum((_BINS * share).astype(np.intp), _BINS - 1)
        count += np.bincount(index, minlength=_BINS)
        light += np.bincount(index, level - black_level_dn, minlength=_BINS)
        variance += np.bincount(index, variance_dn2[is_used].astype(np.float64), minlength=_BINS)
    is_seen = count > 0
    if not is_seen.any():
        return NoiseLine(offset_dn2=QUANTISATION_DN2, slope_dn=0.0)
    count = count[is_seen]
    return _weighted_line(count, light[is_seen] / count, variance[is_seen] / count)


def _weighted_line(
    count: NDArray[np.float64], light: NDArray[np.float64], variance: NDArray[np.float64]
) -> NoiseLine:
    """Least squares, weighted by the scatter of a mean variance: in proportion to it."""
    overall = max(float(np.average(variance, weights=count)), QUANTISATION_DN2)
    line = NoiseLine(offset_dn2=overall, slope_dn=0.0)
    for _ in range(_ROUNDS):
        weight = count / line.variance_dn2(light) ** 2
        centre = float(np.average(light, weights=weight))
        middle = float(np.average(variance, weights=weight))
        moment = float(np.sum(weight * (light - centre) ** 2))
        slope = float(np.sum(weight * (light - centre) * variance)) / moment if moment > 0 else 0.0
        slope = max(slope, 0.0)
        offset = middle - slope * centre
        if offset < QUANTISATION_DN2:
            # Without dark noise the line goes through what rounding leaves.
            offset = QUANTISATION_DN2
            power = float(np.sum(weight * light**2))
            slope = max(float(np.sum(weight * light * (variance - offset))) / power, 0.0)
        line = NoiseLine(offset_dn2=offset, slope_dn=slope)
    return line
