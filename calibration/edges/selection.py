"""Which edges of a photograph count: those of a region, and of a target told from its scene."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.choices import TargetChoice
from calibration.edge_search import EdgeSegment, beside_target
from calibration.edges.image import EdgeImage, Region
from calibration.edges.measurement import EdgeMeasurement, Method, measure_edges


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeSelection:
    """Which edges of a photograph count.

    ``region`` returns the part of it that is used, None for all. With the target ``auto``, edges
    of the scene beside a target are flagged ``beside_target``; with ``all``, every edge counts.
    """

    region: Callable[[EdgeImage], Region | None] = lambda _: None
    target: TargetChoice = "auto"

    def measured_in(self, source: EdgeImage, method: Method) -> list[EdgeMeasurement]:
        """Measure the edges of a photograph.

        Raises
        ------
        ValueError
            If the region is not within it.
        """
        edges = measure_edges(source, self.region(source), method)
        return told_apart(edges, source.pitch_px) if self.target == "auto" else edges


def told_apart(edges: Sequence[EdgeMeasurement], pitch_px: int = 1) -> list[EdgeMeasurement]:
    """Flag edges of one photograph as ``beside_target`` that belong to the scene.

    Parameters
    ----------
    edges
        All edges of the photograph, as measured.
    pitch_px
        Distance on the sensor between the pixels that were measured.
    """
    known = [edge for edge in edges if edge.levels_dn is not None]
    segments = [_segment(edge, pitch_px) for edge in known]
    levels_dn = np.array([edge.levels_dn for edge in known]).reshape(-1, 2)
    is_beside = beside_target(segments, levels_dn).tolist()
    scene = {id(edge) for edge, beside in zip(known, is_beside, strict=True) if beside}
    return [
        edge.model_copy(update={"flags": (*edge.flags, "beside_target")})
        if id(edge) in scene
        else edge
        for edge in edges
    ]


def _segment(edge: EdgeMeasurement, pitch_px: int) -> EdgeSegment:
    """Where the edge lies, in the pixels in which it was measured."""
    return EdgeSegment(
        x_px=edge.x_px / pitch_px,
        y_px=edge.y_px / pitch_px,
        normal_rad=edge.normal_rad,
        length_px=edge.length_px / pitch_px,
        found_length_px=edge.length_px / pitch_px,
        sigma_px=edge.sigma_px / pitch_px,
    )
