"""Figures of a PSF: its transfer functions, its change over the frame and with height."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.reports.page import (
    ReportFigure,
    ReportSection,
    ReportTable,
    in_report_style,
    new_figure,
)
from analysis.reports.psf.edge_plots import plot_widths_by_angle
from calibration.edges import REJECTING_FLAGS, EdgeMeasurement
from calibration.errors import PsfFileError
from calibration.psf import (
    ORIENTATION_COLOURS,
    HeightTrend,
    PsfCalibration,
    Transfer2d,
    draw_mtf,
    draw_transfer_2d,
)
from calibration.sharpness import NORMAL_95, with_reach
from simulation.psf import PsfField

FEWEST_DRAWN = 6
"""Fewer edges are told by a table, and by their labels on the photograph."""

_INK = "#1b1f24"
_AXES = (("x", "vertical"), ("y", "horizontal"))
_MAP_POINTS = 61
_ELLIPSES = 5
_TRANSFER_ROOM = 0.08
_LEGEND_DASHES = 4.5  # letters wide: a whole period of the longest dashes
_ELLIPSE_SHARE = 0.055  # of the frame's width, for the widest one


@in_report_style
def plot_mtf(psf: PsfCalibration) -> Figure | None:
    """Plot the contrast by frequency along x and y; None where it is not known."""
    figure = new_figure(6.4, 3.4)
    return figure if draw_mtf(figure.subplots(), psf) else None


@in_report_style
def plot_transfer_2d(transfer: Transfer2d) -> Figure:
    """Plot the transfer along x, y and both diagonals, with the 95 % band.

    The band of a direction that no edge tells leaves the figure: it does not set the scale.
    """
    figure = new_figure(6.4, 3.4)
    axes = figure.subplots()
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
    figure = new_figure(6.4, 6.4 * height / width * 0.8 + 0.6)
    axes = figure.subplots()
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
        axes.plot(*positions, ".", color="#D55E00", markersize=3)
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
        color=_INK,
        label="all edges at a height, 95 %",
    )
    weight = 1 / errs**2
    middle = np.average(heights, weights=weight)
    line = np.average(widths, weights=weight) + trend.slope_per_mm * (heights - middle)
    axes.plot(
        heights,
        100 * (line - 1),
        color=_INK,
        linewidth=1,
        linestyle="--",
        label=f"trend {1e4 * trend.slope_per_mm:+.3f} % per 100 mm",
    )
    axes.axhline(0, color=_INK, linewidth=0.6)
    axes.set(ylabel="width deviation\nfrom the mean / %")
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.35 * (high - low))  # room for the legend
    axes.legend(loc="upper center", fontsize=8, ncols=2)


def widths_section(psf: PsfCalibration) -> ReportSection | None:
    """Show the width across every edge by its angle and the height of the camera.

    None for few edges at one height: their widths stand in the table.
    """
    figures = []
    if len(psf.edges_used) >= FEWEST_DRAWN:
        caption = "Width across each edge with its 95 % bar."
        if psf.covariance_px2 is not None:
            caption += " The curves are the fitted covariances."
        figures.append(ReportFigure.of(plot_widths_by_angle(psf, REJECTING_FLAGS), caption))
    by_height = plot_heights(psf, REJECTING_FLAGS)
    if by_height is not None:
        figures.append(
            ReportFigure.of(
                by_height,
                "Width against the height of the camera: every edge, and all edges at a height "
                "relative to the mean of the calibration.",
            )
        )
    if not figures:
        return None
    return ReportSection(
        title="Width by angle" if by_height is None else "Width by angle and height",
        text=_trend_text(psf),
        tables=_heights_table(psf),
        figures=tuple(figures),
    )


def _trend_text(psf: PsfCalibration) -> tuple[str, ...]:
    trend = psf.height_trend
    if trend is None:
        return ()
    p_value = min(trend.p_value, trend.p_value_between)
    if trend.is_drift:
        return (
            f"The width changes with the height (p = {p_value:.2g}): the focus drifts, or the "
            "target is not sharp enough for the nearest height. Calibrate at one height, or "
            "refocus.",
        )
    return (
        "The change of the width with the height is not significant, or below 1 % "
        f"(p = {p_value:.2g}).",
    )


def _heights_table(psf: PsfCalibration) -> tuple[ReportTable, ...]:
    if psf.height_trend is None:
        return ()
    rows = tuple(
        (
            f"{group.height_mm:.3f}",
            str(group.edges),
            with_err(group.sigma_x_px, group.sigma_x_err_px),
            with_err(group.sigma_y_px, group.sigma_y_err_px),
            f"{100 * (group.relative_width - 1):+.2f} ± {196 * group.relative_width_err:.2f}",
        )
        for group in psf.height_trend.heights
    )
    columns = (
        "height / mm",
        "edges",
        "median sigma x / px",
        "median sigma y / px",
        "deviation from the mean / %",
    )
    return (ReportTable(columns=columns, rows=rows, caption="Total widths by height."),)


def field_section(psf: PsfCalibration) -> ReportSection | None:
    """Show the PSF from centre to corner; None for a psf.json without edges and field."""
    try:
        field = psf.total_field("psf.json")
    except PsfFileError as error:
        return ReportSection(title="From centre to corner", text=(f"Left out: {error}.",))
    if field is None:
        if len(psf.edges_used) < FEWEST_DRAWN:
            return None
        return ReportSection(
            title="From centre to corner",
            text=(
                f"No PSF field: {psf.no_field_because}."
                if psf.no_field_because
                else "No PSF field: there are too few edges over the frame to determine one (at "
                "least 36 in several directions), or the PSF does not change significantly.",
            ),
        )
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
    return ReportSection(
        title="From centre to corner",
        text=("Each element of the covariance is a quadratic polynomial over the frame." + sure,),
        tables=(
            ReportTable(
                columns=("position", "total sigma x / px", "total sigma y / px", "rho"),
                rows=tuple(rows),
            ),
        ),
        figures=(
            ReportFigure.of(
                plot_field(psf, field),
                "Total width over the frame. Ellipses: local shape of the PSF, enlarged, all to "
                "one scale. Dots: positions of the edges.",
            ),
        ),
    )


def with_err(value: float | None, err: float | None) -> str:
    """Format a value with half its 95 % interval; empty if it or its error is missing."""
    return "" if value is None or err is None else with_reach(value, NORMAL_95 * err, 4)
