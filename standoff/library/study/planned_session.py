"""The edges and boards of a capture plan, as the bench will see them."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from acquisition.plan import PlanEntry
from analysis.study import BoardCapture, EdgeLevels, EdgeSession, PlannedEdge, edges_of_captures
from calibration.edges import EdgeMeasurement
from calibration.psf import PsfCalibration

_NEAR_DEG = 15.0
_PARALLEL_DEG = 5.0
_OF_FRAME = 0.8
_USUAL_LENGTH_PX = 200.0


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeTemplate:
    """The edges that a capture of kind edge is expected to show.

    Parameters
    ----------
    known
        Edges of psf.json that were used.
    per_capture, length_px
        Stated instead; None takes them from ``known``.
    frame
        Rows and columns, None if not known.
    """

    known: tuple[EdgeMeasurement, ...] = ()
    per_capture: int | None = None
    length_px: float | None = None
    frame: tuple[int, int] | None = None

    @classmethod
    def of(
        cls,
        psf: PsfCalibration | None,
        frame: tuple[int, int] | None,
        per_capture: int | None,
        length_px: float | None,
    ) -> "EdgeTemplate":
        """Return the template that follows from a psf.json."""
        known = () if psf is None else psf.edges_used
        return cls(known=known, per_capture=per_capture, length_px=length_px, frame=frame)

    def at(self, orientation_deg: float) -> list[tuple[float, float]]:
        """Angle against the target's orientation, and length, of each edge of a capture."""
        if self.per_capture is not None or not self.known:
            # Sides of squares: every other one is turned by a right angle.
            count = self.per_capture or 1
            length_px = self._length_px(orientation_deg)
            return [(90.0 * (number % 2), length_px) for number in range(count)]
        images = [
            list(edges)
            for _, edges in groupby(
                sorted(self.known, key=lambda one: one.image), key=lambda one: one.image
            )
        ]
        if all(_is_parallel(edges) for edges in images):
            nearest = min(images, key=lambda edges: _apart_deg(edges[0].angle_deg, orientation_deg))
            return [(0.0, self.length_px or edge.length_px) for edge in nearest]
        typical = int(np.median([len(edges) for edges in images]))
        pattern = min(images, key=lambda edges: abs(len(edges) - typical))
        return [(edge.angle_deg, self.length_px or edge.length_px) for edge in pattern]

    def _length_px(self, orientation_deg: float) -> float:
        if self.length_px is not None:
            return self.length_px
        if not self.known:
            return _USUAL_LENGTH_PX if self.frame is None else _OF_FRAME * min(self.frame)
        near = [e for e in self.known if _apart_deg(e.angle_deg, orientation_deg) <= _NEAR_DEG]
        return float(np.mean([edge.length_px for edge in near or self.known]))

    @property
    def assumption(self) -> str:
        """Where it comes from, in words."""
        if self.length_px is not None and self.per_capture is not None:
            return "number and length of the edges of a capture are as given"
        if self.known:
            return "number and length of the edges of a capture are as in psf.json, unless given"
        return "psf.json has no edges: one to a capture, over 0.8 of the frame, unless given"


def _apart_deg(first_deg: float, second_deg: float) -> float:
    """Angle between two lines, from 0 to 90 degrees."""
    return abs((first_deg - second_deg + 90.0) % 180.0 - 90.0)


def _is_parallel(edges: Sequence[EdgeMeasurement]) -> bool:
    """Whether the edges of a photograph are pieces of one, or parallel."""
    return all(_apart_deg(one.angle_deg, edges[0].angle_deg) <= _PARALLEL_DEG for one in edges)


def planned_edges(
    entries: Sequence[PlanEntry],
    template: EdgeTemplate,
    levels: EdgeLevels,
    frames: int,
    focus_scatter_px2: float,
) -> EdgeSession | None:
    """Return the edges that a plan captures; None where it captures none."""
    edges: list[PlannedEdge] = []
    for entry in entries:
        if entry.kind == "edge":
            found = edges_of_captures([entry.orientation_deg], template.at(entry.orientation_deg))
            edges += (
                PlannedEdge(capture=entry.index, angle_deg=one.angle_deg, length_px=one.length_px)
                for one in found
            )
    if not edges:
        return None
    return EdgeSession(
        edges=tuple(edges), levels=levels, frames=frames, focus_scatter_px2=focus_scatter_px2
    )


def planned_boards(entries: Sequence[PlanEntry]) -> tuple[BoardCapture, ...]:
    """Return the captures of boards of a plan."""
    placements: dict[tuple[str, str, float], int] = {}
    return tuple(
        BoardCapture(
            placement=placements.setdefault(entry.placement, len(placements)),
            orientation_deg=entry.orientation_deg,
            height_mm=entry.height_mm,
        )
        for entry in entries
        if entry.kind == "board"
    )
