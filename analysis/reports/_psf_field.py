"""Figures of a PSF: its transfer functions, its change over the frame and with height."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.reports._page import (
    ReportFigure,
    ReportSection,
    ReportTable,
    in_report_style,
    new_figure,
    new_plot,
)
from analysis.reports._psf_edges import plot_widths_by_angle
from calibration.edges import REJECTING_FLAGS, EdgeMeasurement
from calibration.errors import PsfFileError
from calibration.estimate import NORMAL_95, with_reach
from calibration.lens import LateralColourField, lateral_fields
from calibration.psf import (
    ORIENTATION_COLOURS,
    HeightTrend,
    PsfCalibration,
    Transfer2d,
    draw_mtf,
    draw_transfer_2d,
)
from calibration.sharpness import Direction, Picture, edge_name, position_in_field, reported_mtf50
from simulation.arrays import FloatArray
from simulation.palette import BLUE, INK, POINTS, VERMILION
from simulation.psf import PsfField

_FEWEST_DRAWN = 6
"""Fewer edges are told by a table, and by their labels on the photograph."""

_AXES = (("x", "vertical"), ("y", "horizontal"))
_MAP_POINTS = 61
_ELLIPSES = 5
_TRANSFER_ROOM = 0.08
_LEGEND_DASHES = 4.5  # letters wide: a whole period of the longest dashes
_ARROW_IN = 0.45  # long, the arrow of reference
_ELLIPSE_SHARE = 0.055  # of the frame's width, for the widest one


@in_report_style
def plot_mtf(psf: PsfCalibration) -> Figure | None:
    """Plot the contrast by frequency along x and y; None where it is not known."""
    figure, axes = new_plot(6.4, 3.4)
    return figure if draw_mtf(axes, psf) else None


@in_report_style
def plot_transfer_2d(transfer: Transfer2d) -> Figure:
    """Plot the transfer along x, y and both diagonals, with the 95 % band.

    The band of a direction that no edge tells leaves the figure: it does not set the scale.
    """
    figure, axes = new_plot(6.4, 3.4)
    draw_transfer_2d(axes, transfer)
    lowest = min(float(np.min(line.get_ydata())) for line in axes.lines)
    axes.set_ylim(lowest - _TRANSFER_ROOM, 1 + _TRANSFER_ROOM)
    axes.legend(fontsize=8, handlelength=_LEGEND_DASHES)
    return figure


@in_report_style
def plot_field(psf: PsfCalibration, field: PsfField) -> Figure:
    """Map the width over the frame, with the PSF's shape at points from centre to corner."""
    width, height = field.width_px, field.height_px
    x, y = np.linspace(0, width - 1, _MAP_POINTS), np.linspace(0, height - 1, _MAP_POINTS)
    covariance = field.covariance_px2(x[None, :], y[:, None])
    mean_width = np.linalg.det(covariance) ** 0.25
    figure, axes = new_plot(6.4, 6.4 * height / width * 0.8 + 0.6)
    shown = axes.imshow(
        mean_width,
        extent=(-0.5, width - 0.5, height - 0.5, -0.5),
        cmap="cividis",
        interpolation="bilinear",
    )
    bar = figure.colorbar(shown, ax=axes, shrink=0.9)
    bar.set_label("total sigma, geometric mean / px")
    scale = _ELLIPSE_SHARE * width / float(np.sqrt(np.linalg.eigvalsh(covariance).max()))
    turn = np.linspace(0, 2 * np.pi, 60)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    for centre_y in np.linspace(0.08, 0.92, _ELLIPSES) * (height - 1):
        for centre_x in np.linspace(0.08, 0.92, _ELLIPSES) * (width - 1):
            values, vectors = np.linalg.eigh(field.covariance_px2(centre_x, centre_y))
            outline = vectors @ (np.sqrt(values)[:, None] * circle)
            axes.plot(
                centre_x + scale * outline[0],
                centre_y + scale * outline[1],
                color="white",
                linewidth=1.0,
            )
    used = [(edge.x_px, edge.y_px) for edge in psf.edges]
    if used:
        positions = np.array(used).T
        axes.plot(*positions, ".", color=VERMILION, markersize=3)
    axes.set(xlabel="x / px", ylabel="y / px", xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    axes.grid(visible=False)
    return figure


@in_report_style
def plot_heights(psf: PsfCalibration, rejected: frozenset[str]) -> Figure | None:
    """Plot the width across every edge by height, and the trend; None for one height only."""
    edges = [
        edge for edge in psf.edges if not rejected & set(edge.flags) and edge.height_mm is not None
    ]
    if len({edge.height_mm for edge in edges}) < 2:
        return None
    trend = psf.height_trend
    figure = new_figure(6.4, 5.0 if trend else 3.2)
    panels: Any = figure.subplots(2 if trend else 1, 1, sharex=True, squeeze=False)[:, 0]
    _draw_edges_by_height(panels[0], edges)
    if trend is not None:
        _draw_trend(panels[1], trend)
    panels[-1].set(xlabel="camera height / mm")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _draw_edges_by_height(axes: Axes, edges: Sequence[EdgeMeasurement]) -> None:
    heights = [edge.height_mm or 0.0 for edge in edges]
    # Edges of one height stand side by side.
    step_mm = 0.006 * (max(heights) - min(heights))
    for orientation, shift_mm in (
        ("vertical", -step_mm),
        ("diagonal", 0.0),
        ("horizontal", step_mm),
    ):
        chosen = [edge for edge in edges if edge.orientation == orientation]
        if not chosen:
            continue
        axes.errorbar(
            [(edge.height_mm or 0.0) + shift_mm for edge in chosen],
            [edge.sigma_px for edge in chosen],
            yerr=[NORMAL_95 * edge.sigma_err_px for edge in chosen],
            fmt="o",
            markersize=3.5,
            linewidth=0.8,
            color=ORIENTATION_COLOURS[orientation],
            label=orientation,
        )
    widths = [edge.sigma_px for edge in edges]
    room = 0.1 * (max(widths) - min(widths)) + 0.01 * max(widths)
    axes.set(
        ylabel="total sigma across\nthe edge / px", ylim=(min(widths) - room, max(widths) + room)
    )


def _draw_trend(axes: Axes, trend: HeightTrend) -> None:
    heights = np.array([group.height_mm for group in trend.heights])
    widths = np.array([group.relative_width for group in trend.heights])
    errs = np.array([group.relative_width_err for group in trend.heights])
    axes.errorbar(
        heights,
        100 * (widths - 1),
        yerr=196 * errs,
        fmt="s",
        markersize=4,
        color=INK,
        label="all edges at a height, 95 %",
    )
    weight = 1 / errs**2
    middle = np.average(heights, weights=weight)
    line = np.average(widths, weights=weight) + trend.slope_per_mm * (heights - middle)
    axes.plot(
        heights,
        100 * (line - 1),
        color=INK,
        linewidth=1,
        linestyle="--",
        label=f"trend {1e4 * trend.slope_per_mm:+.3f} % per 100 mm",
    )
    axes.axhline(0, color=INK, linewidth=0.6)
    axes.set(ylabel="width deviation\nfrom the mean / %")
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.35 * (high - low))  # room for the legend
    axes.legend(loc="upper center", fontsize=8, ncols=2)


def widths_section(psf: PsfCalibration) -> ReportSection | None:
    """Show the width across every edge by its angle and the height of the camera.

    None for few edges at one height: their widths stand in the table.
    """
    caption = "Width across each edge with its 95 % bar."
    if psf.covariance_px2 is not None:
        caption += " The curves are the fitted covariances."
    is_drawn = len(psf.edges_used) >= _FEWEST_DRAWN
    by_height = plot_heights(psf, REJECTING_FLAGS)
    if not is_drawn and by_height is None:
        return None
    return ReportSection.of(
        "Width by angle" if by_height is None else "Width by angle and height",
        _trend_text(psf.height_trend),
        _heights_table(psf.height_trend),
        ReportFigure.if_drawn(
            plot_widths_by_angle(psf, REJECTING_FLAGS) if is_drawn else None, caption
        ),
        ReportFigure.if_drawn(
            by_height,
            "Width against the height of the camera: every edge, and all edges at a height "
            "relative to the mean of the calibration.",
        ),
    )


def _trend_text(trend: HeightTrend | None) -> str | None:
    if trend is None:
        return None
    p_value = min(trend.p_value, trend.p_value_between)
    if trend.is_drift:
        return (
            f"The width changes with the height (p = {p_value:.2g}): the focus drifts, or the "
            "target is not sharp enough for the nearest height. Calibrate at one height, or "
            "refocus."
        )
    return (
        "The change of the width with the height is not significant, or below 1 % "
        f"(p = {p_value:.2g})."
    )


def _heights_table(trend: HeightTrend | None) -> ReportTable | None:
    if trend is None:
        return None
    return ReportTable.of(
        trend.heights,
        {
            "height / mm": lambda group: f"{group.height_mm:.3f}",
            "edges": lambda group: str(group.edges),
            "median sigma x / px": lambda group: with_err(group.sigma_x_px, group.sigma_x_err_px),
            "median sigma y / px": lambda group: with_err(group.sigma_y_px, group.sigma_y_err_px),
            "deviation from the mean / %": lambda group: (
                f"{100 * (group.relative_width - 1):+.2f} ± {196 * group.relative_width_err:.2f}"
            ),
        },
        "Total widths by height.",
    )


def field_section(psf: PsfCalibration) -> ReportSection | None:
    """Show the PSF from centre to corner; None for a psf.json without edges and field."""
    title = "From centre to corner"
    try:
        field = psf.total_field("psf.json")
    except PsfFileError as error:
        return ReportSection.of(title, f"Left out: {error}.")
    if field is None:
        if len(psf.edges_used) < _FEWEST_DRAWN:
            return None
        why = psf.no_field_because or (
            "there are too few edges over the frame to determine one (at "
            "least 36 in several directions), or the PSF does not change significantly"
        )
        return ReportSection.of(title, f"No PSF field: {why}.")
    width, height = field.width_px, field.height_px
    positions = (
        ("centre", (width - 1) / 2, (height - 1) / 2),
        ("top left", 0.0, 0.0),
        ("top right", width - 1.0, 0.0),
        ("bottom left", 0.0, height - 1.0),
        ("bottom right", width - 1.0, height - 1.0),
    )
    rows = []
    for name, x, y in positions:
        (xx, xy), (_, yy) = field.covariance_px2(x, y).tolist()
        rows.append((name, f"{xx**0.5:.4f}", f"{yy**0.5:.4f}", f"{xy / (xx * yy) ** 0.5:+.3f}"))
    stored = psf.field
    sure = ""
    if stored is not None and stored.worst_err is not None and stored.p_value is not None:
        sure = (
            f" An F-test prefers it to one PSF for the frame (p = {stored.p_value:.1g}); every "
            f"width in the frame is known to ± {100 * NORMAL_95 * stored.worst_err:.1f} % or "
            "better."
        )
    columns = ("position", "total sigma x / px", "total sigma y / px", "rho")
    return ReportSection.of(
        title,
        f"Each element of the covariance is a quadratic polynomial over the frame.{sure}",
        ReportTable(columns=columns, rows=tuple(rows)),
        ReportFigure.of(
            plot_field(psf, field),
            "Total width over the frame. Ellipses: local shape of the PSF, enlarged, all to "
            "one scale. Dots: positions of the edges.",
        ),
    )


def with_err(value: float | None, err: float | None) -> str:
    """Format a value with half its 95 % interval; empty if it or its error is missing."""
    return "" if value is None or err is None else with_reach(value, NORMAL_95 * err, 4)


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
    if len(edges) < _FEWEST_DRAWN:
        return None
    return ReportSection.of(
        "MTF50 over the field",
        "Meridional is the resolution along the radius from the centre of the frame (of edges "
        "whose normal is within 45 degrees of it), sagittal that across it. The optical axis "
        "is taken to be at the centre of the frame.",
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
    figure, axes = new_plot(7.2, 3.0)
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
    most_red = max(edges, key=lambda edge: abs(edge.red_shift_px or 0.0))
    most_blue = max(edges, key=lambda edge: abs(edge.blue_shift_px or 0.0))
    largest = [most_red] if most_red is most_blue else [most_red, most_blue]
    is_few = len(edges) < _FEWEST_DRAWN
    fields = lateral_fields(
        psf.edges_used, Picture(width_px=width, height_px=height, pixel_pitch_um=psf.pixel_pitch_um)
    )
    has_image = len({edge.image for edge in psf.edges}) > 1
    return ReportSection.of(
        "Lateral colour",
        "Each edge was fitted in red, green and blue: how far red and blue are shifted from green "
        "along its normal, positive away from the centre of the frame.",
        ReportTable.of(
            edges if is_few else largest,
            {
                "edge": lambda edge: edge_name(edge, has_image=has_image),
                "red from green / px": lambda edge: _shift(edge, "red"),
                "blue from green / px": lambda edge: _shift(edge, "blue"),
            },
            "" if is_few else "The largest shifts of red and of blue.",
        ),
        ReportFigure.if_drawn(
            None if is_few or fields else plot_lateral_colour(edges, width, height),
            "Shift of red and blue from green across each edge, with 95 % bars, against the "
            "part of the radius that lies along the edge's normal: lateral colour that grows "
            "with the radius is a straight line through 0.",
        ),
        *(field.sentence for field in fields),
        ReportFigure.of(
            plot_lateral_map(fields, edges, psf),
            "Shift of red and blue from green over the field: an image of another size, decentred, "
            "with a part of third order, fitted to all edges (dots). Arrows are enlarged; a cross "
            "marks the worst point.",
        )
        if fields
        else None,
    )


def _shift(edge: EdgeMeasurement, colour: str) -> str:
    shift: float | None = getattr(edge, f"{colour}_shift_px")
    err: float | None = getattr(edge, f"{colour}_shift_err_px")
    return "" if shift is None else with_reach(shift, None if err is None else NORMAL_95 * err, 3)


@in_report_style
def plot_lateral_colour(edges: Sequence[EdgeMeasurement], width_px: int, height_px: int) -> Figure:
    """Draw the shifts of red and blue against the radius along the edges' normals."""
    figure, axes = new_plot(7.2, 2.9)
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
        xlabel="distance from the centre along the normal / px", ylabel="shift / px", xlim=(0, None)
    )
    figure.legend(loc="outside upper center", ncols=2)
    return figure


@in_report_style
def plot_lateral_map(
    fields: Sequence[LateralColourField], edges: Sequence[EdgeMeasurement], psf: PsfCalibration
) -> Figure:
    """Draw the shifts of red and blue over the field as arrows, with a length of reference."""
    figure, axes = new_plot(7.2, 3.0)
    axes.scatter([one.x_px for one in edges], [one.y_px for one in edges], s=3, color=POINTS)
    most = max(field.worst_px.value for field in fields)
    unit_px = float(f"{most:.1g}") or 1.0
    inks = dict(_COLOURS)
    for field in fields:
        drawn = [(one.x_px, one.y_px, one.right_px, one.down_px) for one in field.vectors]
        x, y, right, down = np.array(drawn).T
        arrows = axes.quiver(
            x, y, right, down, color=inks[field.colour], angles="xy", scale_units="inches",
            scale=unit_px / _ARROW_IN, width=0.004, label=f"{field.colour} from green",
        )  # fmt: skip
        axes.plot(field.worst.x_px, field.worst.y_px, "x", color=inks[field.colour], markersize=7)
    said = f"{unit_px:g} px"
    if psf.pixel_pitch_um is not None:
        said += f" = {unit_px * psf.pixel_pitch_um:.2g} um"
    axes.quiverkey(arrows, 0.86, 1.05, unit_px, said, labelpos="E", color=INK)
    width, height = psf.picture_width_px or 1, psf.picture_height_px or 1
    axes.plot([0, width, width, 0, 0], [0, 0, height, height, 0], color=POINTS, linewidth=0.8)
    room = 0.1 * max(width, height)  # for arrows at the border
    axes.set(
        xlabel="x / px", ylabel="y / px", aspect="equal",
        xlim=(-room, width + room), ylim=(height + room, -room),
    )  # fmt: skip
    figure.legend(loc="outside upper left", ncols=2)
    return figure


def _radius_along_normal(edge: EdgeMeasurement, width_px: int, height_px: int) -> float:
    right, down = edge.x_px - (width_px - 1) / 2, edge.y_px - (height_px - 1) / 2
    return float(abs(right * np.cos(edge.normal_rad) + down * np.sin(edge.normal_rad)))
