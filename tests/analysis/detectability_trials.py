"""Monte Carlo cross-check of the analytic d': images drawn, noise added, decisions counted."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.stats import rankdata

from analysis.detectability._scenario import LocalChange
from simulation.arrays import FloatArray

__all__ = ["TrialResult", "run_trials"]

_BATCH = 500


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialResult:
    """What a template achieved over many drawn difference images, with standard errors."""

    d_prime: float
    d_prime_err: float
    auc: float
    auc_err: float


def run_trials(
    change: LocalChange,
    templates: Sequence[FloatArray],
    artefacts_dn: Sequence[FloatArray],
    *,
    contrast_dn: float,
    noise_dn: float,
    trials: int,
    rng: np.random.Generator,
) -> list[TrialResult]:
    """Draw difference images with and without the change and let the templates decide.

    The artefact is cut out of whole artefact images at random places, the noise of the follow-up
    is drawn on its own pixels and brought onto the reference's: neither covariance is used.

    Parameters
    ----------
    change
        The signal at one place, and the window's part of U.
    templates
        Shape (n, n) each.
    artefacts_dn
        From ``ComparedPair.artefact_of``.
    contrast_dn, noise_dn
        Peak of the signal on c, standard deviation of the noise in either image.
    trials
        Difference images of each kind, at least 2.
    rng
        Where all of it comes from.

    References
    ----------
    E. R. DeLong et al., "Comparing the areas under two or more correlated receiver operating
    characteristic curves", 1988, for the standard error of the AUC.
    """
    weights = np.stack([template.ravel() for template in templates])
    shift = contrast_dn * (weights @ change.signal.ravel())
    absent = _decisions(change, weights, artefacts_dn, noise_dn, trials, rng)
    present = _decisions(change, weights, artefacts_dn, noise_dn, trials, rng) + shift[:, None]
    return [_result(a, b) for a, b in zip(absent, present, strict=True)]


def _decisions(
    change: LocalChange,
    weights: FloatArray,
    artefacts_dn: Sequence[FloatArray],
    noise_dn: float,
    trials: int,
    rng: np.random.Generator,
) -> FloatArray:
    n = change.signal.shape[0]
    centred = [artefact - artefact.mean() for artefact in artefacts_dn]
    # Every position of every image is as likely as any other.
    pixels = np.array([(a.shape[0] - n + 1) * (a.shape[1] - n + 1) for a in centred], dtype=float)
    found = []
    for first in range(0, trials, _BATCH):
        count = min(_BATCH, trials - first)
        far = rng.standard_normal((count, change.up_y.shape[1], change.up_x.shape[1]))
        difference = noise_dn * (change.up_y @ far @ change.up_x.T)
        difference -= noise_dn * rng.standard_normal((count, n, n))
        for place, image in enumerate(rng.choice(len(centred), count, p=pixels / pixels.sum())):
            artefact = centred[image]
            top = int(rng.integers(artefact.shape[0] - n + 1))
            left = int(rng.integers(artefact.shape[1] - n + 1))
            difference[place] += artefact[top : top + n, left : left + n]
        found.append(weights @ difference.reshape(count, n * n).T)
    return np.concatenate(found, axis=1)


def _result(absent: FloatArray, present: FloatArray) -> TrialResult:
    n = len(absent)
    deviations = np.concatenate([absent - absent.mean(), present - present.mean()])
    variance = float(np.sum(deviations**2) / (2 * n - 2))
    d_prime = float((present.mean() - absent.mean()) / sqrt(variance))
    kurtosis = float(np.mean(deviations**4) / variance**2)
    # Two means and one variance, of decisions that need not be normal.
    err = sqrt(2 / n + d_prime**2 * (kurtosis - 1) / (8 * n))
    rank = rankdata(np.concatenate([absent, present]))
    above_absent = (rank[n:] - rankdata(present)) / n
    below_present = 1 - (rank[:n] - rankdata(absent)) / n
    auc_err = sqrt((np.var(above_absent, ddof=1) + np.var(below_present, ddof=1)) / n)
    return TrialResult(
        d_prime=d_prime, d_prime_err=err, auc=float(above_absent.mean()), auc_err=auc_err
    )
