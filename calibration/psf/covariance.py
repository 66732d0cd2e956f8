"""From widths across edges at many angles to the covariance of the PSF.

Across an edge with unit normal n the PSF has the variance ``n' Sigma n``, which is linear in the
three elements of Sigma: weighted least squares on the squared widths gives them all at once
(the paper's medians of vertical and horizontal edges are the special case of two angles).
"""

from dataclasses import dataclass, replace
from math import hypot, sqrt
from typing import Final

import numpy as np

from calibration.edges import orientation_of
from calibration.psf.repeatability import CaptureFit, SharedByCapture, shared_reach_px2
from calibration.psf.variance import RESAMPLES, VarianceFit, fit_variances
from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, FloatArray

_NORMAL_95 = 1.959963984540054
_MEDIAN_ERR = sqrt(np.pi / 2)  # standard error of a median over that of a mean, Gaussian scatter
_RHO_ERR_MOST = 0.25  # a correlation with a larger error counts as undetermined
_WIDTH_ERR_MOST = 0.25  # relative

USUAL_RHO: Final = 0.1
"""Correlation that a lens may well have where the directions of the edges do not tell it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A value, its standard error and its 95 % interval."""

    value: float
    err: float
    low: float
    high: float

    @classmethod
    def normal(cls, value: float, err: float) -> "Estimate":
        """Return an estimate with the interval of a normal distribution."""
        reach = _NORMAL_95 * err
        return cls(value=value, err=err, low=value - reach, high=value + reach)

    @property
    def half_width(self) -> float:
        """Half of the 95 % interval."""
        return 0.5 * (self.high - self.low)

    def with_shared(self, captures: CaptureFit | None) -> "Estimate":
        """Return a width whose error holds what edges of one capture share."""
        if captures is None or captures.shared_err_px2 == 0:
            return self
        per_px = 1 / (2 * self.value)
        err = hypot(self.err, captures.shared_err_px2 * per_px)
        half = hypot(self.half_width, _NORMAL_95 * shared_reach_px2(captures) * per_px)
        return Estimate(value=self.value, err=err, low=self.value - half, high=self.value + half)

    def with_relative(self, error: float) -> "Estimate":
        """Return the estimate with a further, independent relative error."""
        if error == 0:
            return self
        more = error * self.value
        below = hypot(self.value - self.low, _NORMAL_95 * more)
        above = hypot(self.high - self.value, _NORMAL_95 * more)
        return Estimate(
            value=self.value,
            err=hypot(self.err, more),
            low=self.value - below,
            high=self.value + above,
        )

    def __str__(self) -> str:
        return f"{self.value:.4f} ± {self.err:.4f}"


def median_width(sigma_px: FloatArray, sigma_err_px: FloatArray) -> Estimate:
    """Median of widths, with an error from their scatter; a single width keeps its own error.

    Raises
    ------
    ValueError
        If there is no width.
    """
    widths = np.asarray(sigma_px, dtype=np.float64)
    if widths.size == 0:
        raise ValueError("a median needs at least one width")
    value = float(np.median(widths))
    err = float(sigma_err_px[0])
    if widths.size > 1:
        scatter = robust_sigma(widths - value)
        err = _MEDIAN_ERR * scatter / sqrt(widths.size)
    return Estimate.normal(value, err)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PsfEstimates:
    """A PSF's widths, correlation and covariance; None if not determined.

    ``estimate_covariance`` is that of the errors of ``sigma_x_px``, ``sigma_y_px`` and ``rho``, in
    this order, without those that are None.
    """

    sigma_x_px: Estimate | None
    sigma_y_px: Estimate | None
    rho: Estimate | None
    covariance_px2: FloatArray | None
    estimate_covariance: FloatArray | None = None


def estimates_of_covariance(
    covariance_px2: FloatArray, element_covariance: FloatArray
) -> PsfEstimates:
    """Return the widths and the correlation of a covariance, with their errors.

    Parameters
    ----------
    covariance_px2
        Shape ``(2, 2)``, positive definite.
    element_covariance
        Covariance matrix of its elements xx, xy and yy; shape ``(3, 3)``.
    """
    xx, xy, yy = covariance_px2[[0, 0, 1], [0, 1, 1]].tolist()
    slopes = _slopes(xx, xy, yy)
    joint = slopes @ element_covariance @ slopes.T
    x_err, y_err, rho_err = np.sqrt(np.diag(joint)).tolist()
    return PsfEstimates(
        sigma_x_px=Estimate.normal(sqrt(xx), x_err),
        sigma_y_px=Estimate.normal(sqrt(yy), y_err),
        rho=Estimate.normal(xy / sqrt(xx * yy), rho_err),
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

    ``scatter_px`` is the scatter of the widths beyond their own errors (field, focus, paper);
    the errors include it. ``weights``, in [0, 1], are the robust weights of the edges.
    ``by_capture`` is what the captures of the edges share, None where that cannot be told.
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

    Parameters
    ----------
    angles_deg
        Angle of each edge line from +x, with y down; shape ``(n,)``.
    sigma_px, sigma_err_px
        Width across each edge and its standard error, in px; shape ``(n,)``.
    shared
        The captures of the edges; None if each edge is independent of the others.

    Returns
    -------
    CovarianceFit
        Edges of one orientation determine only that width; vertical and horizontal edges together
        determine both widths but no correlation.

    Raises
    ------
    ValueError
        If there are no edges, or a width or error is not positive.
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
    an unknown xy is taken as 0. If the widths are about equal, a width is then off by ``rho`` times
    the value returned, the larger of those of vertical and horizontal edges. Edges tilted to both
    sides cancel out.
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
        return Estimate(value=value, err=err, low=float(low), high=float(high))
    return Estimate.normal(value, err)


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
        return Estimate(value=value, err=err, low=low, high=high)
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
        return Estimate(value=value, err=err, low=value - reach, high=value + reach)
    replicates = None
    if fit.replicates is not None:
        r = fit.replicates[(fit.replicates[:, 0] > 0) & (fit.replicates[:, 2] > 0)]
        replicates = r[:, 1] / np.sqrt(r[:, 0] * r[:, 2])
    return _estimate(value, err, replicates)


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
    if x is None or y is None or max(rho.err, rho.half_width / _NORMAL_95) > _RHO_ERR_MOST:
        return None
    if max(x.err / x.value, y.err / y.value) > _WIDTH_ERR_MOST:
        return None
    return CovarianceFit(
        sigma_x_px=x,
        sigma_y_px=y,
        rho=rho,
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
