"""Kernel, light and scatter fitted to two smoothed photographs, in turns."""

from dataclasses import dataclass

import numpy as np

from analysis.changes.matching.matching_kernel import (
    MatchingKernel,
    biweight,
    design_matrix,
    solve,
)
from analysis.changes.matching.pixels import away_from, sampled
from analysis.changes.matching.residual_variance import VarianceTerms, fit_sizes
from simulation.arrays import BoolArray, Float32Array, FloatArray

_SAMPLE_PX = 25_000
_ROUNDS = 3
_OUTLIER_SD, _OUTLIER_REACH_PX = 4.5, 2.0
"""Pixels that are left out of the last round, with their neighbours."""

_LEAST_DN2 = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairFit:
    """What takes the source to the target, and what the remaining difference scatters by.

    Parameters
    ----------
    kernel
        Kernel and light.
    sizes
        Of the terms of the variance.
    """

    kernel: MatchingKernel
    sizes: FloatArray


def fit_pair(
    source: Float32Array,
    target: Float32Array,
    terms: VarianceTerms,
    valid: BoolArray,
    floor_dn2: Float32Array | None,
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
            reach = _OUTLIER_SD * np.sqrt(terms.variance(sizes, floor_dn2))
            outlier = valid & (np.abs(target - kernel.of(source)) > reach)
            kept = away_from(outlier, _OUTLIER_REACH_PX)[rows, cols]
    return PairFit(kernel=kernel, sizes=sizes)
