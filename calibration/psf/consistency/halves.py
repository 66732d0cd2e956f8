"""Calibrate on half of the edges, predict the other half."""

from collections.abc import Hashable, Sequence

import numpy as np
from scipy.special import chdtrc

from calibration.edges import EdgeMeasurement
from calibration.psf.consistency.document import HalvesCheck
from calibration.psf.consistency.softness import direction_columns
from calibration.psf.repeatability import capture_of
from simulation.arrays import BoolArray, FloatArray

_LEAST_ERR_PX = 1e-9


def check_edges(edges: Sequence[EdgeMeasurement]) -> HalvesCheck | None:
    """Predict every other edge of a capture from the rest; None where they do not determine it."""
    seen: dict[tuple[Hashable, str], int] = {}
    first = []
    for edge in edges:
        key = (capture_of(edge), edge.orientation)
        seen[key] = seen.get(key, len(seen)) + 1
        first.append(seen[key] % 2 == 0)
    return _check(edges, np.array(first, dtype=np.bool_))


def check_heights(edges: Sequence[EdgeMeasurement]) -> HalvesCheck | None:
    """Predict the edges of the further captures from those of the nearer ones."""
    keys = [capture_of(edge) for edge in edges]
    height = {key: edge.height_mm for key, edge in zip(keys, edges, strict=True)}
    names = list(height)
    known = {value for value in height.values() if value is not None}
    if len(known) > 1 and None not in height.values():
        middle = float(np.median(sorted(known)))
        first = [(height[key] or 0.0) < middle for key in keys]
    elif len(names) > 1:
        first = [names.index(key) % 2 == 0 for key in keys]
    else:
        return None
    return _check(edges, np.array(first, dtype=np.bool_))


def _check(edges: Sequence[EdgeMeasurement], first: BoolArray) -> HalvesCheck | None:
    design = direction_columns(edges)
    if min(np.count_nonzero(first), np.count_nonzero(~first)) < design.shape[1]:
        return None
    for half in (design[first], design[~first]):
        if np.linalg.matrix_rank(half, tol=1e-3) < design.shape[1]:
            return None
    sigma = np.array([edge.sigma_px for edge in edges])
    err = np.maximum([edge.sigma_err_px for edge in edges], _LEAST_ERR_PX)
    spread2 = (2 * sigma * err) ** 2
    values, covariance = _solved(design[first], sigma[first] ** 2, spread2[first])
    left = sigma[~first] ** 2 - design[~first] @ values
    # Edges that are predicted together share the errors of the prediction.
    whole = np.diag(spread2[~first]) + design[~first] @ covariance @ design[~first].T
    chi2 = float(left @ np.linalg.solve(whole, left))
    return HalvesCheck(
        chi2_reduced=chi2 / left.size, freedom=left.size, p_value=float(chdtrc(left.size, chi2))
    )


def _solved(
    design: FloatArray, squares: FloatArray, spread2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    weighted = design / spread2[:, None]
    covariance = np.linalg.inv(design.T @ weighted)
    return np.asarray(covariance @ (weighted.T @ squares)), np.asarray(covariance)
