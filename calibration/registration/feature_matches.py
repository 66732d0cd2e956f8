"""Pairs of points that a pose should bring together."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from simulation.arguments import ArgumentError, check_fields
from simulation.arrays import BoolArray, FloatArray
from simulation.by_value import ByValue
from simulation.pose import project


@dataclass(frozen=True, slots=True, eq=False)
class FeatureMatches(ByValue):
    """Pairs of points ``(x, y)``, shape (n, 2): follow-up and reference.

    Examples
    --------
    >>> import numpy as np
    >>> followup_px = np.array([[20.0, 20.0], [300.0, 20.0], [300.0, 220.0], [20.0, 220.0]])
    >>> pose = standoff.register("before.tif", "after.tif")
    >>> seen = np.c_[followup_px, np.ones(4)] @ pose.matrix.T
    >>> points = standoff.FeatureMatches(followup_px, seen[:, :2] / seen[:, 2:])
    >>> hints = standoff.RegistrationHints(points=points)
    >>> round(standoff.register("before.tif", "after.tif", hints=hints).zoom, 2)
    1.19
    """

    followup_px: FloatArray
    reference_px: FloatArray

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("followup_px", "reference_px"):
            points = getattr(self, name)
            if points.shape != (len(self.reference_px), 2) or not np.isfinite(points).all():
                raise ArgumentError(
                    f"expected as many finite pairs as of the other, shape (n, 2), got "
                    f"{points.shape}",
                    argument=name,
                )

    def swapped(self) -> Self:
        """Return the same pairs where the two photographs have changed roles."""
        return type(self)(followup_px=self.reference_px, reference_px=self.followup_px)

    def distances_px(self, matrix: FloatArray) -> FloatArray:
        """Distance in the reference between each match and its position by ``matrix``."""
        x, y = project(matrix, *self.followup_px.T)
        return np.asarray(np.hypot(x - self.reference_px[:, 0], y - self.reference_px[:, 1]))

    def rms_px(self, matrix: FloatArray, inlier: BoolArray) -> float:
        """Rms of ``distances_px`` over the chosen matches."""
        return float(np.sqrt(np.mean(self.distances_px(matrix)[inlier] ** 2)))
