"""What an operator knows of an alignment beforehand."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from calibration.registration.distorted_pose import mirrored_matrix
from calibration.registration.feature_matches import FeatureMatches
from simulation.arguments import ArgumentError, check_fields
from simulation.arrays import BoolArray, FloatArray
from simulation.by_value import ByValue
from simulation.pose import homography_fault

POINTS_MIN = 4
"""Pairs of points that determine a homography."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RegistrationHints(ByValue):
    """What is known of a pose before two photographs are aligned; None where nothing is.

    Parameters
    ----------
    zoom
        Approximate ratio of the distances, follow-up over reference; right to some 15 %.
    matrix
        Shape (3, 3): approximate map from follow-up pixels ``(x, y, 1)`` to reference pixels. It is
        refined; where that fails it is kept as given, and the result warns of it.
    points
        At least 4 pairs of points, no three on a line, right to a few pixels. What they give is
        refined, and kept with a warning where that fails.
    left_out
        Follow-up pixels that do not count, of the follow-up's shape.
    mirrored
        Whether one of the two shows the scene as in a mirror. A pose that is given is then the one
        of the follow-up as it is: its determinant is negative.

    Raises
    ------
    ArgumentError
        If a value is not of its kind or range.

    Examples
    --------
    >>> hints = standoff.RegistrationHints(zoom=1.2)
    >>> round(standoff.register("before.tif", "after.tif", hints=hints).zoom, 2)
    1.19
    """

    zoom: float | None = None
    matrix: FloatArray | None = None
    points: FeatureMatches | None = None
    left_out: BoolArray | None = None
    mirrored: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        if self.matrix is not None:
            fault = homography_fault(self.matrix)
            if fault is not None:
                raise ArgumentError(fault, argument="matrix")
        if self.left_out is not None and self.left_out.ndim != 2:
            raise ArgumentError(
                f"expected shape (rows, cols), got {self.left_out.shape}", argument="left_out"
            )
        if self.points is not None and len(self.points.followup_px) < POINTS_MIN:
            raise ArgumentError(
                f"{POINTS_MIN} pairs are needed, got {len(self.points.followup_px)}",
                argument="points",
            )

    @property
    def is_of_pose(self) -> bool:
        """Whether they say anything of the pose, and not only what does not count."""
        return self.mirrored or any(
            one is not None for one in (self.zoom, self.matrix, self.points)
        )

    def with_columns_reversed(self, shape: tuple[int, int]) -> Self:
        """Return the hints for the mirror image of a follow-up of ``(rows, cols)``."""
        matrix, points, left_out = self.matrix, self.points, self.left_out
        if matrix is not None:
            matrix = mirrored_matrix(matrix, shape)
        if points is not None:
            reversed_px = points.followup_px * (-1, 1) + (shape[1] - 1, 0)
            points = FeatureMatches(reversed_px, points.reference_px)
        if left_out is not None:
            left_out = np.ascontiguousarray(left_out[:, ::-1])
        return replace(
            self, matrix=matrix, points=points, left_out=left_out, mirrored=not self.mirrored
        )


def leaving_out(
    hints: RegistrationHints | None, left_out: BoolArray | None
) -> RegistrationHints | None:
    """Return hints that leave out other follow-up pixels as well."""
    if left_out is None:
        return hints
    hints = hints or RegistrationHints()
    if hints.left_out is not None and hints.left_out.shape == left_out.shape:
        left_out = left_out | hints.left_out
    return replace(hints, left_out=left_out)
