"""Whether a follow-up's pose is good enough: a map of d' over the frame, and a verdict."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.choices import Criterion
from analysis.detectability import DetectabilityCurve
from analysis.errors import AnalysisError
from analysis.pose.local_sampling import LocalSampling, local_sampling

__all__ = ["QUANTILE", "Criterion", "PoseQuality", "judge_pose"]

FloatArray = NDArray[np.float64]

QUANTILE = 0.05
"""Share of the overlap that may lie below the threshold by criterion ``quantile``."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseQuality:
    """Verdict on a pose.

    Parameters
    ----------
    sampling
        Where the follow-up samples the reference how densely.
    d_prime
        Shape of the sampling's maps; an upper bound; 0 where the local zoom lies beyond the
        curve, NaN outside the reference.
    decisive_d_prime
        What the criterion looks at: the least value, or the quantile.
    min_d_prime, criterion
        What was asked for.
    beyond_curve
        Share of the overlap whose local zoom the curve does not reach.
    """

    sampling: LocalSampling
    d_prime: FloatArray
    decisive_d_prime: float
    min_d_prime: float
    criterion: Criterion
    beyond_curve: float

    @property
    def is_accepted(self) -> bool:
        """Whether d' reaches the threshold by the criterion."""
        return self.decisive_d_prime >= self.min_d_prime


def judge_pose(
    matrix: FloatArray,
    followup_size: tuple[int, int],
    reference_size: tuple[int, int],
    curve: DetectabilityCurve,
    min_d_prime: float,
    criterion: Criterion = "min",
) -> PoseQuality:
    """Judge a pose by the curve's d' at the local zoom of the worse direction.

    Parameters
    ----------
    matrix
        Shape (3, 3): follow-up pixel centres to reference pixel centres.
    followup_size, reference_size
        ``(width, height)``.
    curve
        d' against zoom.
    min_d_prime
        Threshold.
    criterion
        ``min``: d' reaches the threshold everywhere in the overlap; ``quantile``: in all but
        5 % of it.

    Raises
    ------
    AnalysisError
        If the follow-up sees nothing of the reference, or its plane's horizon.
    """
    try:
        sampling = local_sampling(matrix, followup_size, reference_size)
    except ValueError as error:
        raise AnalysisError(str(error)) from error
    if not sampling.inside.any():
        raise AnalysisError("the follow-up sees nothing of the reference")
    known = curve.d_prime_at(sampling.worst_zoom)
    is_beyond = np.isnan(known)
    # Whatever d' is there, it is below the curve's last value and not known to be enough.
    d_prime = np.where(is_beyond, 0.0, known)
    seen = d_prime[sampling.inside]
    decisive = seen.min() if criterion == "min" else np.quantile(seen, QUANTILE, method="lower")
    return PoseQuality(
        sampling=sampling,
        d_prime=np.where(sampling.inside, d_prime, np.nan),
        decisive_d_prime=float(decisive),
        min_d_prime=min_d_prime,
        criterion=criterion,
        beyond_curve=float(is_beyond[sampling.inside].mean()),
    )
