"""Linear observers: how a detector weighs the pixels of a difference image.

Every observer is a template w; its decision is ``w . g`` and its detectability index
``d' = w . s / sqrt(w . K w)``, the distance of the two means over the standard deviation.

References
----------
H. H. Barrett, K. J. Myers, "Foundations of Image Science", 2004, chapter 13; B. D. Gallas,
H. H. Barrett, "Validating the use of channels to estimate the ideal linear observer", 2003
(Laguerre-Gauss channels).
"""

from math import pi, sqrt

import numpy as np
from scipy.special import eval_laguerre, ndtr, ndtri

from analysis.choices import OBSERVERS, Observer
from analysis.detectability.covariance import Covariance
from simulation.arrays import FloatArray

CHANNELS = 6
"""Laguerre-Gauss channels; Gallas and Barrett 2003 find 5 to 10 enough for Gaussian signals."""


def auc_of(d_prime: FloatArray | float) -> FloatArray:
    """Area under the ROC curve of normally distributed decisions, in [0.5, 1] for d' >= 0."""
    return np.asarray(ndtr(np.asarray(d_prime) / sqrt(2.0)))


def d_prime_of_auc(auc: FloatArray | float) -> FloatArray:
    """Index d' of normally distributed decisions with this AUC, in [0, 1]; infinite at its ends."""
    return np.asarray(sqrt(2.0) * ndtri(np.asarray(auc)))


def observer_templates(
    signal: FloatArray, covariance: Covariance, observers: tuple[Observer, ...]
) -> dict[Observer, FloatArray]:
    """Templates of the observers for a signal known exactly in noise of known covariance.

    Parameters
    ----------
    signal
        What is left of the change in the difference image, shape (n, n).
    covariance
        Of the window's pixels, positive definite.
    observers
        Observers to evaluate.

    Returns
    -------
    dict of ndarray, shape (n, n)
        ``npw``: the signal itself; ``hotelling``: ``K^-1 s``; ``cho``: the Hotelling observer
        of what the Laguerre-Gauss channels let through.

    Raises
    ------
    ValueError
        If an observer is unknown.
    """
    templates: dict[Observer, FloatArray] = {}
    for observer in observers:
        match observer:
            case "npw":
                templates[observer] = signal
            case "hotelling":
                templates[observer] = covariance.solved(signal)
            case "cho":
                channels = laguerre_gauss_channels(signal, CHANNELS)
                spread = covariance.times(channels.T.reshape(-1, *signal.shape))
                inner = channels.T @ spread.reshape(channels.shape[1], -1).T
                through = np.linalg.solve(inner, channels.T @ signal.ravel())
                templates[observer] = np.asarray(channels @ through).reshape(signal.shape)
            case _:
                raise ValueError(f"observer must be one of {', '.join(OBSERVERS)}")
    return templates


def laguerre_gauss_channels(signal: FloatArray, count: int) -> FloatArray:
    """Rotationally symmetric channels around a signal's centre, as wide as it, orthonormal.

    Parameters
    ----------
    signal
        Shape (n, n). Centre and width are the moments of its squared levels.
    count
        Number of channels.

    Returns
    -------
    ndarray of float64, shape (n^2, count)
        ``L_j(2 pi r^2 / a^2) exp(-pi r^2 / a^2)`` with ``a = sqrt(2 pi) sigma``, so that the
        first one matches a Gaussian signal of that sigma; made orthonormal on the pixels.
    """
    position = np.arange(signal.shape[0], dtype=np.float64)
    weight = signal**2 / np.sum(signal**2)
    centre_y, centre_x = float(weight.sum(axis=1) @ position), float(weight.sum(axis=0) @ position)
    r2 = (position[:, None] - centre_y) ** 2 + (position[None, :] - centre_x) ** 2
    # The square of a Gaussian has half its variance: the mean r^2 is that sigma^2.
    sigma2 = max(float(np.sum(weight * r2)), 0.25)
    scaled = pi * r2.ravel() / (2 * pi * sigma2)
    channels = np.stack(
        [eval_laguerre(j, 2 * scaled) * np.exp(-scaled) for j in range(count)], axis=1
    )
    return np.asarray(np.linalg.qr(channels)[0])
