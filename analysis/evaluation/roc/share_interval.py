"""Interval of a share from its variance over photographs; of a few photographs too.

The interval is symmetric in the logit, with Student's quantile. Where the variance is nothing (no
photograph differs from another, or all is found) it says nothing, and the share counts as one of so
many independent photographs: Clopper and Pearson's interval, which at shares of 0 and 1 is the
rule of three's exact form, ``0.025^(1/n)``.

References
----------
C. J. Clopper, E. S. Pearson, "The use of confidence or fiducial limits illustrated in the case of
the binomial", Biometrika 26, 1934; E. L. Korn, B. I. Graubard, "Confidence intervals for
proportions with small expected number of positive counts estimated from survey data", Survey
Methodology 24, 1998 (shares of clusters); J. A. Hanley, A. Lippman-Hand, "If nothing goes wrong,
is everything all right?", JAMA 249, 1983 (rule of three).
"""

from dataclasses import dataclass
from math import exp, isinf, log, sqrt

from scipy.special import betaincinv, ndtri, stdtrit

LEVEL = 0.95
_TAIL = (1 - LEVEL) / 2
_NORMAL = float(ndtri(1 - _TAIL))
_NO_VARIANCE = 1e-12
"""Of a share's largest variance: below, it is rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShareInterval:
    """95 % interval of a share; ``err`` is its standard error.

    Where the variance is nothing, ``err`` is what a normal interval of that width would have.
    """

    err: float
    low: float
    high: float


def share_interval(share: float, variance: float, freedom: float, units: int) -> ShareInterval:
    """Interval of a share, such as an AUC, in [0, 1].

    Parameters
    ----------
    share
        The estimate.
    variance
        Of the estimate; not used where ``freedom`` is 0.
    freedom
        Degrees of freedom of the variance; infinite for the normal quantile.
    units
        Independent units, photographs or pairs, that the share counts as one of where the variance
        is nothing.
    """
    spread = share * (1 - share)
    if freedom < 1 or not variance > _NO_VARIANCE * spread or spread <= 0:
        low, high = _clopper_pearson(share * units, units)
        return ShareInterval(err=(high - low) / (2 * _NORMAL), low=low, high=high)
    quantile = _NORMAL if isinf(freedom) else float(stdtrit(freedom, 1 - _TAIL))
    half = quantile * sqrt(variance) / spread
    logit = log(share / (1 - share))
    return ShareInterval(
        err=sqrt(variance), low=_share_of(logit - half), high=_share_of(logit + half)
    )


def _clopper_pearson(found: float, units: int) -> tuple[float, float]:
    """Also of a number found that is not whole."""
    low = float(betaincinv(found, units - found + 1, _TAIL)) if found > 0 else 0.0
    high = float(betaincinv(found + 1, units - found, 1 - _TAIL)) if found < units else 1.0
    return low, high


def _share_of(logit: float) -> float:
    """Inverse of the logit, without overflow."""
    if logit < 0:
        return exp(logit) / (1 + exp(logit)) if logit > -700 else 0.0
    return 1 / (1 + exp(-logit)) if logit < 700 else 1.0
