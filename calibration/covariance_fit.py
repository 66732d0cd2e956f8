"""From widths across edges of many angles to the covariance of the PSF.

Across an edge with unit normal n the PSF has the variance ``n' Sigma n``: linear in the three
elements of Sigma, so weighted least squares of the squared widths gives them all at once
(the paper's medians of vertical and horizontal edges are the special case of two angles).
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

__all__ = ["CovarianceFit", "Estimate", "fit_covariance", "orientation_of"]

Array = NDArray[np.float64]

ORIENTATION_TOLERANCE_DEG = 22.5
_NORMAL_95 = 1.959963984540054
_RHO_ERR_MOST = 0.25  # a correlation known worse than this is not determined
_WIDTH_ERR_MOST = 0.25  # relative
_TUKEY_SIGMAS = 5.0
_ROUNDS = 12
_BOOTSTRAP_EDGES = 12  # fewer edges cannot be resampled: the interval is the normal one
_RESAMPLES = 2000
_BOOTSTRAP_SEED = 20190906


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A value, its standard error and its 95 % interval."""

    value: float
    err: float
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CovarianceFit:
    """The PSF's widths and correlation; None for what the edges do not determine.

    ``scatter_px`` is what the widths scatter beyond their own errors (field, focus, paper);
    it is part of the errors. ``weights`` in [0, 1] says how far each edge was trusted.
    """

    sigma_x_px: Estimate | None
    sigma_y_px: Estimate | None
    rho: Estimate | None
    covariance_px2: Array | None
    scatter_px: float
    weights: Array

    @property
    def edges_used(self) -> int:
        """Number of edges that count at least half."""
        return int(np.count_nonzero(self.weights > 0.5))


def orientation_of(angle_deg: float) -> str:
    """Name of an edge's direction: vertical or horizontal within 22.5 degrees, else diagonal."""
    from_horizontal = abs((angle_deg + 90.0) % 180.0 - 90.0)
    if from_horizontal <= ORIENTATION_TOLERANCE_DEG:
        return "horizontal"
    if from_horizontal >= 90.0 - ORIENTATION_TOLERANCE_DEG:
        return "vertical"
    return "diagonal"


def fit_covariance(angles_deg: Array, sigma_px: Array, sigma_err_px: Array) -> CovarianceFit:
    """Fit the PSF covariance to widths across edges.

    Parameters
    ----------
    angles_deg
        Direction of each edge line against +x, y down; shape ``(n,)``.
    sigma_px, sigma_err_px
        Width across each edge and its standard error, in px; shape ``(n,)``.

    Returns
    -------
    CovarianceFit
        With edges of one orientation only, that width alone is determined; with vertical and
        horizontal edges alone, both widths but no correlation.

    Raises
    ------
    ValueError
        If there is no edge, or a width or error is not positive.
    """
    angles = np.asarray(angles_deg, dtype=np.float64)
    sigma = np.asarray(sigma_px, dtype=np.float64)
    err = np.asarray(sigma_err_px, dtype=np.float64)
    if angles.size == 0:
        raise ValueError("a PSF needs at least one edge")
    if not (np.all(sigma > 0) and np.all(err > 0)):
        raise ValueError("widths and their errors must be positive")
    normal = np.deg2rad(angles + 90.0)
    nx, ny = np.cos(normal), np.sin(normal)
    full = np.column_stack([nx**2, 2 * nx * ny, ny**2])
    result = _determined_fully(full, sigma, err)
    if result is not None:
        return result
    names = np.array([orientation_of(a) for a in angles.tolist()])
    vertical, horizontal = names == "vertical", names == "horizontal"
    axial = vertical | horizontal
    if vertical.any() and horizontal.any():
        return _axis_aligned(full[:, [0, 2]], sigma, err, axial)
    weights = np.zeros(angles.size)
    fits: dict[str, Estimate | None] = {"vertical": None, "horizontal": None}
    scatter = 0.0
    for name, chosen in (("vertical", vertical), ("horizontal", horizontal)):
        if chosen.any():
            ones = np.ones((int(chosen.sum()), 1))
            fit = _least_squares(ones, sigma[chosen], err[chosen])
            fits[name] = _width(fit, 0)
            weights[chosen] = fit.weights
            scatter = fit.scatter_px
    return CovarianceFit(
        sigma_x_px=fits["vertical"],
        sigma_y_px=fits["horizontal"],
        rho=None,
        covariance_px2=None,
        scatter_px=scatter,
        weights=weights,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Solution:
    values: Array
    covariance: Array
    replicates: Array | None
    scatter_px: float
    weights: Array


def _least_squares(design: Array, sigma: Array, err: Array) -> _Solution:
    """Robust weighted least squares of ``sigma**2``, scatter beyond the errors included."""
    count, unknowns = design.shape
    squares = sigma**2
    centre = sigma.copy()  # each width's model value, once there is one
    trust = np.ones(count)
    scatter2 = 0.0
    values: Array = np.zeros(unknowns)
    weight = np.ones(count)
    for round_ in range(_ROUNDS):
        spread = 2 * centre * np.sqrt(err**2 + scatter2)
        weight = trust / spread**2
        normal = design.T @ (weight[:, None] * design)
        values = np.asarray(
            np.linalg.solve(normal, design.T @ (weight * squares)), dtype=np.float64
        )
        model = design @ values
        centre = np.sqrt(np.maximum(model, 0.25 * squares))
        deviation = (squares - model) / (2 * centre)
        freedom = trust.sum() - unknowns
        if freedom >= 1:
            scatter2 = _excess_variance(deviation, err, trust, freedom)
            if count >= 6 and round_ > 0:
                robust = np.median(np.abs(deviation / np.sqrt(err**2 + scatter2)))
                scale = max(robust / 0.6745, 1.0)
                ratio = deviation / (_TUKEY_SIGMAS * scale * np.sqrt(err**2 + scatter2))
                trust = np.where(np.abs(ratio) < 1, (1 - ratio**2) ** 2, 0.0)
                trust = np.where(np.abs(ratio) < 0.5, 1.0, trust)
    covariance: Array = np.asarray(
        np.linalg.inv(design.T @ (weight[:, None] * design)), dtype=np.float64
    )
    return _Solution(
        values=values,
        covariance=covariance,
        replicates=_bootstrap(design, squares, weight),
        scatter_px=sqrt(scatter2),
        weights=trust,
    )


def _excess_variance(deviation: Array, err: Array, trust: Array, freedom: float) -> float:
    """Variance beyond the errors that makes the weighted squares equal their expectation.

    Paule and Mandel, "Consensus values and weighting factors", J. Res. NBS 87 (1982) 377.
    """
    low, high = 0.0, float(np.max(deviation**2)) * 2 + 1e-30

    def surplus(variance: float) -> float:
        return float(np.sum(trust * deviation**2 / (err**2 + variance))) - freedom

    if surplus(0.0) <= 0:
        return 0.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if surplus(middle) > 0:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def _bootstrap(design: Array, squares: Array, weight: Array) -> Array | None:
    """Solutions of resampled edges, shape ``(resamples, unknowns)``; None for few edges.

    The replicates are widened by sqrt(n / (n - p)): resampled residuals are too small.
    """
    count, unknowns = design.shape
    if count < _BOOTSTRAP_EDGES:
        return None
    rng = np.random.default_rng(_BOOTSTRAP_SEED)
    copies = rng.multinomial(count, np.full(count, 1 / count), size=_RESAMPLES)
    w = copies * weight
    normal = np.einsum("rn,ni,nj->rij", w, design, design, optimize=True)
    right = np.einsum("rn,ni->ri", w * squares, design, optimize=True)
    # A resample without one of the directions has no solution: its row is left out.
    usable = np.linalg.cond(normal) < 1e10
    solved = np.linalg.solve(normal[usable], right[usable][:, :, None])[:, :, 0]
    middle = np.linalg.solve(design.T @ (weight[:, None] * design), design.T @ (weight * squares))
    return np.asarray(middle + (solved - middle) * sqrt(count / (count - unknowns)))


def _estimate(value: float, err: float, replicates: Array | None) -> Estimate:
    if replicates is not None and replicates.size >= _RESAMPLES // 2:
        low, high = np.quantile(replicates, [0.025, 0.975])
        return Estimate(value=value, err=err, low=float(low), high=float(high))
    return Estimate(
        value=value, err=err, low=value - _NORMAL_95 * err, high=value + _NORMAL_95 * err
    )


def _width(fit: _Solution, place: int) -> Estimate | None:
    """Square root of a variance, with its error; None where the variance is not positive."""
    variance = float(fit.values[place])
    if not variance > 0:
        return None
    value = sqrt(variance)
    replicates = None
    if fit.replicates is not None:
        replicates = np.sqrt(np.maximum(fit.replicates[:, place], 0.0))
    err = sqrt(float(fit.covariance[place, place])) / (2 * value)
    return _estimate(value, err, replicates)


def _determined_fully(design: Array, sigma: Array, err: Array) -> CovarianceFit | None:
    if sigma.size < 3 or np.linalg.matrix_rank(design, tol=1e-3) < 3:
        return None
    fit = _least_squares(design, sigma, err)
    xx, xy, yy = fit.values.tolist()
    if not (xx > 0 and yy > 0 and xx * yy > xy * xy):
        return None
    x, y = _width(fit, 0), _width(fit, 2)
    rho = xy / sqrt(xx * yy)
    gradient = np.array([-rho / (2 * xx), 1 / sqrt(xx * yy), -rho / (2 * yy)])
    rho_err = sqrt(float(gradient @ fit.covariance @ gradient))
    if x is None or y is None or rho_err > _RHO_ERR_MOST:
        return None
    if max(x.err / x.value, y.err / y.value) > _WIDTH_ERR_MOST:
        return None
    replicates = None
    if fit.replicates is not None:
        r = fit.replicates[(fit.replicates[:, 0] > 0) & (fit.replicates[:, 2] > 0)]
        replicates = r[:, 1] / np.sqrt(r[:, 0] * r[:, 2])
    return CovarianceFit(
        sigma_x_px=x,
        sigma_y_px=y,
        rho=_estimate(rho, rho_err, replicates),
        covariance_px2=np.array([[xx, xy], [xy, yy]]),
        scatter_px=fit.scatter_px,
        weights=fit.weights,
    )


def _axis_aligned(
    design: Array, sigma: Array, err: Array, axial: NDArray[np.bool_]
) -> CovarianceFit:
    fit = _least_squares(design[axial], sigma[axial], err[axial])
    weights = np.zeros(sigma.size)
    weights[axial] = fit.weights
    return CovarianceFit(
        sigma_x_px=_width(fit, 0),
        sigma_y_px=_width(fit, 1),
        rho=None,
        covariance_px2=None,
        scatter_px=fit.scatter_px,
        weights=weights,
    )
