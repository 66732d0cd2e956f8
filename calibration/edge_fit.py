"""PSF width from one edge: maximum likelihood on the raw, unbinned pixels.

Method: Gaussian error function model of the edge (as the paper fits a Gaussian to the line
spread function) without the binning of ISO 12233, which is what biases narrow widths.
"""

from dataclasses import dataclass, replace
from math import exp, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from calibration.edge_model import (
    CURVATURE,
    FLAT_PARAMETERS,
    HIGH,
    LOG_SIGMA,
    LOW,
    OFFSET,
    SHADED_PARAMETERS,
    TURN,
    edge_values,
    levenberg_marquardt,
)
from calibration.edge_residuals import (
    noise_part,
    outlier_weights,
    profile_flags,
    robust_variance,
)
from calibration.edge_segments import EdgeSegment, EdgeWindow, edge_window
from calibration.noise_model import LevelNoise

__all__ = ["EdgeFit", "fit_edge"]

Array = NDArray[np.float64]

SHORTEST_PX = 20.0
NOISIEST_SNR = 3.0
_MAX_STEPS = 40
_WINDOW_ROUNDS = 4
_WINDOW_AGREES = 0.03  # relative change of sigma that needs no new window
_SHADING_P = 1e-3
_SHADING_LEAST = 2e-3  # of the contrast over half an edge: less does not move sigma by 0.01 %
_HETEROSCEDASTIC_P = 1e-3
_MAD_EFFICIENCY = 0.368  # of the variance from the MAD, in Gaussian noise
_SATURATED_FRACTION = 0.005
_SHARPEST_PX = 0.06  # optical widths below this are not told from a perfect lens


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeFit:
    """PSF width across one edge, total and optical, with standard errors.

    ``angle_deg`` in [0, 180) is the direction of the edge line against +x, y down;
    ``curvature_per_px`` its curvature at the middle. ``optical_sigma_px`` is None where the
    edge is as sharp as the pixel square alone. ``chi2_reduced`` is None where the noise is
    known from this edge's residuals only.
    """

    x_px: float
    y_px: float
    angle_deg: float
    length_px: float
    sigma_px: float
    sigma_err_px: float
    optical_sigma_px: float | None
    optical_sigma_err_px: float | None
    low_dn: float
    high_dn: float
    noise_dn: float
    curvature_per_px: float
    chi2_reduced: float | None
    flags: tuple[str, ...]

    @property
    def snr(self) -> float:
        """Contrast of the edge over the noise of one pixel."""
        return abs(self.high_dn - self.low_dn) / self.noise_dn if self.noise_dn > 0 else np.inf

    @property
    def normal_rad(self) -> float:
        """Angle of the edge normal, in radians modulo pi."""
        return float(np.deg2rad(self.angle_deg + 90.0))

    def moved(self, right_px: float, down_px: float) -> "EdgeFit":
        """Return the same fit seen from an image whose origin lies further left and up."""
        return replace(self, x_px=self.x_px + right_px, y_px=self.y_px + down_px)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Solution:
    parameters: Array
    variances: Array
    squares: float
    levels: Array
    distances: Array
    edges: Array


def fit_edge(
    image_dn: Array,
    segment: EdgeSegment,
    *,
    noise: LevelNoise | None = None,
    saturation_dn: float | None = None,
) -> EdgeFit | None:
    """Fit total and optical PSF width to the pixels around one edge.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``, float64, linear in light.
    segment
        Where the edge is, to within about a pixel and a few degrees.
    noise
        Noise of one pixel of ``image_dn``; without it, it is estimated from the residuals.
    saturation_dn
        Pixels at or above 99.5 % of it, or at 0, count as saturated.

    Returns
    -------
    EdgeFit or None
        None where no edge model fits: no contrast, too few pixels or no convergence.
    """
    settled = _settled_window(image_dn, segment, noise)
    if settled is None:
        return None
    fit, plain = settled
    return _finish(fit, plain, segment, noise, saturation_dn)


def _settled_window(
    image_dn: Array, segment: EdgeSegment, noise: LevelNoise | None
) -> tuple["_FitProblem", "_Solution"] | None:
    """Fit, and widen or narrow the band until it suits the width that is found in it."""
    sigma = segment.sigma_px
    start: Array | None = None
    settled = None
    for _ in range(_WINDOW_ROUNDS):
        window = edge_window(image_dn, segment, sigma)
        if window.values.size < 4 * SHADED_PARAMETERS:
            return None
        fit = _FitProblem(window, noise)
        plain = fit.solve(_start(window, sigma) if start is None else start, is_square=False)
        if plain is None or plain.parameters[HIGH] <= plain.parameters[LOW]:
            return None
        settled = fit, plain
        start = plain.parameters
        fitted_sigma = exp(start[LOG_SIGMA])
        if abs(fitted_sigma - sigma) <= _WINDOW_AGREES * sigma or window.is_clipped:
            break
        sigma = fitted_sigma
    return settled


class _FitProblem:
    """The pixels of one window with their weights."""

    def __init__(self, window: EdgeWindow, noise: LevelNoise | None) -> None:
        self.window = window
        self.weights = np.ones(window.values.size)
        if noise is not None:
            self.weights = 1.0 / noise.variance_dn2(window.smooth_levels)

    def solve(self, start: Array, *, is_square: bool) -> _Solution | None:
        w = self.window
        parameters, hessian, squares, steps = levenberg_marquardt(
            w.x,
            w.y,
            w.values,
            self.weights,
            start,
            w.normal_rad,
            w.half_length_px,
            is_square,
            _MAX_STEPS,
        )
        if steps < 0 or not np.all(np.isfinite(parameters)):
            return None
        try:
            variances = np.diag(np.linalg.inv(hessian)).copy()
        except np.linalg.LinAlgError:
            return None
        levels, distances, edges = edge_values(
            w.x, w.y, parameters, w.normal_rad, w.half_length_px, is_square
        )
        return _Solution(
            parameters=parameters,
            variances=variances,
            squares=squares,
            levels=levels,
            distances=distances,
            edges=edges,
        )

    @property
    def degrees_of_freedom(self) -> int:
        return int(np.count_nonzero(self.weights)) - FLAT_PARAMETERS


def _start(window: EdgeWindow, sigma_px: float) -> Array:
    parameters = np.zeros(FLAT_PARAMETERS)
    parameters[LOG_SIGMA] = np.log(max(sigma_px, 0.2))
    parameters[LOW], parameters[HIGH] = window.side_levels
    return parameters


def _finish(
    fit: _FitProblem,
    plain: _Solution,
    segment: EdgeSegment,
    noise: LevelNoise | None,
    saturation_dn: float | None,
) -> EdgeFit | None:
    """Weights, shading and the optical width, once the window is settled."""
    window = fit.window
    scatter = noise_part(window.values - plain.levels, plain.distances)
    reweighted = False
    if noise is None:
        side_weights = _weights_of_sides(scatter, plain)
        if side_weights is not None:
            fit.weights = side_weights
            reweighted = True
    outliers = outlier_weights(scatter, 1.0 / np.sqrt(fit.weights), _contrast(plain))
    if outliers is not None:
        fit.weights = fit.weights * outliers
        reweighted = True
    if reweighted:
        again = fit.solve(plain.parameters, is_square=False)
        if again is None:
            return None
        plain = again
    square = fit.solve(_square_start(plain.parameters), is_square=True)
    shaded = _shaded(fit, plain, square)
    if shaded is not None:
        plain, square = shaded
    return _measurement(fit, plain, square, segment, noise, saturation_dn, outliers)


def _contrast(solution: _Solution) -> float:
    return float(abs(solution.parameters[HIGH] - solution.parameters[LOW]))


def _square_start(parameters: Array) -> Array:
    start = parameters.copy()
    total = exp(start[LOG_SIGMA])
    start[LOG_SIGMA] = np.log(sqrt(max(total**2 - 1 / 12, 0.02)))
    return start


def _weights_of_sides(scatter: Array, plain: _Solution) -> Array | None:
    """Inverse variances where one side of the edge is noisier than the other, else None."""
    sides = (plain.edges < 0.02, plain.edges > 0.98)
    counts = [int(np.count_nonzero(side)) for side in sides]
    if min(counts) < 30:
        return None
    low, high = (robust_variance(scatter[side]) for side in sides)
    if min(low, high) <= 1e-12 * max(low, high):
        return None
    freedom = [_MAD_EFFICIENCY * count for count in counts]
    p = float(
        stats.f.sf(max(low, high) / min(low, high), freedom[high > low], freedom[high <= low])
    )
    if p > _HETEROSCEDASTIC_P:
        return None
    variance = low + (high - low) * plain.edges
    return np.asarray(np.sqrt(low * high) / variance)


def _shaded(
    fit: _FitProblem, plain: _Solution, square: _Solution | None
) -> tuple[_Solution, _Solution | None] | None:
    """Both fits with a linear slope on either side, where an F-test asks for it."""
    use_square = square is not None and square.squares < plain.squares
    flat = square if use_square and square is not None else plain
    start = np.concatenate([flat.parameters, np.zeros(SHADED_PARAMETERS - FLAT_PARAMETERS)])
    trial = fit.solve(start, is_square=use_square)
    if trial is None:
        return None
    extra = SHADED_PARAMETERS - FLAT_PARAMETERS
    freedom = fit.degrees_of_freedom - extra
    if not (freedom > 0 and trial.squares > 0):
        return None
    f_value = (flat.squares - trial.squares) / extra / (trial.squares / freedom)
    slopes = np.abs(trial.parameters[FLAT_PARAMETERS:]).max() / _contrast(trial)
    if stats.f.sf(f_value, extra, freedom) > _SHADING_P or slopes < _SHADING_LEAST:
        return None
    slope_values = trial.parameters[FLAT_PARAMETERS:]
    shaded_plain = fit.solve(np.concatenate([plain.parameters, slope_values]), is_square=False)
    if shaded_plain is None:
        return None
    shaded_square = None
    if square is not None:
        shaded_square = fit.solve(np.concatenate([square.parameters, slope_values]), is_square=True)
    return shaded_plain, shaded_square


def _measurement(
    fit: _FitProblem,
    plain: _Solution,
    square: _Solution | None,
    segment: EdgeSegment,
    noise: LevelNoise | None,
    saturation_dn: float | None,
    outliers: Array | None,
) -> EdgeFit:
    window = fit.window
    freedom = max(fit.degrees_of_freedom, 1)
    better = square if square is not None and square.squares < plain.squares else plain
    residuals = (window.values - better.levels)[fit.weights > 0]
    noise_dn = float(np.std(residuals))
    sigma, sigma_err = _width(plain, plain.squares / freedom)
    optical: float | None = None
    optical_err: float | None = None
    if square is not None:
        optical, optical_err = _width(square, square.squares / freedom)
        if optical < _SHARPEST_PX:
            optical = optical_err = None
    angle = window.normal_rad + plain.parameters[TURN] / window.half_length_px
    offset = plain.parameters[OFFSET]
    flags = list(
        profile_flags(
            values=window.values[fit.weights > 0],
            residuals=residuals,
            distances=better.distances[fit.weights > 0],
            sigma_px=sigma,
            contrast=_contrast(better),
        )
    )
    if saturation_dn is not None:
        clipped = (window.values >= 0.995 * saturation_dn) | (window.values <= 0)
        if np.mean(clipped) > _SATURATED_FRACTION:
            flags.insert(0, "saturated")
    if segment.length_px < SHORTEST_PX:
        flags.append("too_short")
    if _contrast(better) < NOISIEST_SNR * noise_dn:
        flags.append("too_noisy")
    if outliers is not None:
        flags.append("outliers")
    if plain.parameters.size == SHADED_PARAMETERS:
        flags.append("shaded")
    return EdgeFit(
        x_px=float(window.centre_x_px + offset * np.cos(angle)),
        y_px=float(window.centre_y_px + offset * np.sin(angle)),
        angle_deg=float(np.rad2deg(angle) + 90.0) % 180.0,
        length_px=segment.length_px,
        sigma_px=sigma,
        sigma_err_px=sigma_err,
        optical_sigma_px=optical,
        optical_sigma_err_px=optical_err,
        low_dn=float(plain.parameters[LOW]),
        high_dn=float(plain.parameters[HIGH]),
        noise_dn=noise_dn,
        curvature_per_px=float(2 * plain.parameters[CURVATURE] / window.half_length_px**2),
        chi2_reduced=better.squares / freedom if noise is not None else None,
        flags=tuple(flags),
    )


def _width(solution: _Solution, residual_variance: float) -> tuple[float, float]:
    sigma = exp(solution.parameters[LOG_SIGMA])
    return sigma, sigma * sqrt(max(solution.variances[LOG_SIGMA], 0.0) * residual_variance)
