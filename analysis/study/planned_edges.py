"""The edges of a planned session: where they lie, how long they are, in which capture."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, radians, sin, sqrt

import numpy as np

from analysis.study.edge_information import EdgeLevels, sigma_err_px
from simulation.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedEdge:
    """One edge of one planned capture.

    ``capture``: number of the capture; edges of one capture share its focus. ``angle_deg``:
    direction of the edge line from +x, y down.
    """

    capture: int
    angle_deg: float
    length_px: float

    @property
    def normal(self) -> tuple[float, float]:
        """Unit normal (x, y)."""
        turn = radians(self.angle_deg + 90.0)
        return cos(turn), sin(turn)


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeSession:
    """The planned edges, and what their pixels are like.

    ``levels``: levels and noise of one frame, the same for all edges. ``frames``: frames of a
    capture. ``focus_scatter_px2``: standard deviation of the PSF's variance from capture to
    capture, in every direction.
    """

    edges: tuple[PlannedEdge, ...]
    levels: EdgeLevels
    frames: int
    focus_scatter_px2: float = 0.0

    @property
    def same_capture(self) -> FloatArray:
        """Matrix of shape (edges, edges): 1 where two edges are of one capture."""
        capture = np.array([edge.capture for edge in self.edges])
        return np.asarray(capture[:, None] == capture, dtype=np.float64)

    def widths_px(self, covariance_px2: FloatArray) -> FloatArray:
        """Total width across each edge for a PSF of this covariance, shape (edges,)."""
        normal = np.array([edge.normal for edge in self.edges])
        return np.asarray(np.sqrt(np.einsum("na,ab,nb->n", normal, covariance_px2, normal)))

    def width_errs_px(self, covariance_px2: FloatArray) -> FloatArray:
        """Standard error of each width by the noise of the pixels, shape (edges,)."""
        per_root_px = {
            width: sigma_err_px(width, 1.0, self.levels, self.frames)
            for width in set(self.widths_px(covariance_px2).tolist())
        }
        return np.array(
            [
                per_root_px[width] / sqrt(edge.length_px)
                for width, edge in zip(
                    self.widths_px(covariance_px2).tolist(), self.edges, strict=True
                )
            ]
        )


def edges_of_captures(
    orientations_deg: Sequence[float], template: Sequence[tuple[float, float]]
) -> tuple[PlannedEdge, ...]:
    """Return the edges of captures at these orientations of a target.

    ``template``: angle against the target's orientation, and length in px, of each edge of a
    capture.
    """
    return tuple(
        PlannedEdge(
            capture=number,
            angle_deg=(orientation_deg + angle_deg) % 180.0,
            length_px=length_px,
        )
        for number, orientation_deg in enumerate(orientations_deg)
        for angle_deg, length_px in template
    )
