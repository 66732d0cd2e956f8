"""What the pages show of live measurements and focus sweeps, as plain JSON objects."""

import math
from typing import Any

from calibration.geometry import Levelling
from calibration.sharpness import NORMAL_95
from standoff.console.devices import EdgeReading, SharpnessView, SquarenessView
from standoff.console.jobs import SweepView

Document = dict[str, Any]

SIDES = "sides as in the picture"


def measure_document(view: SharpnessView, square: SquarenessView, *, has_field: bool) -> Document:
    """The edge under the region, the four regions and the squareness."""
    return {
        "type": "measure",
        "rate": f"{view.rate_hz:.1f}",
        "edge": None if view.edge is None else _edge(view.edge),
        "why_not": view.why_not,
        "is_awaited": view.is_awaited,
        "has_field": has_field,
        "field": [
            {
                "name": each.name,
                "region": [
                    each.region.x_px,
                    each.region.y_px,
                    each.region.width_px,
                    each.region.height_px,
                ],
                "percent": f"{each.percent_of_peak:.1f}" if each.has_detail else "–",
                "why_not": "" if each.has_detail else "no edge",
                "sigma": "–" if each.edge is None else f"{each.edge.sigma_px:.3f}",
            }
            for each in view.field
        ],
        "square": {
            "is_wanted": square.is_wanted,
            "why_not": square.why_not,
            **_levelling(square.levelling),
        },
    }


def sweep_document(view: SweepView) -> Document:
    """The focus sweep: its points, its curve and what was found."""
    peak = view.peak
    return {
        "type": "sweep",
        "state": view.state,
        "message": view.message,
        "progress": f"{view.taken} of {view.planned}" if view.state == "running" else "",
        "points": [
            [_short(point.height_mm), _short(point.value), _short(point.err)]
            for point in view.points
        ],
        "curve": [[_short(height), _short(value)] for height, value in view.curve()],
        "peak_mm": None if peak is None else round(peak.height_mm, 3),
        "peak_err_mm": None if peak is None else _short(peak.err_mm),
        **_levelling(view.levelling),
        "advice": view.advice,
    }


def _edge(edge: EdgeReading) -> Document:
    lp_per_mm = edge.mtf50_lp_per_mm
    return {
        "sigma": with_error(edge.sigma_px, edge.sigma_err_px),
        "mtf50": with_error(edge.mtf50_cy_per_px, edge.mtf50_err_cy_per_px),
        "mtf50_lp": (
            "–"
            if lp_per_mm is None
            else with_error(
                lp_per_mm,
                None
                if edge.mtf50_err_cy_per_px is None
                else edge.mtf50_err_cy_per_px * lp_per_mm / edge.mtf50_cy_per_px,
            )
        ),
        "angle": f"{edge.angle_deg:.1f}",
        "edges": edge.edges,
        "remarks": ", ".join(flag.replace("_", " ") for flag in edge.flags),
        "distance": [_short(value) for value in edge.distance_px.tolist()],
        "levels": [_short(value) for value in edge.levels.tolist()],
    }


def _levelling(found: Levelling | None) -> Document:
    if found is None:
        return {"advice": "", "tilt": ""}
    right = with_error(found.right_deg, found.right_err_deg)
    down = with_error(found.down_deg, found.down_err_deg)
    return {
        "advice": found.advice if found.advice == "level" else f"{found.advice} ({SIDES})",
        "tilt": f"left to right {right}°, top to bottom {down}°",
    }


def with_error(value: float, err: float | None) -> str:
    """A value with half its 95 % interval, to two digits of that: ``0.5831 ± 0.0027``."""
    if err is None or not math.isfinite(err) or err <= 0:
        return f"{value:.4g}"
    half = NORMAL_95 * err
    digits = max(0, 1 - math.floor(math.log10(half)))
    return f"{value:.{digits}f} ± {half:.{digits}f}"


def _short(value: float) -> float:
    return float(f"{value:.6g}")
