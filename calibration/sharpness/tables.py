"""Measured edges and verdicts as cells of tables, for the terminal and for reports.

Every ± is half a 95 % interval.
"""

from collections.abc import Sequence
from math import floor, log10
from pathlib import PurePath
from typing import Any

from calibration.edges import EdgeMeasurement
from calibration.sharpness.resolution import (
    NORMAL_95,
    lp_per_mm,
    lw_per_ph,
    picture_height_px,
    reported_mtf50,
)
from calibration.sharpness.verdict import LimitVerdict, SharpnessVerdict

MODEL_REMARK = "* of the fitted Gaussian, where an edge has no e-SFR with an error"
_DIGITS = {"cy/px": 4, "LW/PH": 1, "lp/mm": 2, "px": 4, "": 3}

_DIGITS_MOST = 6

Cells = tuple[str, ...]


def edge_cells(
    edges: Sequence[EdgeMeasurement], pixel_pitch_um: float | None, *, has_image: bool
) -> tuple[Cells, tuple[Cells, ...]]:
    """Return columns and rows of a table of edges: position, MTF50 in every unit, and widths.

    Parameters
    ----------
    edges
        In the order of the rows.
    pixel_pitch_um
        Without it there are no line pairs per mm.
    has_image
        Whether a row begins with the name of the photograph.
    """
    columns = ["edge", "MTF50 / (cy/px)", "MTF50 / (LW/PH)"]
    columns += [] if pixel_pitch_um is None else ["MTF50 / (lp/mm)"]
    columns += ["sigma / px", "optical sigma / px"]
    return tuple(columns), tuple(_cells(edge, pixel_pitch_um, has_image) for edge in edges)


def _cells(edge: EdgeMeasurement, pixel_pitch_um: float | None, has_image: bool) -> Cells:
    known = reported_mtf50(edge)
    value, reach = known.cy_per_px, known.reach_95_cy_per_px
    factors = [(1.0, "cy/px"), (lw_per_ph(1.0, picture_height_px(edge) or 0.0), "LW/PH")]
    if pixel_pitch_um is not None:
        factors.append((lp_per_mm(1.0, pixel_pitch_um), "lp/mm"))
    cells = [
        with_reach(factor * value, None if reach is None else factor * reach, _DIGITS[unit])
        if factor
        else ""
        for factor, unit in factors
    ]
    cells[0] += "" if known.is_model_free else " *"
    optical, err = edge.optical_sigma_px, edge.optical_sigma_err_px
    return (
        edge_name(edge, has_image=has_image),
        *cells,
        with_reach(edge.sigma_px, NORMAL_95 * edge.sigma_err_px, 4),
        "not resolved"
        if optical is None
        else with_reach(optical, None if err is None else NORMAL_95 * err, 4),
    )


def edge_name(edge: EdgeMeasurement, *, has_image: bool) -> str:
    """Return a short name of an edge: its position, and its photograph where there are several."""
    place = f"({edge.x_px:.0f}, {edge.y_px:.0f}), {edge.angle_deg:.1f}°"
    return f"{PurePath(edge.image).name} {place}" if has_image else place


def with_reach(value: float, reach_95: float | None, digits: int) -> str:
    """Format a value with half its 95 % interval, in so many digits that the half is not 0."""
    if reach_95 is None:
        return f"{value:.{digits}f}"
    if 0 < reach_95 < 10.0**-digits:
        digits = min(-floor(log10(reach_95)), _DIGITS_MOST)
    return f"{value:.{digits}f} ± {reach_95:.{digits}f}"


VERDICT_COLUMNS = ("limit", "allowed", "measured", "95 % interval", "verdict", "where, or why not")


def verdict_rows(verdict: SharpnessVerdict) -> tuple[Cells, ...]:
    """Return the limits as rows under ``VERDICT_COLUMNS``; a reason is written out once."""
    first_with: dict[str, str] = {}
    rows = []
    for one in verdict.limits:
        row = _limit_cells(one)
        if one.reason is not None:
            first = first_with.setdefault(one.reason, one.limit)
            row = row if first == one.limit else (*row[:-1], f"as for {first}")
        rows.append(row)
    return tuple(rows)


def _limit_cells(one: LimitVerdict) -> Cells:
    digits = _DIGITS[one.unit]
    allowed = f"{'at least' if one.is_least else 'at most'} {one.bound:g} {one.unit}".rstrip()
    if one.value is None or one.low is None or one.high is None:
        return (one.limit, allowed, "not measured", "", one.outcome, one.reason or "")
    return (
        one.limit,
        allowed,
        f"{one.value:.{digits}f}",
        f"{one.low:.{digits}f} to {one.high:.{digits}f}",
        one.outcome,
        one.where,
    )


_MTF50 = ("mtf50_cy_per_px", "mtf50_err_cy_per_px", "mtf50_lw_per_ph", "mtf50_lp_per_mm")


def edge_row(edge: EdgeMeasurement) -> dict[str, Any]:
    """Return an edge as a line of a table: the entries of psf.json, with MTF50 as it is reported.

    In psf.json ``mtf50_...`` is the fitted Gaussian's. Here it is that of ``reported_mtf50``,
    measured where the edge determines it; ``mtf50_from`` says whether it is of the ``e-SFR`` or of
    the ``gaussian``, whose own stands in ``gaussian_mtf50_...``.
    """
    stored = edge.model_dump()
    is_measured = reported_mtf50(edge).is_model_free
    row: dict[str, Any] = {}
    for name, value in stored.items():
        row[name] = stored[f"esfr_{name}"] if is_measured and name in _MTF50 else value
    row["mtf50_from"] = "e-SFR" if is_measured else "gaussian"
    row |= {f"gaussian_{name}": stored[name] for name in _MTF50}
    return row
