"""Height series: the captures of a target, their poses and the lens."""

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.geometry.camera import CapturePose, PlaneLens
from simulation.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GeometryCapture:
    """One capture of a board or of a textured target.

    ``image`` is grey and linear, shape ``(rows, cols)``; ``height_mm`` was read back. Captures of
    one kind, target and orientation show the same target, which was not touched in between.
    """

    name: str
    kind: str
    target: str
    orientation_deg: float
    height_mm: float
    image: NDArray[np.floating[Any]] = field(repr=False)
    index: int | None = None

    @property
    def placement(self) -> tuple[str, str, float]:
        """What the captures of one series have in common."""
        return self.kind, self.target, self.orientation_deg


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Exclusion:
    """A capture that is not used, and why."""

    capture: GeometryCapture
    reason: str


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PosedCapture:
    """A capture, its pose, and how well its accepted matches fit."""

    capture: GeometryCapture
    pose: CapturePose
    match_count: int = 0
    rms_px: float = 0.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Series:
    """The captures of one placement of a target.

    Parameters
    ----------
    lens
        The camera's lens, inclined as it is to this target.
    captures
        At least one.
    is_in_mm
        Whether the target has a known size. If not, lengths are in units of the first capture's
        distance, and that capture's pose is fixed.
    """

    lens: PlaneLens
    captures: tuple[PosedCapture, ...]
    is_in_mm: bool

    @property
    def target(self) -> str:
        """Name of the target."""
        return self.captures[0].capture.target

    @property
    def heights_mm(self) -> tuple[float, ...]:
        """Height of each capture."""
        return tuple(one.capture.height_mm for one in self.captures)

    @property
    def nearest_distance(self) -> float:
        """Distance of the nearest capture."""
        return min(one.pose.distance for one in self.captures)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PlaneMatches:
    """Pixels of one capture that show the same plane points as those of another, or of a board.

    Parameters
    ----------
    capture
        The capture.
    seen_px
        Its pixels (x, y), shape (n, 2).
    other
        The other capture; None where ``other_points`` are known plane points in mm.
    other_points
        Pixels of the other capture, or plane points, shape (n, 2).
    covariance_px2
        Covariance of the disagreement, in pixels of ``capture``, shape (n, 2, 2), up to a factor.
    """

    capture: GeometryCapture
    seen_px: FloatArray = field(repr=False)
    other: GeometryCapture | None
    other_points: FloatArray = field(repr=False)
    covariance_px2: FloatArray = field(repr=False)

    def is_between(self, captures: Collection[GeometryCapture]) -> bool:
        """Whether the matches need no captures other than these."""
        return self.capture in captures and (self.other is None or self.other in captures)
