"""What a comparison leaves of two photographs without noise: aliasing, and a kernel's limits."""

from dataclasses import dataclass

import numpy as np

from analysis.changes.matching import (
    FitRules,
    Smoothing,
    VarianceTerms,
    fit_pair,
    sampled,
    smoothed,
)
from analysis.changes.options import ChangeOptions
from analysis.changes.photograph_pair import PhotographPair
from calibration.registration import DistortedPose
from simulation.arrays import FloatArray

_LEAST_PIXELS = 1000

_SAMPLE_PX = 6000
"""Pixels that the kernel is fitted to. Without noise, 25,000 leave as much to 2 % (text and texture
through a lens of f/8), in four times the time."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Unexplained:
    """The difference that remains without any noise.

    Parameters
    ----------
    difference_dn
        Behind the narrowest filter, on the part of the follow-up that was compared; 0 where it was
        not.
    typical_dn2
        Variance that the comparison gives it at the median place. Most of what is unexplained
        lies along a scene's edges, and the mean is that of few places.
    """

    difference_dn: FloatArray
    typical_dn2: float

    @property
    def at_the_median_place(self) -> FloatArray:
        """The difference, scaled to the variance at the median place."""
        mean_dn2 = float(np.mean(self.difference_dn**2))
        if mean_dn2 == 0:
            return self.difference_dn
        return np.asarray(self.difference_dn * np.sqrt(min(self.typical_dn2 / mean_dn2, 1.0)))


def unexplained(
    reference_dn: FloatArray, followup_dn: FloatArray, matrix: FloatArray, smoothing: Smoothing
) -> Unexplained:
    """Match two photographs of one scene as a comparison does, and return what is left.

    Parameters
    ----------
    reference_dn, followup_dn
        Without noise, shape ``(rows, cols)``; the follow-up is the coarser one.
    matrix
        Follow-up pixel ``(x, y, 1)`` to reference pixel, shape ``(3, 3)``.
    smoothing
        That brings them to one sharpness.

    Raises
    ------
    ValueError
        If they are too small to be compared.
    """
    pose = DistortedPose(
        matrix=matrix,
        k1=0.0,
        reference_shape=(reference_dn.shape[0], reference_dn.shape[1]),
        followup_shape=(followup_dn.shape[0], followup_dn.shape[1]),
    )
    pair = PhotographPair.of(reference_dn, followup_dn, pose, ChangeOptions())
    valid = pair.valid(smoothing)
    if np.count_nonzero(valid) < _LEAST_PIXELS:
        rows, cols = followup_dn.shape
        raise ValueError(
            f"a follow-up of {cols} x {rows} px is too small to be compared; observer changes "
            "needs larger photographs, or smaller zooms"
        )
    seen, target = pair.seen(smoothing.source_px), smoothed(pair.target, smoothing.target_px)
    terms = VarianceTerms.of(seen, pair.source, pair.target, pair.positions)
    told = np.zeros_like(valid)
    told[sampled(valid, _SAMPLE_PX)] = True
    fit = fit_pair(seen, target, terms, told, None, FitRules(smoothing_px=smoothing.target_px))
    difference = np.where(valid, fit.model.difference(seen, target), 0.0)
    rows, cols = (np.flatnonzero(valid.any(axis=axis)) for axis in (1, 0))
    return Unexplained(
        difference_dn=difference[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1],
        typical_dn2=float(np.median(terms.variance(fit.sizes)[valid])),
    )
