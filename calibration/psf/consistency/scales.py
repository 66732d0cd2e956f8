"""At what scale each capture shows the target, relative to the nearest one."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np

from calibration.edges import EdgeMeasurement
from calibration.psf.repeatability import capture_of
from simulation.arrays import FloatArray

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
    found = [_apart_px(first, second) for first, second in combinations(edges, 2)]
    known = [apart for apart in found if apart is not None]
    return float(np.median(known)) if known else None


def _apart_px(first: EdgeMeasurement, second: EdgeMeasurement) -> float | None:
    turn = (first.angle_deg - second.angle_deg + 90.0) % 180.0 - 90.0
    length_px = 0.5 * (first.length_px + second.length_px)
    if abs(turn) > _SAME_DIRECTION_DEG:
        return None
    if abs(first.length_px - second.length_px) > _SAME_LENGTH * length_px:
        return None
    normal = first.normal_rad - 0.5 * np.deg2rad(turn)
    dx, dy = first.x_px - second.x_px, first.y_px - second.y_px
    apart = abs(float(dx * np.cos(normal) + dy * np.sin(normal)))
    aside = abs(float(dy * np.cos(normal) - dx * np.sin(normal)))
    is_square = _LEAST_APART * length_px < apart < _MOST_APART * length_px + _CORNERS_PX
    return apart if is_square and aside < 0.5 * length_px else None
