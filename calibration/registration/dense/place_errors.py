"""Standard errors of a refined pose, by what its residuals scatter from block to block."""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from calibration.registration.dense.level_pair import LevelPair
from calibration.registration.dense.motions import PoseMotions
from calibration.registration.dense.refinement import Residuals
from simulation.arrays import FloatArray

_SHOWN_SAMPLES = 4000
_LEAST_SLOPE = 0.3
"""Of the scores, relative to the normal equations': less is scatter, not an absence of detail."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceErrors:
    """Standard errors: of a position in the source, rms over the overlap, and of the distortion."""

    place_err_px: float
    k1_err: float


def place_errors(pair: LevelPair, motions: PoseMotions, found: Residuals) -> PlaceErrors:
    """Standard errors of a pose of least cost."""
    covariance = _covariance(pair, motions, found)
    chosen = np.flatnonzero(found.inside)
    chosen = chosen[:: max(len(chosen) // _SHOWN_SAMPLES, 1)]
    variance = sum(
        float(np.mean(np.sum((along[chosen] @ covariance) * along[chosen], axis=1)))
        for along in motions.flows(found.pose)
    )
    return PlaceErrors(
        place_err_px=found.pose.zoom * sqrt(max(variance, 0.0)),
        k1_err=sqrt(max(covariance[-1, -1], 0.0)) if motions.fits_distortion else 0.0,
    )


def _covariance(pair: LevelPair, motions: PoseMotions, found: Residuals) -> FloatArray:
    """Covariance of the parameters, by the sandwich formula with sums over blocks.

    The two photographs' noise is independent: the derivative of the scores is the product of the
    one's slopes with the other's, into which no noise enters.

    References
    ----------
    H. White, "A heteroskedasticity-consistent covariance matrix estimator and a direct test for
    heteroskedasticity", 1980; with blocks as clusters.
    """
    inside = found.inside
    along_x, along_y = (along[inside] for along in motions.flows(found.pose))
    count = along_x.shape[1]
    light = found.light_columns[inside]
    seen_x, seen_y = (
        slope[inside, None] for slope in pair.predicted_slopes(found.pose, found.light[0])
    )
    own = np.concatenate(
        [
            pair.slope_x[inside, None] * along_x + pair.slope_y[inside, None] * along_y,
            light,
        ],
        axis=1,
    )
    other = np.concatenate([seen_x * along_x + seen_y * along_y, light], axis=1)
    square = np.minimum(found.relative[inside] ** 2, 1.0)
    rising = (1 - square) * (1 - 5 * square) / found.scale[inside] ** 2
    slope = (own * rising[:, None]).T @ other
    slope = (slope + slope.T) / 2
    normal = (own * found.weight[inside, None]).T @ own
    for one in (slope, normal):
        one[:count, :count] += motions.prior(found.pose).normal
    scores = own * (found.weight * found.residual)[inside, None]
    block = pair.block[inside]
    sums = np.stack([np.bincount(block, one) for one in scores.T], axis=1)
    used = max(int(np.count_nonzero(np.bincount(block))), 2)
    inverse = _bounded_inverse(slope, normal)
    made = inverse @ (sums.T @ sums) @ inverse * (used / (used - 1))
    return np.asarray(made[:count, :count])


def _bounded_inverse(slope: FloatArray, normal: FloatArray) -> FloatArray:
    """Inverse of ``slope``, in no direction more than some times that of ``normal``."""
    known = np.diag(normal)
    # What no detail tells, such as a shift along stripes, is uncertain beyond any use.
    scale = 1 / np.sqrt(np.maximum(known, 1e-20 * known.max() + 1e-300))
    root = np.linalg.cholesky(normal * np.outer(scale, scale) + 1e-9 * np.eye(len(normal)))
    whiten = np.linalg.inv(root) * scale
    values, vectors = np.linalg.eigh(whiten @ slope @ whiten.T)
    half = (vectors / np.sqrt(np.maximum(values, _LEAST_SLOPE))).T @ whiten
    return np.asarray(half.T @ half)
