"""At what scale each capture shows the target, relative to the nearest one."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calibration.edges import EdgeMeasurement
from calibration.psf.repeatability import capture_of
from simulation.arrays import FloatArray
from simulation.compiled import compiled

ScaleSource = Literal["heights", "sides"]

_SAME_SCALE = 0.02
_SAME_DIRECTION_DEG, _SAME_LENGTH = 4.0, 0.15
# Of the length that was measured, which ends before the corners: by so much more, in px.
_LEAST_APART, _MOST_APART, _CORNERS_PX = 0.9, 1.2, 12.0
_PUPIL_ERR_MM = 30.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CaptureScales:
    """Relative scale of the target in the capture of each edge; shape ``(edges,)``.

    ``sides_px`` are the sides of squares, None where the scales are those of the heights;
    ``height_mm`` is None where they are not known.
    """

    source: ScaleSource
    height_mm: FloatArray | None
    sides_px: FloatArray | None

    @property
    def has_pupil(self) -> bool:
        """Whether the scales depend on the distance of the entrance pupil."""
        return self.sides_px is None

    @property
    def pupil_precision(self) -> float:
        """Inverse variance of the distance from the height's zero to the entrance pupil."""
        return _PUPIL_ERR_MM**-2

    def relative(self, pupil_mm: float) -> FloatArray:
        """Scale of each edge over that of the nearest capture."""
        if self.sides_px is not None:
            return np.asarray(self.sides_px / self.sides_px.max())
        assert self.height_mm is not None
        away_mm = self.height_mm + pupil_mm
        return np.asarray(away_mm.min() / away_mm)

    def slope_per_mm(self, pupil_mm: float) -> FloatArray:
        """Derivative of the squared scale by the distance of the pupil."""
        if self.sides_px is not None:
            return np.zeros_like(self.sides_px)
        assert self.height_mm is not None
        away_mm = self.height_mm + pupil_mm
        nearest_mm = away_mm.min()
        return np.asarray(2 * nearest_mm * (away_mm - nearest_mm) / away_mm**3)

    @property
    def distinct(self) -> int:
        """Number of scales that differ by more than a few per cent."""
        scales = np.sort(np.log(self.relative(0.0)))
        return 1 + int(np.count_nonzero(np.diff(np.unique(scales)) > _SAME_SCALE))


def capture_scales(edges: Sequence[EdgeMeasurement]) -> CaptureScales | None:
    """Return the scales of the captures: by the squares they show, or by their heights.

    Sides tell a scale without the distance of the entrance pupil; where heights are known as well,
    they count if they shrink with the height as in a pinhole, and are then those of one square.

    Returns
    -------
    CaptureScales or None
        None where a capture has neither a height nor two sides that face each other.
    """
    heights = [edge.height_mm for edge in edges if edge.height_mm is not None]
    is_known = len(heights) == len(edges) and min(heights, default=0.0) > 0
    height_mm = np.array(heights) if is_known else None
    sides_px = _sides_px(edges)
    if sides_px is not None and (height_mm is None or _is_pinhole(height_mm, sides_px)):
        return CaptureScales(source="sides", height_mm=height_mm, sides_px=sides_px)
    if height_mm is None:
        return None
    return CaptureScales(source="heights", height_mm=height_mm, sides_px=None)


def _is_pinhole(height_mm: FloatArray, sides_px: FloatArray) -> bool:
    """Whether the side is inversely proportional to the distance from some point."""
    if np.ptp(height_mm) == 0:
        return False
    design = np.column_stack([height_mm, np.ones_like(height_mm)]) * sides_px[:, None]
    values = np.linalg.lstsq(design, np.ones_like(height_mm), rcond=None)[0]
    return bool(np.abs(design @ values - 1).max() < _SAME_SCALE)


def _sides_px(edges: Sequence[EdgeMeasurement]) -> FloatArray | None:
    captures: dict[Hashable, list[EdgeMeasurement]] = {}
    for edge in edges:
        captures.setdefault(capture_of(edge), []).append(edge)
    sides = {key: side_px(some) for key, some in captures.items()}
    known = [sides[capture_of(edge)] for edge in edges]
    if any(side is None for side in known):
        return None
    return np.array(known, dtype=np.float64)


def side_px(edges: Sequence[EdgeMeasurement]) -> float | None:
    """Median distance between sides of a square that face each other; None for no such sides."""
    values = [(edge.angle_deg + 90.0, edge.x_px, edge.y_px, edge.length_px) for edge in edges]
    known = _facing_px(np.array(values, dtype=np.float64).reshape(-1, 4))
    return float(np.median(known)) if known.size else None


@compiled()
def _facing_px(edges: FloatArray) -> FloatArray:
    """Distances between sides that face each other; rows of normal in degrees, x, y and length."""
    apart_px = np.empty(len(edges) * (len(edges) - 1) // 2)
    count = 0
    for i in range(len(edges)):
        normal_deg, x_px, y_px, length_px = edges[i]
        for j in range(i + 1, len(edges)):
            turn_deg = (normal_deg - edges[j, 0] + 90.0) % 180.0 - 90.0
            mean_px = 0.5 * (length_px + edges[j, 3])
            if abs(turn_deg) > _SAME_DIRECTION_DEG:
                continue
            if abs(length_px - edges[j, 3]) > _SAME_LENGTH * mean_px:
                continue
            normal_rad = np.deg2rad(normal_deg - 0.5 * turn_deg)
            dx, dy = x_px - edges[j, 1], y_px - edges[j, 2]
            apart = abs(dx * np.cos(normal_rad) + dy * np.sin(normal_rad))
            aside = abs(dy * np.cos(normal_rad) - dx * np.sin(normal_rad))
            if aside >= 0.5 * mean_px:
                continue
            if _LEAST_APART * mean_px < apart < _MOST_APART * mean_px + _CORNERS_PX:
                apart_px[count] = apart
                count += 1
    return apart_px[:count]
