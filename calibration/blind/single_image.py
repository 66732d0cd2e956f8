"""The PSF from the edges in one photograph of an ordinary scene.

Luxen and Förstner, Characterizing image quality: blind estimation of the point spread function from
a single image, PCV 2002: wherever the scene has a sharp edge, the width of its image is that of the
PSF across it, and widths in many directions give the covariance. The edges of an ordinary scene are
not all sharp. Where the paper takes a robust mean, the softness of the scene is modelled here: an
edge's variance is ``n' Sigma n`` plus an exponentially distributed softness plus the error of its
fit (an exponentially modified Gaussian), and some edges are outliers; maximum likelihood finds
Sigma and the mean softness together.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import exp, log, pi, sqrt, tanh

import numpy as np
from scipy.optimize import minimize
from scipy.special import erfcx, log_ndtr

from calibration.edges import EdgeMeasurement
from simulation.arrays import FloatArray

FEWEST_EDGES = 12
"""Edges needed for the three elements of Sigma and the softness, with a few to spare."""

_OUTLIERS = 0.05  # fraction of edges that are not steps at all
_REACH = 3.0  # of the search, in logarithms of widths and their ratio
_OUTLIER_SPREAD_PX2 = 1.0
_LEAST_ERR_PX2 = 0.01  # of an edge's variance: its own error does not include texture beside it
_STEP = 1e-3
_RATIO_SPREAD = 0.15  # lenses blur x and y about equally: prior of log(sigma_x / sigma_y)
_TILT_SPREAD = 0.2  # prior of atanh(rho)
_WIDEST_ERR = 0.5  # relative to the width: edges with larger errors are ignored
_CLEAREST_SNR = 9.0


def is_clear(edge: EdgeMeasurement) -> bool:
    """Whether an edge in a scene stands out from the scatter on either side of it."""
    return edge.snr is None or edge.snr >= _CLEAREST_SNR


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SharpestWidths:
    """Covariance of the PSF, px^2, on which the sharpest edges agree.

    ``covariance_err_px2``, shape (3, 3), is the covariance matrix of the elements (xx, xy, yy),
    ``softness_px2`` the mean variance that the scene adds, ``edges_used`` the number of edges used.
    """

    covariance_px2: FloatArray
    covariance_err_px2: FloatArray
    softness_px2: float
    edges_used: int


def fit_sharpest_widths(
    angles_deg: FloatArray, sigma_px: FloatArray, sigma_err_px: FloatArray
) -> SharpestWidths:
    """Fit the PSF to widths of edges, some of which are soft in the scene itself.

    Parameters
    ----------
    angles_deg
        Angle of each edge line from +x, with y down; shape ``(n,)``.
    sigma_px, sigma_err_px
        Width across each edge and its standard error, px.

    Raises
    ------
    ValueError
        If fewer than 12 edges have an error below half of their width.
    """
    sure = sigma_err_px < _WIDEST_ERR * sigma_px
    if np.count_nonzero(sure) < FEWEST_EDGES:
        raise ValueError(
            f"only {np.count_nonzero(sure)} edges are sharp and clear enough, "
            f"{FEWEST_EDGES} are needed"
        )
    normal = np.deg2rad(angles_deg[sure] + 90.0)
    nx, ny = np.cos(normal), np.sin(normal)
    variance = sigma_px[sure] ** 2
    err = np.hypot(2 * sigma_px[sure] * sigma_err_px[sure], _LEAST_ERR_PX2)

    def cost(parameters: FloatArray) -> float:
        xx, xy, yy = _covariance(parameters)
        expected = nx**2 * xx + 2 * nx * ny * xy + ny**2 * yy
        likely = _log_modified_gaussian(variance - expected, err, float(np.exp(parameters[3])))
        spread = np.hypot(err, _OUTLIER_SPREAD_PX2)
        outlying = -0.5 * ((variance - expected) / spread) ** 2 - np.log(sqrt(2 * pi) * spread)
        joint = np.logaddexp(log(1 - _OUTLIERS) + likely, log(_OUTLIERS) + outlying)
        unequal, tilted = parameters[1] / _RATIO_SPREAD, parameters[2] / _TILT_SPREAD
        return -float(joint.sum()) + 0.5 * float(unequal**2 + tilted**2)

    width = sqrt(float(np.quantile(variance, 0.25)))
    middle = log(width)
    bounds = [
        (middle - _REACH, middle + _REACH),
        (-_REACH, _REACH),
        (-_REACH, _REACH),
        (2 * middle - 3 * _REACH, 2 * middle + _REACH),
    ]
    best = None
    for start_width, softness in ((width, 0.3), (0.8 * width, 1.0), (1.2 * width, 0.1)):
        start = np.array([log(start_width), 0.0, 0.0, log(softness * width**2)])
        found = minimize(
            cost, start, method="Nelder-Mead", bounds=bounds, options={"maxiter": 2000}
        )
        if best is None or found.fun < best.fun:
            best = found
    assert best is not None
    xx, xy, yy = _covariance(best.x)
    hessian = _hessian(cost, best.x)
    slopes = np.array([
        (np.array(_covariance(best.x + step)) - np.array(_covariance(best.x - step))) / (2 * _STEP)
        for step in _STEP * np.eye(4)
    ]).T  # fmt: skip
    errors = slopes @ np.linalg.pinv(hessian, hermitian=True) @ slopes.T
    return SharpestWidths(
        covariance_px2=np.array([[xx, xy], [xy, yy]]),
        covariance_err_px2=errors,
        softness_px2=float(np.exp(best.x[3])),
        edges_used=int(np.count_nonzero(sure)),
    )


def _covariance(parameters: FloatArray) -> tuple[float, float, float]:
    """Elements xx, xy, yy from the log mean width, the log ratio of the widths and atanh(rho)."""
    mean, ratio, tilt = (float(value) for value in parameters[:3])
    x, y = exp(mean + ratio / 2), exp(mean - ratio / 2)
    return x * x, tanh(tilt) * x * y, y * y


def _log_modified_gaussian(left: FloatArray, err: FloatArray, mean: float) -> FloatArray:
    """Log density of a Gaussian error plus an exponential variable with this mean.

    Far above the error the tail is exponential; elsewhere the form with erfcx neither overflows
    nor cancels, however small the mean is.
    """
    ratio, scaled = err / mean, left / err
    below = (ratio - scaled) / sqrt(2)
    tail = 0.5 * np.square(np.minimum(ratio, scaled)) - left / mean + log_ndtr(scaled - ratio)
    near = -0.5 * scaled**2 + np.log(erfcx(np.maximum(below, 0.0)) / 2)
    return np.asarray(np.where(below < 0, tail, near) - log(mean), dtype=np.float64)


def _hessian(cost: Callable[[FloatArray], float], point: FloatArray) -> FloatArray:
    steps = _STEP * np.eye(len(point))
    return np.array([
        [
            (cost(point + a + b) - cost(point + a - b) - cost(point - a + b) + cost(point - a - b))
            / (4 * _STEP**2)
            for b in steps
        ]
        for a in steps
    ])  # fmt: skip
