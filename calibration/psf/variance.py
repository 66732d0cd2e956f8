"""Robust weighted least squares on squared widths that allows for scatter beyond the errors.

Serves every model that is linear in the elements of a covariance: one PSF, or a PSF field.
"""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from scipy.special import stdtrit

from calibration.psf.repeatability import (
    CaptureFit,
    EdgeSquares,
    SharedByCapture,
    excess_variance,
    fit_by_capture,
)
from calibration.robust import robust_sigma
from simulation.arrays import FloatArray

RESAMPLES = 2000
_TUKEY_SIGMAS = 5.0
_ROUNDS = 12
_BOOTSTRAP_EDGES = 12  # with fewer edges there is no resampling: the interval is the normal one
_BOOTSTRAP_SEED = 20190906


@dataclass(frozen=True, slots=True, kw_only=True)
class VarianceFit:
    """Elements of a covariance, from a linear model of squared widths.

    ``covariance`` is that of ``values``; ``replicates`` holds the solutions of resampled edges,
    shape ``(resamples, unknowns)``, or None for few edges. ``scatter_px`` is the scatter of the
    widths beyond their errors; ``weights``, in [0, 1], are the robust weights of the edges.
    ``by_capture`` is the fit with what captures share, None where they cannot be told apart.
    """

    values: FloatArray
    covariance: FloatArray
    replicates: FloatArray | None
    scatter_px: float
    weights: FloatArray
    by_capture: CaptureFit | None = None

    @property
    def is_by_capture(self) -> bool:
        """Whether the values are those of the fit with what captures share."""
        return self.by_capture is not None and self.values is self.by_capture.values


def fit_variances(
    design: FloatArray,
    sigma: FloatArray,
    err: FloatArray,
    *,
    shared: SharedByCapture | None = None,
    is_resampled: bool = True,
) -> VarianceFit:
    """Robust weighted least squares on ``sigma**2``, allowing for scatter beyond the errors.

    Parameters
    ----------
    design
        Shape ``(n, unknowns)``, of full rank.
    sigma, err
        Widths and their standard errors, in px, positive; shape ``(n,)``.
    shared
        The captures of the edges; None if each edge is independent of the others.
    is_resampled
        Whether to resample the edges for the intervals.
    """
    count, unknowns = design.shape
    squares = sigma**2
    centre = sigma.copy()  # the model's value of each width, after the first round
    trust = np.ones(count)
    scatter2 = 0.0
    values: FloatArray = np.zeros(unknowns)
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
            scatter2 = excess_variance(deviation, err, trust, freedom)
            if count >= 6 and round_ > 0:
                scale = max(robust_sigma(deviation / np.sqrt(err**2 + scatter2)), 1.0)
                ratio = deviation / (_TUKEY_SIGMAS * scale * np.sqrt(err**2 + scatter2))
                trust = np.where(np.abs(ratio) < 1, (1 - ratio**2) ** 2, 0.0)
                trust = np.where(np.abs(ratio) < 0.5, 1.0, trust)
    covariance: FloatArray = np.asarray(
        np.linalg.inv(design.T @ (weight[:, None] * design)), dtype=np.float64
    )
    fit = VarianceFit(
        values=values,
        covariance=covariance,
        replicates=None,
        scatter_px=sqrt(scatter2),
        weights=trust,
    )
    if shared is not None and shared.captures > 1:
        edges = EdgeSquares(
            design=design, squares_px2=squares, err_px=err, spread_px=2 * centre, trust=trust
        )
        fit = _by_capture(fit, fit_by_capture(edges, shared), shared)
    if is_resampled and not fit.is_by_capture:
        return replace(fit, replicates=_bootstrap(design, squares, weight))
    return fit


def _by_capture(fit: VarianceFit, found: CaptureFit | None, shared: SharedByCapture) -> VarianceFit:
    """The fit that knows of captures, where these share something that is significant."""
    if found is None or not (found.is_scattered or shared.precision.size):
        return replace(fit, by_capture=found)
    return replace(
        fit,
        values=found.values,
        covariance=found.covariance,
        scatter_px=found.scatter_px,
        weights=found.trust,
        by_capture=found,
    )


def _bootstrap(design: FloatArray, squares: FloatArray, weight: FloatArray) -> FloatArray | None:
    """Solutions of resampled edges, shape ``(resamples, unknowns)``; None for few edges.

    The replicates are widened by sqrt(n / (n - p)), because resampled residuals are too small, and
    by the ratio of Student's quantile to the normal one, because their spread is itself uncertain.
    """
    count, unknowns = design.shape
    if count < _BOOTSTRAP_EDGES:
        return None
    rng = np.random.default_rng(_BOOTSTRAP_SEED)
    drawn = rng.integers(count, size=(RESAMPLES, count))
    drawn += count * np.arange(RESAMPLES)[:, None]
    copies = np.bincount(drawn.ravel(), minlength=RESAMPLES * count).reshape(RESAMPLES, count)
    # One product of matrices gives both sides of all normal equations.
    products = (design[:, :, None] * design[:, None, :]).reshape(count, -1)
    sides = copies @ (weight[:, None] * np.column_stack([products, squares[:, None] * design]))
    normal = sides[:, : unknowns**2].reshape(RESAMPLES, unknowns, unknowns)
    right = sides[:, unknowns**2 :]
    # A resample that misses one of the directions has no solution: its row is dropped.
    usable = np.linalg.cond(normal) < 1e10
    solved = np.linalg.solve(normal[usable], right[usable][:, :, None])[:, :, 0]
    middle = np.linalg.solve(design.T @ (weight[:, None] * design), design.T @ (weight * squares))
    student = float(stdtrit(count - unknowns, 0.975) / stdtrit(np.inf, 0.975))
    widened = student * sqrt(count / (count - unknowns))
    return np.asarray(middle + (solved - middle) * widened)
