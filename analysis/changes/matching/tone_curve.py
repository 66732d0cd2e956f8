"""The tone curve between two photographs whose levels are not in proportion.

Medians of one photograph's levels against the other's where both are smooth give a first curve. It
is then improved together with the kernel: splines of the target's levels, made before the smoothing
because smoothing and a curve do not commute, are more columns of the same least squares.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from analysis.changes.matching.matching_kernel import (
    NormalEquations,
    biweight,
    design_matrix,
)
from analysis.changes.matching.pixels import sampled
from analysis.changes.matching.smoothed_warp import smoothed
from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray

_SAMPLE_PX = 25_000
_SMOOTH_SHARE = 0.4
"""Share of the pixels, those with the least gradient, at which levels are held against levels."""

_BINS, _LEAST_PX = 48, 12
_DEGREE = 3
_KNOTS = 16
_TABLE = 1024
_RARE_PERCENT, _RARE_PX = 0.5, 3000
_BEND = 2e-3
"""Standard deviation of the splines' second differences about the first curve, over its range:
levels that hardly occur follow their neighbours."""

_ROUNDS = 3
_LEAST_SLOPE = 0.02
"""Of the curve, over its mean: steeper the other way round, noise would be all that it shows."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ToneCurve:
    """Levels of the source for the levels of the target; straight beyond both ends.

    Parameters
    ----------
    levels_dn
        Levels of the target, evenly spaced, shape ``(n,)``.
    values_dn, variance_dn2
        Levels of the source there, and the variance that the fit leaves them.
    """

    levels_dn: FloatArray
    values_dn: FloatArray
    variance_dn2: FloatArray

    def of(self, image: Float32Array) -> Float32Array:
        """Bring a photograph to the source's levels."""
        step = self.levels_dn[1] - self.levels_dn[0]
        slopes = (self.values_dn[[1, -1]] - self.values_dn[[0, -2]]) / step
        made = np.interp(image, self.levels_dn, self.values_dn)
        made += np.minimum(image - self.levels_dn[0], 0) * slopes[0]
        made += np.maximum(image - self.levels_dn[-1], 0) * slopes[1]
        return made.astype(np.float32)

    def slope(self, image: Float32Array) -> Float32Array:
        """Derivative at the levels of a photograph."""
        slopes = np.gradient(self.values_dn, self.levels_dn)
        return np.interp(image, self.levels_dn, slopes).astype(np.float32)

    def variance(self, image: Float32Array) -> Float32Array:
        """Variance of the curve at the levels of a photograph."""
        return np.interp(image, self.levels_dn, self.variance_dn2).astype(np.float32)


def fit_tone_curve(
    source: Float32Array, target: Float32Array, valid: BoolArray, smoothing_px: float
) -> ToneCurve | None:
    """Fit the curve and the kernel together; None where levels do not tell one.

    Parameters
    ----------
    source
        On the target's pixels, smoothed.
    target
        As it is.
    valid
        Pixels that count.
    smoothing_px
        Width of the Gaussian for the target.
    """
    first = _by_medians(source, smoothed(target, smoothing_px), target, valid)
    if first is None:
        return None
    rows, cols = _sample_with_ends(target, valid)
    level = float(source[rows, cols].mean())
    design = design_matrix(source, level, rows, cols)
    basis = _basis(first, target[rows, cols])
    splines = np.stack(
        [
            smoothed(np.interp(target, first.levels_dn, line).astype(np.float32), smoothing_px)[
                rows, cols
            ]
            for line in basis
        ],
        axis=1,
    ).astype(np.float64)
    measured = smoothed(first.of(target), smoothing_px)[rows, cols].astype(np.float64)
    joint = np.concatenate([design, -splines], axis=1)
    bends = np.zeros((_KNOTS, joint.shape[1]))
    bends[:, design.shape[1] :] = np.diff(np.eye(_KNOTS + 2), 2, axis=0)
    bends /= _BEND * (first.values_dn[-1] - first.values_dn[0])
    weight = np.ones(len(rows))
    alike = 4 * np.pi * smoothing_px**2 / np.count_nonzero(valid) * len(rows) + 1
    for _ in range(_ROUNDS):
        equations = NormalEquations.of(joint, measured, weight, bends.T @ bends, centre=1.0)
        coefficients = equations.solution()
        residual = measured - joint @ coefficients
        scale = robust_sigma(residual) + 1e-9
        weight = biweight(residual / scale) / (scale**2 * alike)
    rooted = joint * np.sqrt(weight)[:, None]
    normal = rooted.T @ rooted + bends.T @ bends
    normal[np.diag_indices_from(normal)] *= 1 + 1e-9
    covariance = np.linalg.inv(normal)[design.shape[1] :, design.shape[1] :]
    made = first.values_dn + coefficients[design.shape[1] :] @ basis
    return _rising(first.levels_dn, made, np.einsum("in,ij,jn->n", basis, covariance, basis))


def _sample_with_ends(target: Float32Array, valid: BoolArray) -> tuple[IntArray, IntArray]:
    """A sample of pixels, and more of the darkest and the brightest, which are rare."""
    rows, cols = sampled(valid, _SAMPLE_PX)
    low, high = np.percentile(target[rows, cols], [_RARE_PERCENT, 100 - _RARE_PERCENT]).tolist()
    rare = sampled(valid & ((target < low) | (target > high)), _RARE_PX)
    return np.concatenate([rows, rare[0]]), np.concatenate([cols, rare[1]])


def _by_medians(
    source: Float32Array, smooth_target: Float32Array, target: Float32Array, valid: BoolArray
) -> ToneCurve | None:
    """Cubic through the medians of the source at levels of the target, over all its levels."""
    slope_y, slope_x = np.gradient(smooth_target)
    steep: Float32Array = np.asarray(slope_y * slope_y + slope_x * slope_x)
    smooth = valid & (steep <= float(np.quantile(steep[valid], _SMOOTH_SHARE)))
    level, value = smooth_target[smooth], source[smooth]
    edges = np.linspace(float(level.min()), float(level.max()) + 1e-6, _BINS + 1)
    index = np.digitize(level, edges) - 1
    middles, medians, counts = [], [], []
    for bin_number in range(_BINS):
        inside = index == bin_number
        count = np.count_nonzero(inside)
        if count >= _LEAST_PX:
            middles.append(float(np.median(level[inside])))
            medians.append(float(np.median(value[inside])))
            counts.append(count)
    if len(middles) < _DEGREE + 2:
        return None
    curve = np.polynomial.Polynomial.fit(middles, medians, _DEGREE, w=np.array(counts) ** 0.25)
    levels = np.linspace(float(target[valid].min()), float(target[valid].max()) + 1e-6, _TABLE)
    return _rising(levels, np.asarray(curve(levels)), np.zeros(_TABLE))


def _rising(
    levels_dn: FloatArray, values_dn: FloatArray, variance_dn2: FloatArray
) -> ToneCurve | None:
    """The curve, made to rise everywhere; None if it does not as a whole."""
    steps = np.diff(values_dn)
    mean = float(steps.mean())
    if not mean > 0:
        return None
    rising = np.concatenate([[0.0], np.cumsum(np.maximum(steps, _LEAST_SLOPE * mean))])
    middle = len(levels_dn) // 2
    values = values_dn[middle] - rising[middle] + rising
    return ToneCurve(levels_dn=levels_dn, values_dn=values, variance_dn2=variance_dn2)


def _basis(first: ToneCurve, levels: Float32Array) -> FloatArray:
    """Cubic B-splines over the levels, orthogonal to a constant and to the first curve.

    Otherwise the target would explain itself. Shape ``(splines, n)``.
    """
    low, high = float(first.levels_dn[0]), float(first.levels_dn[-1])
    step = (high - low) / (_KNOTS - 1)
    knots = low + step * np.arange(-3, _KNOTS + 3)
    table = (
        BSpline.design_matrix(np.clip(first.levels_dn, low, high - 1e-9 * step), knots, 3)
        .toarray()
        .T
    )
    share, _ = np.histogram(levels, bins=_TABLE, range=(low, high))
    root = np.sqrt(share + 1e-3)
    fixed = np.stack([np.ones(_TABLE), first.values_dn - first.values_dn.mean()])
    weights = np.linalg.lstsq((fixed * root).T, (table * root).T, rcond=None)[0]
    return np.asarray(table - weights.T @ fixed)
