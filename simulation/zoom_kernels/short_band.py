"""Long rows of weights, fitted by short ones: what lies far off is given to the pixels nearby.

The tails of a blur made from its transfer function alternate from pixel to pixel, where an image
seen through a lens has next to nothing. The short row is the one whose result differs least from
the long row's, on average over images seen through that lens.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import toeplitz

from simulation.arrays import FloatArray, IntArray
from simulation.resampling import BandedMatrix

_SCENE_CORRELATION_PX = 30.0
_STEPS_PER_CYCLE = 512
_ALIASES = 3

_NOISE = 1e-6
"""White noise that is reckoned with, relative to the image's variance."""

_TOLERANCE = 2e-8
"""Largest variance of the difference, relative to the image's: 0.008 DN rms of 60 ..."""

_TOLERANCE_OF_ALIASES = 2e-3
"""... or this part of what the pixels fold below Nyquist, which no model gets right."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageCovariance:
    """Covariance of the pixels along one axis of an image.

    Parameters
    ----------
    values
        By the distance in px from 0 up: 1 at distance 0, and the noise on it.
    tolerance
        Variance that next to nobody would miss.
    """

    values: FloatArray
    tolerance: float

    @classmethod
    def seen_through(cls, transfer: Callable[[FloatArray], FloatArray]) -> "ImageCovariance":
        """Covariance of a first-order scene seen through a transfer function."""
        count = _STEPS_PER_CYCLE
        freq = np.arange(-_ALIASES * count, _ALIASES * count) / count
        angular = 2 * np.pi * _SCENE_CORRELATION_PX * freq
        power = np.abs(transfer(freq)) ** 2 / (1 + angular**2)
        total = float(power.sum())
        aliased = 1 - float(power[np.abs(freq) <= 0.5].sum()) / total
        values = np.fft.fft(power.reshape(-1, count).sum(axis=0)).real[: count // 2] / total
        values[0] += _NOISE
        return cls(np.asarray(values), max(_TOLERANCE, _TOLERANCE_OF_ALIASES * aliased))


def shortened(
    matrix: BandedMatrix, positions_px: FloatArray, taps: int, covariance: ImageCovariance
) -> BandedMatrix:
    """Fit every row of a matrix by ``taps`` weights around its position.

    The response to a constant and to a ramp stays the same.

    Parameters
    ----------
    matrix
        Rows of weights.
    positions_px
        Column at which each row stands, shape ``(matrix.rows,)``.
    taps
        Weights of the new rows.
    covariance
        Of the columns' pixels.
    """
    if taps >= matrix.weights.shape[1]:
        return matrix
    starts, weights, _ = _fitted(matrix, positions_px, taps, covariance)
    return BandedMatrix(starts, weights, matrix.columns)


def largest_variance(matrix: BandedMatrix, covariance: ImageCovariance) -> float:
    """Largest variance of what a row of a matrix makes of an image of variance 1."""
    return float(_variances(matrix, covariance).max())


def taps_needed(
    matrix: BandedMatrix, positions_px: FloatArray, covariance: ImageCovariance, share: float
) -> int:
    """Smallest even number of weights that changes the images of a camera by next to nothing.

    ``share`` of the difference counts: the other axis leaves that much of an image's variance.
    """
    band = matrix.weights.shape[1]
    for taps in range(6, band, 2):
        if (
            float(_fitted(matrix, positions_px, taps, covariance)[2].max()) * share
            <= covariance.tolerance
        ):
            return taps
    return int(band)


def _fitted(
    matrix: BandedMatrix, positions_px: FloatArray, taps: int, covariance: ImageCovariance
) -> tuple[IntArray, FloatArray, FloatArray]:
    """First columns, weights, and the variance of the difference, row by row."""
    band = matrix.weights.shape[1]
    first = np.floor(positions_px - taps / 2).astype(np.int64) + 1
    starts = np.clip(first, 0, matrix.columns - taps)
    column = matrix.starts[:, None] + np.arange(band)
    near = starts[:, None] + np.arange(taps)
    wanted = np.einsum(
        "rnb,rb->rn",
        covariance.values[np.abs(near[:, :, None] - column[:, None, :])],
        matrix.weights,
    )
    system = toeplitz(covariance.values[:taps])
    place = np.arange(taps) - (taps - 1) / 2
    drift = np.stack([np.ones(taps), place])
    far_place = column - starts[:, None] - (taps - 1) / 2
    moments = np.stack([matrix.weights.sum(axis=1), (matrix.weights * far_place).sum(axis=1)])
    solved = np.linalg.solve(system, np.concatenate([wanted, drift]).T).T
    bare, drifts = solved[:-2], solved[-2:]
    factors = np.linalg.solve(drift @ drifts.T, moments - drift @ bare.T)
    weights = bare + factors.T @ drifts
    after = np.einsum("ra,ab,rb->r", weights, system, weights)
    error = _variances(matrix, covariance) - 2 * np.einsum("rn,rn->r", weights, wanted) + after
    return starts, weights, error


def _variances(matrix: BandedMatrix, covariance: ImageCovariance) -> FloatArray:
    system = toeplitz(covariance.values[: matrix.weights.shape[1]])
    return np.asarray(np.einsum("ra,ab,rb->r", matrix.weights, system, matrix.weights))
