"""From widths across edges at many angles to the covariance of the PSF.

Robust weighted least squares on squared widths that allows for scatter beyond the errors. Serves
every model that is linear in the elements of a covariance: one PSF, or a PSF field.

Across an edge with unit normal n the PSF has the variance ``n' Sigma n``, which is linear in the
three elements of Sigma: weighted least squares on the squared widths gives them all at once (the
paper's medians of vertical and horizontal edges are the special case of two angles).
"""

from dataclasses import dataclass, replace
from math import hypot, sqrt
from typing import Final

import numpy as np
from scipy.special import stdtrit

from calibration.edges import orientation_of
from calibration.estimate import NORMAL_95, Estimate as Estimate
from calibration.psf._repeatability import (
    CaptureFit,
    EdgeSquares,
    SharedByCapture,
    excess_variance,
    fit_by_capture,
    shared_reach_px2,
)
from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, FloatArray

RESAMPLES = 2000
_TUKEY_SIGMAS = 5.0
_ROUNDS = 12
_BOOTSTRAP_EDGES = 12  # with fewer edges there is no resampling: the interval is the normal one
_BOOTSTRAP_SEED = 20190906


@dataclass(frozen=True, slots=True, kw_only=True)
class VarianceFit:
    """Elements of a covariance, from a linear model of squared widths.

    ``replicates`` are solutions of resampled edges, shape ``(resamples, unknowns)``, None for few.
    ``scatter_px`` is the scatter of widths beyond their errors; ``weights`` are robust ones.
    ``by_capture`` is the fit with what captures share, None where that cannot be told.
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

    The design has full rank; edges are resampled for intervals where ``is_resampled``.
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


_MEDIAN_ERR = sqrt(np.pi / 2)  # standard error of a median over that of a mean, Gaussian scatter
_RHO_ERR_MOST = 0.25  # a correlation with a larger error counts as undetermined
_WIDTH_ERR_MOST = 0.25  # relative

USUAL_RHO: Final = 0.1
"""Correlation that a lens may well have where the directions of the edges do not tell it."""


def with_shared(width: Estimate, captures: CaptureFit | None) -> Estimate:
    """Return a width whose error holds what edges of one capture share."""
    if captures is None or captures.shared_err_px2 == 0:
        return width
    value, per_px = width.value, 1 / (2 * width.value)
    err = hypot(width.err, captures.shared_err_px2 * per_px)
    half = hypot(width.half_width, NORMAL_95 * shared_reach_px2(captures) * per_px)
    return Estimate(value=value, err=err, interval_95=(value - half, value + half))


def median_width(sigma_px: FloatArray, sigma_err_px: FloatArray) -> Estimate:
    """Median of widths, with an error from their scatter; a single width keeps its own error."""
    widths = np.asarray(sigma_px, dtype=np.float64)
    if widths.size == 0:
        raise ValueError("a median needs at least one width")
    value = float(np.median(widths))
    err = float(sigma_err_px[0])
    if widths.size > 1:
        scatter = robust_sigma(widths - value)
        err = _MEDIAN_ERR * scatter / sqrt(widths.size)
    return Estimate(value=value, err=err)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PsfEstimates:
    """A PSF's widths, correlation and covariance; None if not determined.

    ``estimate_covariance`` is of ``sigma_x_px``, ``sigma_y_px`` and ``rho``, of those known.
    """

    sigma_x_px: Estimate | None
    sigma_y_px: Estimate | None
    rho: Estimate | None
    covariance_px2: FloatArray | None
    estimate_covariance: FloatArray | None = None


def estimates_of_covariance(
    covariance_px2: FloatArray, element_covariance: FloatArray
) -> PsfEstimates:
    """Return widths and correlation of a covariance, with errors from that of xx, xy and yy."""
    xx, xy, yy = covariance_px2[[0, 0, 1], [0, 1, 1]].tolist()
    slopes = _slopes(xx, xy, yy)
    joint = slopes @ element_covariance @ slopes.T
    x_err, y_err, rho_err = np.sqrt(np.diag(joint)).tolist()
    return PsfEstimates(
        sigma_x_px=Estimate(value=sqrt(xx), err=x_err),
        sigma_y_px=Estimate(value=sqrt(yy), err=y_err),
        rho=_in_range(Estimate(value=xy / sqrt(xx * yy), err=rho_err)),
        covariance_px2=covariance_px2,
        estimate_covariance=joint,
    )


def _slopes(xx: float, xy: float, yy: float) -> FloatArray:
    """Derivatives of both widths and the correlation by the elements xx, xy and yy."""
    rho = xy / sqrt(xx * yy)
    return np.array(
        [
            [0.5 / sqrt(xx), 0.0, 0.0],
            [0.0, 0.0, 0.5 / sqrt(yy)],
            [-0.5 * rho / xx, 1 / sqrt(xx * yy), -0.5 * rho / yy],
        ]
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CovarianceFit(PsfEstimates):
    """The PSF fitted to widths across edges.

    ``scatter_px`` is the scatter of the widths beyond their own errors, and in the errors;
    ``weights`` are robust ones. ``by_capture`` is what captures share, None where that cannot be
    told.
    """

    scatter_px: float
    weights: FloatArray
    by_capture: CaptureFit | None = None

    @property
    def edges_used(self) -> int:
        """Number of edges with a weight above one half."""
        return int(np.count_nonzero(self.weights > 0.5))

    def with_relative(self, error: float) -> "CovarianceFit":
        """Return the fit with a further relative error, which all widths share."""
        if error == 0:
            return self
        x, y = self.sigma_x_px, self.sigma_y_px
        joint = self.estimate_covariance
        if joint is not None:
            widths = [one.value for one in (x, y) if one is not None]
            shared = np.zeros(len(joint))
            shared[: len(widths)] = error * np.array(widths)
            joint = joint + np.outer(shared, shared)
        return replace(
            self,
            sigma_x_px=None if x is None else x.with_relative(error),
            sigma_y_px=None if y is None else y.with_relative(error),
            estimate_covariance=joint,
        )


def fit_covariance(
    angles_deg: FloatArray,
    sigma_px: FloatArray,
    sigma_err_px: FloatArray,
    shared: SharedByCapture | None = None,
) -> CovarianceFit:
    """Fit the PSF covariance to widths across edges.

    Angles are those of the edge lines from +x, with y down; without ``shared`` captures every edge
    is independent. Edges of one orientation determine only that width; vertical and horizontal
    edges together determine both widths but no correlation.
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
    result = _determined_fully(full, sigma, err, shared)
    if result is not None:
        return result
    names = np.array([orientation_of(a) for a in angles.tolist()])
    vertical, horizontal = names == "vertical", names == "horizontal"
    axial = vertical | horizontal
    if vertical.any() and horizontal.any():
        return _axis_aligned(full[:, [0, 2]], (sigma, err), axial, shared)
    weights = np.zeros(angles.size)
    fits: dict[str, Estimate | None] = {"vertical": None, "horizontal": None}
    scatter = 0.0
    by_capture = None
    for name, chosen in (("vertical", vertical), ("horizontal", horizontal)):
        if chosen.any():
            ones = np.ones((int(chosen.sum()), 1))
            fit = fit_variances(ones, sigma[chosen], err[chosen], shared=_some(shared, chosen))
            fits[name] = _width(fit, 0)
            weights[chosen] = fit.weights
            scatter, by_capture = fit.scatter_px, fit.by_capture
    return CovarianceFit(
        sigma_x_px=fits["vertical"],
        sigma_y_px=fits["horizontal"],
        rho=None,
        covariance_px2=None,
        estimate_covariance=independent(fits["vertical"], fits["horizontal"]),
        scatter_px=scatter,
        weights=weights,
        by_capture=by_capture,
    )


def independent(*estimates: Estimate | None) -> FloatArray | None:
    """Covariance of independent estimates, without those that are None."""
    errs = [estimate.err for estimate in estimates if estimate is not None]
    return np.diag(np.square(errs)) if errs else None


def share_of_correlation(angles_deg: FloatArray) -> float:
    """Relative error of a width per unit of a correlation that the edges do not determine.

    Across an edge tilted by a from the vertical the variance is ``cos^2 a xx + sin 2a xy + ...``;
    an unknown xy is taken as 0. The value is the larger of vertical and horizontal edges; edges
    tilted to both sides cancel out.
    """
    normal = np.deg2rad(np.asarray(angles_deg, dtype=np.float64) + 90.0)
    nx, ny = np.cos(normal), np.sin(normal)
    names = np.array([orientation_of(a) for a in np.asarray(angles_deg).tolist()])
    shares = [0.0]
    for name, own in (("vertical", nx), ("horizontal", ny)):
        chosen = names == name
        if chosen.any():
            shares.append(abs(float(np.mean((nx * ny)[chosen]) / np.mean(own[chosen] ** 2))))
    return max(shares)


def _some(shared: SharedByCapture | None, chosen: BoolArray) -> SharedByCapture | None:
    return None if shared is None else shared.some(np.flatnonzero(chosen))


def _estimate(value: float, err: float, replicates: FloatArray | None) -> Estimate:
    if replicates is not None and replicates.size >= RESAMPLES // 2:
        low, high = np.quantile(replicates, [0.025, 0.975])
        return Estimate(value=value, err=err, interval_95=(float(low), float(high)))
    return Estimate(value=value, err=err)


def _width(fit: VarianceFit, index: int) -> Estimate | None:
    """Square root of a variance, with its error; None if the variance is not positive."""
    variance = float(fit.values[index])
    if not variance > 0:
        return None
    value = sqrt(variance)
    variance_err = sqrt(float(fit.covariance[index, index]))
    err = variance_err / (2 * value)
    shared = fit.by_capture if fit.is_by_capture else None
    if shared is not None and shared.holds_scatter:
        # The variance is what is distributed as Student says.
        reach = variance_err * shared.reach(np.eye(fit.values.size)[index])
        low, high = sqrt(max(variance - reach, 0.0)), sqrt(variance + reach)
        return Estimate(value=value, err=err, interval_95=(low, high))
    replicates = None
    if fit.replicates is not None:
        replicates = np.sqrt(np.maximum(fit.replicates[:, index], 0.0))
    return _estimate(value, err, replicates)


def _correlation(fit: VarianceFit, slope: FloatArray) -> Estimate:
    """Correlation with its error; ``slope`` is its derivative by xx, xy and yy."""
    xx, xy, yy = fit.values.tolist()
    value = xy / sqrt(xx * yy)
    err = sqrt(float(slope @ fit.covariance @ slope))
    shared = fit.by_capture if fit.is_by_capture else None
    if shared is not None and shared.holds_scatter:
        reach = err * shared.reach(slope)
        return Estimate(value=value, err=err, interval_95=(value - reach, value + reach))
    replicates = None
    if fit.replicates is not None:
        r = fit.replicates[(fit.replicates[:, 0] > 0) & (fit.replicates[:, 2] > 0)]
        replicates = r[:, 1] / np.sqrt(r[:, 0] * r[:, 2])
    return _estimate(value, err, replicates)


def _in_range(rho: Estimate) -> Estimate:
    """No correlation is beyond -1 and 1, whatever its error."""
    if rho.low >= -1.0 and rho.high <= 1.0:
        return rho
    return replace(rho, interval_95=(max(rho.low, -1.0), min(rho.high, 1.0)))


def _determined_fully(
    design: FloatArray, sigma: FloatArray, err: FloatArray, shared: SharedByCapture | None
) -> CovarianceFit | None:
    if sigma.size < 3 or np.linalg.matrix_rank(design, tol=1e-3) < 3:
        return None
    fit = fit_variances(design, sigma, err, shared=shared)
    xx, xy, yy = fit.values.tolist()
    if not (xx > 0 and yy > 0 and xx * yy > xy * xy):
        return None
    x, y = _width(fit, 0), _width(fit, 2)
    slopes = _slopes(xx, xy, yy)
    joint = slopes @ fit.covariance @ slopes.T
    rho = _correlation(fit, slopes[2])
    if x is None or y is None or max(rho.err, rho.half_width / NORMAL_95) > _RHO_ERR_MOST:
        return None
    if max(x.err / x.value, y.err / y.value) > _WIDTH_ERR_MOST:
        return None
    return CovarianceFit(
        sigma_x_px=x,
        sigma_y_px=y,
        rho=_in_range(rho),
        covariance_px2=np.array([[xx, xy], [xy, yy]]),
        estimate_covariance=joint,
        scatter_px=fit.scatter_px,
        weights=fit.weights,
        by_capture=fit.by_capture,
    )


def _axis_aligned(
    design: FloatArray,
    widths: tuple[FloatArray, FloatArray],
    axial: BoolArray,
    shared: SharedByCapture | None,
) -> CovarianceFit:
    sigma, err = widths
    fit = fit_variances(design[axial], sigma[axial], err[axial], shared=_some(shared, axial))
    weights = np.zeros(sigma.size)
    weights[axial] = fit.weights
    x, y = _width(fit, 0), _width(fit, 1)
    joint = None
    if x is not None and y is not None:
        by_variance = np.array([0.5 / x.value, 0.5 / y.value])
        joint = fit.covariance * np.outer(by_variance, by_variance)
    return CovarianceFit(
        sigma_x_px=x,
        sigma_y_px=y,
        rho=None,
        covariance_px2=None,
        estimate_covariance=independent(x, y) if joint is None else joint,
        scatter_px=fit.scatter_px,
        weights=weights,
        by_capture=fit.by_capture,
    )
