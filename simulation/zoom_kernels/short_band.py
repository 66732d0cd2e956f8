"""Long rows of weights, fitted by short ones: what lies far off is given to the pixels nearby.

The tails of a blur made from its transfer function alternate from pixel to pixel, where an image
seen through a lens has next to nothing. The short row is the one whose result differs least from
the long row's, on average over images seen through that lens.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import toeplitz

from simulation.arrays import FloatArray

_SCENE_CORRELATION_PX = 30.0
_STEPS_PER_CYCLE = 512  # at least
_ALIASES = 3

_NOISE = 1e-6
"""White noise that is reckoned with, relative to the image's variance."""

_TAPS_MIN = 6
"""As many pixels as a quintic spline has between its knots."""

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
    def seen_through(
        cls, transfer: Callable[[FloatArray], FloatArray], lags: int, noise_ratio: float = 0.0
    ) -> "ImageCovariance":
        """Covariance of a first-order scene seen through a transfer function, and of its noise."""
        count = max(_STEPS_PER_CYCLE, 2 * lags)
        freq = np.arange(-_ALIASES * count, _ALIASES * count) / count
        angular = 2 * np.pi * _SCENE_CORRELATION_PX * freq
        power = np.abs(transfer(freq)) ** 2 / (1 + angular**2)
        total = float(power.sum())
        aliased = 1 - float(power[np.abs(freq) <= 0.5].sum()) / total
        values = np.fft.fft(power.reshape(-1, count).sum(axis=0)).real[: count // 2] / total
        values[0] += max(_NOISE, noise_ratio)
        return cls(np.asarray(values), max(_TOLERANCE, _TOLERANCE_OF_ALIASES * aliased))


def shortest(
    rows: FloatArray, covariance: ImageCovariance, share: float, *, keeps_ramp: bool = True
) -> FloatArray:
    """Fit rows by the fewest weights that change the images of a camera by next to nothing.

    The response to a constant stays the same.

    Parameters
    ----------
    rows
        Weights over the same columns, shape ``(n, columns)``, an even number of columns.
    covariance
        Of the columns' pixels.
    share
        Part of the difference that counts: the other axis leaves that much of an image's variance.
    keeps_ramp
        Whether the response to a ramp stays the same, too. No product of rows and columns
        responds to one, if the other's weights sum to 0.

    Returns
    -------
    ndarray of shape (n, taps)
        Weights of the middle columns.
    """
    for taps in range(_TAPS_MIN if keeps_ramp else 2, rows.shape[1], 2):
        weights, difference = _fitted(rows, taps, covariance, keeps_ramp)
        if float(difference.max()) * share <= covariance.tolerance:
            return weights
    return rows


def largest_variance(rows: FloatArray, covariance: ImageCovariance) -> float:
    """Largest variance of what a row of weights makes of an image of variance 1."""
    return float(_variances(rows, covariance).max())


def _fitted(
    rows: FloatArray, taps: int, covariance: ImageCovariance, keeps_ramp: bool
) -> tuple[FloatArray, FloatArray]:
    """Return weights of the middle columns, and the variance of the difference, row by row."""
    count = rows.shape[1]
    column = np.arange(count)
    near = column[(count - taps) // 2 :][:taps]
    wanted = rows @ covariance.values[np.abs(np.subtract.outer(column, near))]
    system = toeplitz(covariance.values[:taps])
    middle = (count - 1) / 2
    kept = 2 if keeps_ramp else 1
    drift = np.stack([np.ones(taps), near - middle])[:kept]
    moments = np.stack([rows.sum(axis=1), rows @ (column - middle)])[:kept]
    solved = np.linalg.solve(system, np.concatenate([wanted, drift]).T).T
    bare, drifts = solved[:-kept], solved[-kept:]
    factors = np.linalg.solve(drift @ drifts.T, moments - drift @ bare.T)
    weights = bare + factors.T @ drifts
    change = _variances(rows, covariance) - 2 * np.einsum("rn,rn->r", weights, wanted)
    return weights, change + _variances(weights, covariance)


def _variances(rows: FloatArray, covariance: ImageCovariance) -> FloatArray:
    system = toeplitz(covariance.values[: rows.shape[1]])
    return np.asarray(np.einsum("ra,ra->r", rows @ system, rows))
