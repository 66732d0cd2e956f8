"""Many edges as few: those of about one direction become one, with all that they tell of the lens.

What a transfer function near the truth leaves of an edge's levels, once the edge's own levels,
place, angle and bend are fitted, depends on the lens alone, to first order. Its mean over edges of
one direction, each bin weighted with its inverse variance, is therefore as good as all of them (a
sufficient statistic), and a fit to the means costs the same whatever the number of edges. What the
edges scatter about the mean is kept as a number, so that chi-squared stays that of all levels.

Angles within a group, and the places of the pixels within a bin, are brought to their means with
that transfer function; the second order is left to a last step of the fit over all edges.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from calibration.psf.otf_forms import OtfForm
from calibration.psf.otf_slices import EdgeStack, Residuals, StackedBins
from simulation.arrays import FloatArray, IntArray

MOST_GROUPS: Final = 32  # 5.6 degrees each, less than what counts as another direction
_GROUP_RAD = np.pi / MOST_GROUPS


def pooled(stack: EdgeStack, form: OtfForm, parameters: FloatArray, left: Residuals) -> EdgeStack:
    """Return one edge for each direction in which there are any.

    Parameters
    ----------
    stack
        The edges.
    form, parameters
        A transfer function near that of the edges.
    left
        What it leaves of their levels.
    """
    weight = stack.root_weight**2 * left.contrast[:, None] ** 2
    member, normal_rad = _groups(stack.normal_rad, weight.sum(axis=1))
    total = member @ weight
    per_weight = 1.0 / np.where(total > 0, total, np.inf)
    mean = (member @ (stack.root_weight * left.contrast[:, None] * left.values)) * per_weight
    bins = StackedBins(
        centre_px=stack.binned.centre_px,
        levels=np.zeros_like(total),
        weights=total,
        away_px=(member @ (weight * stack.away_px)) * per_weight,
        along=np.zeros_like(total),
        normal_rad=normal_rad,
        blur_px2=np.zeros_like(normal_rad),
        sharpest_px=stack.binned.sharpest_px,
        count=stack.bins,
        pooled_squares=left.squares - float(np.sum(total * mean**2)),
    )
    profiles = EdgeStack(bins).profiles(form.slices(parameters, normal_rad))
    return EdgeStack(replace(bins, levels=profiles + mean))


def _groups(normal_rad: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Which edges each group has, shape ``(groups, edges)`` of 0 and 1, and its mean normal."""
    number, centre = _directions(normal_rad)
    member = (np.arange(centre.size)[:, None] == number).astype(np.float64)
    # A normal is one modulo pi.
    away = (normal_rad - centre[number] + np.pi / 2) % np.pi - np.pi / 2
    return member, centre + (member @ (weight * away)) / (member @ weight)


def _directions(normal_rad: FloatArray) -> tuple[IntArray, FloatArray]:
    """Number of the group that each normal is in, and the angles of the groups' middles."""
    number = np.rint(normal_rad / _GROUP_RAD).astype(np.int64) % MOST_GROUPS
    filled, index = np.unique(number, return_inverse=True)
    return index.astype(np.int64), np.asarray(filled * _GROUP_RAD, dtype=np.float64)
