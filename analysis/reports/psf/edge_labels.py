"""Which edges of a photograph get a label, and where, so that no two labels overlap."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.edges import EdgeMeasurement
from calibration.sharpness import reported_mtf50
from simulation.arrays import FloatArray

LABEL_POINTS = 8.0
_LETTER = 0.64  # width of a digit over the size of the text, DejaVu Sans
_LINE = 1.3
_AWAY = 0.75  # from the edge to the label's middle, in sizes of the label along the normal
_LABELS_MOST = 70  # more hide the photograph
_POINTS_PER_IN = 72.0


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeLabel:
    """A text and its middle in px of the photograph."""

    text: str
    x_px: float
    y_px: float


def placed_labels(
    edges: Sequence[EdgeMeasurement], width_px: int, height_px: int, px_per_in: float
) -> list[EdgeLabel]:
    """Label edges with their MTF50 in cy/px: the softest and the sharpest first, then long ones."""
    if not edges:
        return []
    ranked = sorted(edges, key=lambda edge: reported_mtf50(edge).cy_per_px)
    extremes = [ranked[0], ranked[-1]]
    others = sorted(edges, key=lambda edge: -edge.length_px)
    placed: list[EdgeLabel] = []
    boxes = np.empty((0, 2))
    labelled: set[int] = set()
    for edge in [*extremes, *others]:
        if len(placed) == _LABELS_MOST or id(edge) in labelled:
            continue
        text = f"{reported_mtf50(edge).cy_per_px:.3f}"
        size = np.array([_LETTER * len(text), _LINE]) * LABEL_POINTS / _POINTS_PER_IN * px_per_in
        for middle in _sides(edge, size):
            is_inside = np.all(middle >= 0.5 * size) and np.all(
                middle <= np.array([width_px, height_px]) - 0.5 * size
            )
            if is_inside and not np.any(np.all(np.abs(boxes - middle) < size, axis=1)):
                placed.append(EdgeLabel(text=text, x_px=float(middle[0]), y_px=float(middle[1])))
                boxes = np.vstack([boxes, middle])
                labelled.add(id(edge))
                break
    return placed


def _sides(edge: EdgeMeasurement, size: FloatArray) -> list[FloatArray]:
    """Middles of a label on either side of an edge's middle, clear of the edge."""
    normal = np.array([np.cos(edge.normal_rad), np.sin(edge.normal_rad)])
    away = _AWAY * float(np.abs(normal) @ size)
    middle = np.array([edge.x_px, edge.y_px])
    return [middle + away * normal, middle - away * normal]
