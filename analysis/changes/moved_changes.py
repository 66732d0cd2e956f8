"""The listed changes that are movements, apart from those that are not."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.changes.comparison import Comparison
from analysis.changes.detection import (
    LinkedRegion,
)
from analysis.changes.document import Change
from analysis.changes.movement import (
    ChangedRegion,
    Images,
    Movement,
    find_movements,
)
from calibration.registration import DistortedPose
from simulation.arrays import FloatArray, IntArray

_MOST_TRIED = 300
"""Changes of which it is asked; a frame with more is another scene."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Entry:
    """One entry of the list, with the regions that it stands for.

    ``visibility`` is what the list is ordered by, once it is one of things.
    """

    change: Change
    regions: tuple[LinkedRegion, ...]
    visibility: float = 0.0

    @property
    def pixels(self) -> tuple[IntArray, IntArray]:
        """Rows and columns on the comparison's grid, of the strongest region first."""
        return (
            np.concatenate([region.rows for region in self.regions]),
            np.concatenate([region.cols for region in self.regions]),
        )

    @property
    def area_px(self) -> int:
        """Pixels of the grid."""
        return sum(len(region.rows) for region in self.regions)


@dataclass(frozen=True, slots=True, kw_only=True)
class ToldApart:
    """Changes and movements, the most significant first each until they are ordered as things."""

    found: tuple[Entry, ...]
    shifted: tuple[Entry, ...]

    @property
    def changes(self) -> tuple[Change, ...]:
        """What changed."""
        return tuple(entry.change for entry in self.found)

    @property
    def moved(self) -> tuple[Change, ...]:
        """What moved."""
        return tuple(entry.change for entry in self.shifted)

    @property
    def changed_regions(self) -> tuple[LinkedRegion, ...]:
        """Of what changed."""
        return tuple(region for entry in self.found for region in entry.regions)

    @property
    def moved_regions(self) -> tuple[LinkedRegion, ...]:
        """Of what moved."""
        return tuple(region for entry in self.shifted for region in entry.regions)

    def together(self) -> "ToldApart":
        """Count movements among the changes."""
        both = sorted((*self.found, *self.shifted), key=lambda one: -one.visibility)
        return ToldApart(found=tuple(both), shifted=())


def moved_apart(
    compared: Comparison,
    pose: DistortedPose,
    regions: Sequence[LinkedRegion],
    changes: Sequence[Change],
) -> ToldApart:
    """Tell the movements among the listed changes; what one shift explains is one of them.

    Parameters
    ----------
    compared
        Whose changes they are.
    pose
        Of the follow-up in the reference.
    regions, changes
        All, the most significant first.
    """
    tried = [
        ChangedRegion(
            row=region.row,
            col=region.col,
            sign=1 if region.significance > 0 else -1,
            rows=region.rows,
            cols=region.cols,
        )
        for region in regions[:_MOST_TRIED]
    ]
    movements = find_movements(images_of(compared), tried) if tried else ()
    explained = {index for movement in movements for index in movement.regions}
    moved = [
        Entry(
            change=_as_change(movement, changes, tried, compared, pose),
            regions=tuple(regions[index] for index in movement.regions),
        )
        for movement in movements
    ]
    return ToldApart(
        found=tuple(
            Entry(change=change, regions=(region,))
            for index, (change, region) in enumerate(zip(changes, regions, strict=True))
            if index not in explained
        ),
        shifted=tuple(sorted(moved, key=lambda one: -one.change.significance)),
    )


def images_of(compared: Comparison) -> Images:
    """Both photographs in the levels that were matched."""
    scale = compared.matched_scale
    difference, sd = (
        np.divide(image, scale, out=np.zeros_like(image), where=compared.valid)
        for image in (compared.difference_dn, compared.sd_dn)
    )
    target, brought = compared.target_dn, compared.target_dn - difference
    is_on_followup = compared.is_on_followup
    return Images(
        before_dn=brought if is_on_followup else target,
        after_dn=target if is_on_followup else brought,
        sd_dn=np.abs(sd, out=sd),
        valid=compared.valid,
        smoothing_px=compared.smoothing_px,
    )


def _as_change(
    movement: Movement,
    changes: Sequence[Change],
    regions: Sequence[ChangedRegion],
    compared: Comparison,
    pose: DistortedPose,
) -> Change:
    first = movement.regions[0]
    displacement, covariance = movement.displacement_px, movement.covariance_px2
    if not compared.is_on_followup:
        at = (float(regions[first].row), float(regions[first].col))
        slope = _followup_slope(pose, at)
        displacement = tuple(slope @ displacement)
        covariance = slope @ covariance @ slope.T
    err = np.sqrt(np.diag(covariance))
    return changes[first].model_copy(
        update={
            "area_px": sum(changes[index].area_px for index in movement.regions),
            "displacement_px": (float(displacement[1]), float(displacement[0])),
            "displacement_err_px": (float(err[1]), float(err[0])),
            "is_moved": True,
        }
    )


def _followup_slope(pose: DistortedPose, at: tuple[float, float]) -> FloatArray:
    """Follow-up pixels (y, x) by reference pixels (y, x), shape (2, 2)."""
    y, x = (
        np.array([at[0] + 0.5, at[0] - 0.5, at[0], at[0]]),
        np.array([at[1], at[1], at[1] + 0.5, at[1] - 0.5]),
    )
    rows, cols = pose.to_followup_px(y, x)
    return np.array(
        [[rows[0] - rows[1], rows[2] - rows[3]], [cols[0] - cols[1], cols[2] - cols[3]]]
    )
