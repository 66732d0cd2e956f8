"""Kernel, light and scatter fitted to two smoothed photographs, in turns."""

from dataclasses import dataclass
from math import pi

import numpy as np

from analysis.changes.matching.matching_kernel import (
    CENTRE_TAP,
    MatchingKernel,
    biweight,
    design_matrix,
    solve,
)
from analysis.changes.matching.pixels import sampled
from analysis.changes.matching.residual_variance import VarianceTerms, fit_sizes
from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray

_SAMPLE_PX = 25_000
_ROUNDS = 3
_OUTLIER_SD, _OUTLIER_REACH_PX = 4.5, 2.0
"""Pixels that are left out of the last round, with their neighbours."""

_LEAST_DN2 = 1e-12

_POWERS = (2, 3, 4)
_CURVED_CHI2 = 60.0
"""Chi-squared of three powers of the level from which on a tone curve is needed; 16 is exceeded by
chance in one pair of a thousand, and what compression and clipping bend is more."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairFit:
    """What takes the source to the target, and what the remaining difference scatters by.

    Parameters
    ----------
    kernel
        Kernel and light.
    sizes
        Of the terms of the variance.
    is_curved
        Whether the levels of the two are not in proportion, beyond what chance does.
    """

    kernel: MatchingKernel
    sizes: FloatArray
    is_curved: bool


def fit_pair(
    source: Float32Array,
    target: Float32Array,
    terms: VarianceTerms,
    valid: BoolArray,
    floor_dn2: Float32Array | None,
    smoothing_px: float,
) -> PairFit:
    """Fit kernel and variance to a sample of the pixels.

    Parameters
    ----------
    source, target
        Smoothed, shape ``(rows, cols)``, finite.
    terms
        Of the variance.
    valid
        Pixels that count, the kernel's radius away from the border.
    floor_dn2
        Variance that a noise model gives the difference, if there is one.
    smoothing_px
        Width of the Gaussian that makes neighbours alike.
    """
    rows, cols = sampled(valid, _SAMPLE_PX)
    level = float(source[rows, cols].mean())
    design = design_matrix(source, level, rows, cols)
    measured = target[rows, cols].astype(np.float64)
    at = terms.at(rows, cols)
    floor = None if floor_dn2 is None else floor_dn2[rows, cols].astype(np.float64)
    weight, kept = np.ones(len(rows)), np.ones(len(rows), dtype=np.bool_)
    for number in range(_ROUNDS):
        coefficients = solve(design, measured, weight * kept)
        residual = measured - design @ coefficients
        sizes = fit_sizes(residual[kept], at[:, kept], None if floor is None else floor[kept])
        variance = np.maximum(sizes @ at, _LEAST_DN2 if floor is None else floor)
        weight = biweight(residual / np.sqrt(variance)) / variance
        kernel = MatchingKernel(coefficients=coefficients, level_dn=level)
        if number == _ROUNDS - 2:
            beside = _Neighbours.of(rows, cols, valid)
            near_floor = None if floor_dn2 is None else floor_dn2[beside.rows, beside.cols]
            near_variance = sizes @ terms.at(beside.rows, beside.cols)
            reach = _OUTLIER_SD * np.sqrt(
                np.maximum(near_variance, _LEAST_DN2 if near_floor is None else near_floor)
            )
            made = kernel.at(source, beside.rows, beside.cols)
            kept = ~beside.any_of(np.abs(target[beside.rows, beside.cols] - made) > reach)
    alike = 4 * pi * smoothing_px**2 / np.count_nonzero(valid) * len(rows) + 1
    curved = _curvature_chi2(design, residual, weight * kept / alike) > _CURVED_CHI2
    return PairFit(kernel=kernel, sizes=sizes, is_curved=curved)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Neighbours:
    """Pixels of a mask within an outlier's reach of samples, and which samples they are near.

    A sample of a large frame has far fewer of them than the frame has pixels.
    """

    rows: IntArray
    cols: IntArray
    counts: BoolArray

    @classmethod
    def of(cls, rows: IntArray, cols: IntArray, mask: BoolArray) -> "_Neighbours":
        """Neighbours of samples that are the reach away from the border."""
        reach = int(_OUTLIER_REACH_PX)
        y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1, 1)
        y, x = (along[y**2 + x**2 <= _OUTLIER_REACH_PX**2][:, None] for along in (y, x))
        counts = mask[rows + y, cols + x]
        return cls(rows=(rows + y)[counts], cols=(cols + x)[counts], counts=counts)

    def any_of(self, marked: BoolArray) -> BoolArray:
        """Samples near a marked pixel, shape ``(samples,)``."""
        every = np.zeros(self.counts.shape, dtype=np.bool_)
        every[self.counts] = marked
        return np.asarray(every.any(axis=0))


def _curvature_chi2(design: FloatArray, residual: FloatArray, weight: FloatArray) -> float:
    """Chi-squared that powers of the source's level take from the residuals.

    The target's noise is in none of them.
    """
    level = design[:, CENTRE_TAP]
    contrast = np.clip(level / max(float(level.std()), 1e-9), -3, 3)
    root = np.sqrt(weight)
    powers = np.stack([contrast**power * root for power in _POWERS], axis=1)
    rooted = design * root[:, None]
    # What kernel and light already explain of the powers tells nothing.
    powers -= rooted @ np.linalg.lstsq(rooted.T @ rooted, rooted.T @ powers, rcond=1e-12)[0]
    share = powers.T @ (residual * root)
    return float(share @ np.linalg.lstsq(powers.T @ powers, share, rcond=1e-12)[0])
