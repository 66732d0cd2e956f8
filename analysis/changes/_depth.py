"""Scenes with depth: whether parallax explains what a plane leaves between two photographs."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from analysis.changes._comparison import Comparison, compare
from analysis.changes._photograph_pair import ChangeOptions
from calibration.parallax import Parallax, find_parallax
from calibration.registration import DistortedPose
from simulation import Psf, PsfField
from simulation.arrays import AnyArray

_BEYOND_SD: Final = 5.0
_LEAST_SHARE: Final = 0.005
"""Share of the pixels that differ by so many standard deviations, from which on a plane may not be
all: of a flat scene without changes it is 6e-7."""

_LEAST_ERR_PX: Final = 0.15
"""Registration error from which on it may not be, either: it hides what differs."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DepthComparison:
    """A comparison in which every pixel is at its depth."""

    parallax: Parallax
    compared: Comparison


def with_depth(
    photographs: tuple[AnyArray, AnyArray],
    psf: Psf | PsfField | None,
    pose: DistortedPose,
    options: ChangeOptions,
    compared: Comparison,
) -> DepthComparison | None:
    """Compare again with the parallax of the scene; None where a plane explains as much.

    ``photographs``: reference and follow-up, grey. ``pose, compared``: of the plane.
    """
    if options.is_flat or not _leaves_much(compared):
        return None
    reference, followup = photographs
    parallax = find_parallax(reference, followup, pose)
    if parallax is None:
        return None
    again = compare(reference, followup, psf, parallax.pose, options)
    if not _explains_more(again, compared):
        return None
    return DepthComparison(parallax=parallax, compared=again)


def _leaves_much(compared: Comparison) -> bool:
    beyond = np.abs(compared.significance[compared.valid]) > _BEYOND_SD
    return bool(
        compared.registration_err_px > _LEAST_ERR_PX or np.mean(beyond) > _LEAST_SHARE
    )


def _explains_more(again: Comparison, compared: Comparison) -> bool:
    """Whether less is left where both compare."""
    if again.is_on_followup != compared.is_on_followup:
        return True
    both = again.valid & compared.valid
    left, before = (
        float(np.mean(np.abs(one.difference_dn[both]), dtype=np.float64))
        for one in (again, compared)
    )
    return left < before
