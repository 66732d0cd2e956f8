"""Focus over the field: the part of a lens report that photographs at several positions add."""

from collections.abc import Iterator
from math import atan2, cos, pi

import numpy as np
from matplotlib.figure import Figure

from analysis.reports._page import (
    ReportFigure,
    ReportSection,
    ReportTable,
    in_report_style,
    new_plot,
)
from calibration.estimate import NORMAL_95
from calibration.lens import FocusField, FocusPoint, LensMeasurement, ThroughFocus
from calibration.sharpness import MeasuredValue
from simulation.palette import BLUE, INK, POINTS, VERMILION

_MOVED = {
    "focus": "Positions are those of the focus, as they were given.",
    "height": "Positions are heights of the camera: this is the focus in front of the lens.",
}
_DEPTHS = {"focus": "depth of focus", "height": "depth of field"}
_CURVES = 3
_STEPS = 121


def focus_section(lens: LensMeasurement) -> ReportSection | None:
    """Return the section of photographs at several focus positions; None without them."""
    focus = lens.through_focus
    if focus is None:
        return None
    missing = focus.no_field_because
    return ReportSection.of(
        "Focus over the field",
        f"{len(focus.points)} edges followed through focus, by their contrast at "
        f"{focus.freq_cy_per_px:g} cy/px. {_MOVED[focus.axis]} Tangential: edges across the "
        "radius, sagittal: along it. Curvature: change of the focus from the centre to the "
        "corners, mean of both; astigmatism: tangential less sagittal.",
        None if missing is None else f"No tilt and curvature: {missing}.",
        ReportTable(columns=("", "unit", ""), rows=tuple(_rows(focus))),
        ReportFigure.of(
            _plot_curves(focus, *_size(lens)),
            f"Contrast at {focus.freq_cy_per_px:g} cy/px through focus: the edges nearest to the "
            "centre and to two opposite corners, with 95 % bars and the fitted curves. Dotted: the "
            "contrast that the depth is stated for.",
        ),
        None
        if focus.field is None
        else ReportFigure.of(
            _plot_field(focus, focus.field, *_size(lens)),
            "Best focus by distance from the centre, without the tilt: edges within 22.5 degrees "
            "of either direction with 95 % bars, and the fitted curvatures.",
        ),
    )


def _size(lens: LensMeasurement) -> tuple[int, int]:
    return lens.picture_width_px or 1, lens.picture_height_px or 1


def _rows(focus: ThroughFocus) -> Iterator[tuple[str, str, str]]:
    where = "at the centre" if focus.field is not None else "median of the edges"
    yield f"best focus, {where}", "mm", focus.best_mm.estimate.text(4)
    stated = f"contrast {focus.contrast:g}"
    named = _DEPTHS[focus.axis]
    for label, depth in (
        (f"{named}, {stated}, median of the edges", focus.depth_mm),
        (f"{named} of all edges at once", focus.common_depth_mm),
    ):
        missing = "not within the positions"
        yield label, "mm", missing if depth is None else depth.estimate.text(4)
    if focus.field is not None:
        for label, known in _field_rows(focus.field):
            yield label, "mm", known.estimate.text(4)
        if focus.field.tilt_deg is not None:
            yield "tilt of the sensor", "degrees", focus.field.tilt_deg.estimate.text(3)


def _field_rows(field: FocusField) -> Iterator[tuple[str, MeasuredValue]]:
    yield "field curvature", field.curvature_mm
    yield "tangential, centre to corners", field.tangential_mm
    yield "sagittal, centre to corners", field.sagittal_mm
    yield "astigmatism in the corners", field.astigmatism_mm
    yield "tilt, left to right", field.tilt_x_mm
    yield "tilt, top to bottom", field.tilt_y_mm


@in_report_style
def _plot_curves(focus: ThroughFocus, width_px: int, height_px: int) -> Figure:
    """Plot the contrast through focus of a few edges."""
    figure, axes = new_plot(3.6, 2.6)
    for (name, point), ink in zip(
        _shown(focus.points, width_px, height_px), (INK, VERMILION, BLUE), strict=False
    ):
        axes.errorbar(
            point.positions_mm,
            point.contrasts,
            yerr=[NORMAL_95 * err for err in point.contrast_errs],
            fmt="o",
            markersize=3,
            linewidth=0.8,
            color=ink,
            label=name,
        )
        middle, scale = point.polynomial[:2]
        position = np.linspace(min(point.positions_mm), max(point.positions_mm), 4 * _STEPS)
        curve = point.curve(position)
        # A polynomial means nothing beyond the positions that it was fitted to.
        kept = (curve <= 1.2 * point.contrast.value) & (np.abs(position - middle) <= 2 * scale)
        kept &= (position >= min(point.positions_mm)) & (curve >= 0.1 * point.contrast.value)
        axes.plot(position[kept], curve[kept], color=ink, linewidth=1.2)
    axes.axhline(focus.contrast, color=POINTS, linewidth=0.8, linestyle=":")
    axes.set(xlabel=f"{focus.axis} / mm", ylabel="contrast", ylim=(0, None))
    figure.legend(loc="outside upper center", ncols=_CURVES)
    return figure


def _shown(
    points: tuple[FocusPoint, ...], width_px: int, height_px: int
) -> list[tuple[str, FocusPoint]]:
    """The points nearest to the centre and, of six or more, to two opposite corners."""
    targets = [("centre", 0.5, 0.5), ("top left", 0.0, 0.0), ("bottom right", 1.0, 1.0)]
    if len(points) < 2 * _CURVES:
        targets = targets[:1]
    return [
        (
            name,
            min(
                points,
                key=lambda one: float(
                    np.hypot(one.x_px - share_x * width_px, one.y_px - share_y * height_px)
                ),
            ),
        )
        for name, share_x, share_y in targets
    ]


_NEAR_AXIS_COS = cos(pi / 8)


@in_report_style
def _plot_field(focus: ThroughFocus, field: FocusField, width_px: int, height_px: int) -> Figure:
    """Plot the best focus against the distance from the centre, without the tilt."""
    figure, axes = new_plot(3.6, 2.6)
    groups: dict[str, list[tuple[float, float, float]]] = {"tangential": [], "sagittal": []}
    for point in focus.points:
        right, down = point.x_px - (width_px - 1) / 2, point.y_px - (height_px - 1) / 2
        tilt = field.tilt_x_mm.value * right / width_px + field.tilt_y_mm.value * down / height_px
        turn = abs(cos(point.angle_deg * pi / 180 + pi / 2 - atan2(down, right)))
        name = (
            "tangential" if turn >= _NEAR_AXIS_COS
            else "sagittal" if turn <= np.sqrt(1 - _NEAR_AXIS_COS**2) else None
        )  # fmt: skip
        if name is not None:
            share = 2 * float(np.hypot(right, down) / np.hypot(width_px, height_px))
            groups[name].append((share, point.best_mm.value - tilt, point.best_mm.err))
    radius = np.linspace(0.0, 1.0, _STEPS)
    for (name, found), ink, bend in zip(
        groups.items(), (VERMILION, BLUE), (field.tangential_mm, field.sagittal_mm), strict=True
    ):
        axes.plot(radius, focus.best_mm.value + bend.value * radius**2, color=ink, linewidth=1.2)
        if found:
            at, best, err = np.array(found).T
            axes.errorbar(
                at, best, yerr=NORMAL_95 * err, fmt="o", markersize=3, linewidth=0.8, color=ink,
                label=name,
            )  # fmt: skip
    axes.set(xlabel="distance from the centre / half diagonals", ylabel="best focus / mm")
    figure.legend(loc="outside upper center", ncols=2)
    return figure
