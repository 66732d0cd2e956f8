"""MTF50 over the field of view, meridional and sagittal, and lateral colour over it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from analysis.reports.page import (
    ReportFigure,
    ReportSection,
    ReportTable,
    in_report_style,
    new_figure,
)
from analysis.reports.psf.plots import FEWEST_DRAWN
from calibration.edges import EdgeMeasurement
from calibration.psf import PsfCalibration
from calibration.sharpness import (
    NORMAL_95,
    Direction,
    edge_name,
    position_in_field,
    reported_mtf50,
    with_reach,
)
from simulation.arrays import FloatArray
from simulation.palette import BLUE, INK, POINTS, VERMILION

_DIRECTIONS: tuple[tuple[Direction, str], ...] = (
    ("meridional", BLUE),
    ("sagittal", VERMILION),
)
_MARKERS = {"meridional": "o", "sagittal": "^"}
_TICK_SHARE = 0.02  # of the frame's width: half the stroke along an edge
_MANY = 300
_RINGS = 6
_OUTLIER_QUARTILES = 3.0  # between the quartiles lie 1.35 sigma of Gaussian scatter
_LEAST_SCALE = 0.02  # of the median: finer differences are not worth a colour
_FEWEST_IN_RING = 3
_COLOUR_TITLE = "Lateral colour"
_COLOURS = (("red", "#c0392b"), ("blue", "#2457c5"))


def field_map_section(psf: PsfCalibration) -> ReportSection | None:
    """Map MTF50 over the frame and against the radius; None for few edges off the centre."""
    width, height = psf.picture_width_px, psf.picture_height_px
    if width is None or height is None:
        return None
    edges = [
        edge
        for edge in psf.edges_used
        if position_in_field(edge, width, height).direction is not None
    ]
    if len(edges) < FEWEST_DRAWN:
        return None
    return ReportSection(
        title="MTF50 over the field",
        text=(
            "Meridional is the resolution along the radius from the centre of the frame (of edges "
            "whose normal is within 45 degrees of it), sagittal that across it. The optical axis "
            "is taken to be at the centre of the frame.",
        ),
        figures=(
            ReportFigure.of(
                plot_field_map(edges, width, height),
                "MTF50 of every edge at its position; each stroke lies along its edge. Outliers "
                "have the colour of the scale's end.",
            ),
            ReportFigure.of(
                plot_by_radius(edges, width, height),
                "MTF50 against the distance from the centre, 1 at the corners, with 95 % bars; "
                "lines are medians of rings with three edges or more. Outliers stand at the "
                "border.",
            ),
        ),
    )


def _scale(values: FloatArray) -> tuple[float, float]:
    """Ends of a scale that a few outliers do not set."""
    quarter, half, three_quarters = np.percentile(values, [25, 50, 75])
    reach = max(_OUTLIER_QUARTILES * (three_quarters - quarter), _LEAST_SCALE * half)
    low, high = max(values.min(), half - reach), min(values.max(), half + reach)
    return float(low), float(max(high, low + _LEAST_SCALE * half))


@in_report_style
def plot_field_map(edges: Sequence[EdgeMeasurement], width_px: int, height_px: int) -> Figure:
    """Draw the edges over the frame, coloured by MTF50, meridional and sagittal apart."""
    values = np.array([reported_mtf50(edge).cy_per_px for edge in edges])
    low, high = _scale(values)
    by_direction: dict[Direction, list[tuple[EdgeMeasurement, float]]] = {}
    for edge, value in zip(edges, values.tolist(), strict=True):
        direction = position_in_field(edge, width_px, height_px).direction
        if direction is not None:
            by_direction.setdefault(direction, []).append((edge, value))
    drawn = [direction for direction, _ in _DIRECTIONS if direction in by_direction]
    panel_in = 2.8 if len(drawn) > 1 else 4.2
    figure = new_figure(
        1.2 + 3.0 * len(drawn) * panel_in / 2.8, min(panel_in * height_px / width_px, 5.5) + 0.9
    )
    panels = figure.subplots(1, len(drawn), sharex=True, sharey=True, squeeze=False)[0]
    shown: Any = None
    for axes, direction in zip(panels, drawn, strict=True):
        chosen = by_direction[direction]
        for edge, _ in chosen:
            turn = np.deg2rad(edge.angle_deg)
            reach = _TICK_SHARE * width_px * np.array([np.cos(turn), np.sin(turn)])
            axes.plot(
                [edge.x_px - reach[0], edge.x_px + reach[0]],
                [edge.y_px - reach[1], edge.y_px + reach[1]],
                color=POINTS,
                linewidth=0.8,
                zorder=1,
            )
        shown = axes.scatter(
            [edge.x_px for edge, _ in chosen],
            [edge.y_px for edge, _ in chosen],
            c=[value for _, value in chosen],
            vmin=low,
            vmax=high,
            cmap="viridis",
            s=22 if len(chosen) < _MANY else 9,
            zorder=2,
        )
        axes.plot((width_px - 1) / 2, (height_px - 1) / 2, "+", color=INK, markersize=9)
        axes.set(
            title=f"{direction}, {len(chosen)} edges",
            xlim=(-0.5, width_px - 0.5),
            ylim=(height_px - 0.5, -0.5),
            aspect="equal",
            xlabel="x / px",
        )
    panels[0].set_ylabel("y / px")
    bar = figure.colorbar(shown, ax=list(panels), extend="both")
    bar.set_label("MTF50 / (cy/px)")
    return figure


@in_report_style
def plot_by_radius(edges: Sequence[EdgeMeasurement], width_px: int, height_px: int) -> Figure:
    """Draw MTF50 against the distance from the centre in half diagonals."""
    figure = new_figure(7.2, 3.0)
    axes = figure.subplots()
    low, high = _scale(np.array([reported_mtf50(edge).cy_per_px for edge in edges]))
    for direction, colour in _DIRECTIONS:
        points = []
        for edge in edges:
            at = position_in_field(edge, width_px, height_px)
            if at.direction == direction:
                mtf50 = reported_mtf50(edge)
                points.append((at.radius, mtf50.cy_per_px, mtf50.reach_95_cy_per_px or 0.0))
        if not points:
            continue
        radius, value, reach = np.array(points).T
        axes.errorbar(
            radius,
            np.clip(value, low, high),
            yerr=reach,
            fmt=_MARKERS[direction],
            markersize=3.5,
            linewidth=0.7,
            color=colour,
            alpha=0.55,
            label=direction,
        )
        ring = np.minimum((radius * _RINGS).astype(int), _RINGS - 1)
        kept = [k for k in range(_RINGS) if np.count_nonzero(ring == k) >= _FEWEST_IN_RING]
        axes.plot(
            [np.median(radius[ring == k]) for k in kept],
            [np.median(value[ring == k]) for k in kept],
            color=colour,
            linewidth=1.8,
        )
    # An edge that is hardly known must not set the scale.
    room = 0.1 * (high - low) + 0.01 * high
    axes.set(
        xlim=(0, 1),
        ylim=(max(low - room, 0.0), high + room),
        xlabel="distance from the centre / half diagonal",
        ylabel="MTF50 / (cy/px)",
    )
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def lateral_colour_section(psf: PsfCalibration) -> ReportSection | None:
    """Show the shifts of red and blue from green; None for photographs without colours."""
    width, height = psf.picture_width_px, psf.picture_height_px
    edges = [edge for edge in psf.edges_used if edge.red_shift_px is not None]
    if not edges or width is None or height is None:
        return None
    text = (
        "The same edge, fitted in red, green and blue: how far red and blue stand from green along "
        "its normal, positive away from the centre of the frame.",
    )
    most_red = max(edges, key=lambda edge: abs(edge.red_shift_px or 0.0))
    most_blue = max(edges, key=lambda edge: abs(edge.blue_shift_px or 0.0))
    shown = [most_red] if most_red is most_blue else [most_red, most_blue]
    if len(edges) < FEWEST_DRAWN:
        return ReportSection(
            title=_COLOUR_TITLE, text=text, tables=(_shifts_table(psf, edges, ""),)
        )
    return ReportSection(
        title=_COLOUR_TITLE,
        text=text,
        tables=(_shifts_table(psf, shown, "The largest shifts of red and of blue."),),
        figures=(
            ReportFigure.of(
                plot_lateral_colour(edges, width, height),
                "Shift of red and blue from green across each edge, with 95 % bars, against the "
                "part of the radius that lies along the edge's normal: lateral colour that grows "
                "with the radius is a straight line through 0.",
            ),
        ),
    )


def _shifts_table(
    psf: PsfCalibration, edges: Sequence[EdgeMeasurement], caption: str
) -> ReportTable:
    has_image = len({edge.image for edge in psf.edges}) > 1
    rows = tuple(
        (
            edge_name(edge, has_image=has_image),
            *(_shift(edge, colour) for colour, _ in _COLOURS),
        )
        for edge in edges
    )
    columns = ("edge", "red from green / px", "blue from green / px")
    return ReportTable(columns=columns, rows=rows, caption=caption)


def _shift(edge: EdgeMeasurement, colour: str) -> str:
    shift: float | None = getattr(edge, f"{colour}_shift_px")
    err: float | None = getattr(edge, f"{colour}_shift_err_px")
    return "" if shift is None else with_reach(shift, None if err is None else NORMAL_95 * err, 3)


@in_report_style
def plot_lateral_colour(edges: Sequence[EdgeMeasurement], width_px: int, height_px: int) -> Figure:
    """Draw the shifts of red and blue against the radius along the edges' normals."""
    figure = new_figure(7.2, 2.9)
    axes = figure.subplots()
    along = [_radius_along_normal(edge, width_px, height_px) for edge in edges]
    for colour, ink in _COLOURS:
        axes.errorbar(
            along,
            [getattr(edge, f"{colour}_shift_px") for edge in edges],
            yerr=[NORMAL_95 * getattr(edge, f"{colour}_shift_err_px") for edge in edges],
            fmt="o" if colour == "red" else "s",
            markersize=3.5,
            linewidth=0.8,
            color=ink,
            label=f"{colour} from green",
        )
    axes.axhline(0, color=INK, linewidth=0.6)
    axes.set(
        xlabel="distance from the centre along the normal / px",
        ylabel="shift / px",
        xlim=(0, None),
    )
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def _radius_along_normal(edge: EdgeMeasurement, width_px: int, height_px: int) -> float:
    right, down = edge.x_px - (width_px - 1) / 2, edge.y_px - (height_px - 1) / 2
    return float(abs(right * np.cos(edge.normal_rad) + down * np.sin(edge.normal_rad)))
