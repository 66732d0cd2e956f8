"""What an operator knows of an alignment beforehand."""

from dataclasses import dataclass

import numpy as np

from calibration.registration.feature_matches import FeatureMatches
from simulation.arrays import BoolArray, FloatArray

POINTS_MIN = 4
"""Pairs of points that determine a homography."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RegistrationHints:
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

    Raises
    ------
    ValueError
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

    def __post_init__(self) -> None:
        if self.zoom is not None and not 0 < self.zoom < np.inf:
            raise ValueError(f"the expected zoom must be positive, got {self.zoom}")
        if self.matrix is not None and (
            self.matrix.shape != (3, 3)
            or not np.isfinite(self.matrix).all()
            or not np.linalg.det(self.matrix)
        ):
            raise ValueError(f"the expected pose must be an invertible 3 x 3, got {self.matrix}")
        if self.points is not None and len(self.points.followup_px) < POINTS_MIN:
            raise ValueError(
                f"{POINTS_MIN} pairs of points are needed, got {len(self.points.followup_px)}"
            )
