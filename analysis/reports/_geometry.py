"""Report sections on the geometry: headline figures, scales, zooms, distortion, squareness."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import PurePath

import numpy as np
from matplotlib.figure import Figure

from analysis.reports._page import (
    ReportFigure,
    ReportSection,
    ReportTable,
    Verdict,
    in_report_style,
    new_figure,
    new_plot,
    number_text,
    present,
)
from calibration.estimate import NORMAL_95, with_reach
from calibration.geometry import (
    CaptureGeometry,
    GeometryCalibration,
    captures_by_target,
    draw_scale_by_height,
    target_colours,
)
from simulation.palette import INK, PALETTE


@in_report_style
def plot_scale_by_height(geometry: GeometryCalibration) -> Figure:
    """Plot every capture's scale against its height, the fit, and the height residuals."""
    figure = new_figure(6.4, 4.2)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.2, 1])
    draw_scale_by_height(upper, geometry)
    for captures, colour in zip(
        captures_by_target(geometry).values(), target_colours(), strict=False
    ):
        own = np.array([c.height_mm for c in captures])
        left = np.array([c.height_residual_mm for c in captures])
        err = [_height_err_mm(geometry, c) for c in captures]
        lower.errorbar(
            own, 1e3 * left, yerr=1e3 * geometry.fit_factor * np.array(err), fmt="o", markersize=4,
            linewidth=0.9, color=colour,
        )  # fmt: skip
    lower.axhline(0, color=INK, linewidth=0.8)
    lower.margins(y=0.25)
    lower.set(xlabel="height read back / mm", ylabel="height read\n− fitted / µm")
    return figure


@in_report_style
def plot_distortion(geometry: GeometryCalibration) -> Figure | None:
    """Plot how far radial distortion moves a point outwards, with its 95 % band."""
    if geometry.k1 is None or geometry.width_px is None or geometry.height_px is None:
        return None
    corner_px = np.hypot(geometry.width_px - 1, geometry.height_px - 1) / 2
    radius = np.linspace(0, 1, 200)
    k2 = geometry.k2 or 0.0
    moved = corner_px * radius**3 * (geometry.k1 + k2 * radius**2)
    by_k1 = corner_px * radius**3 * geometry.k1
    figure, axes = new_plot(6.4, 3.0)
    axes.plot(radius * corner_px, moved, color=PALETTE[0], label="k1 and k2 together")
    axes.plot(radius * corner_px, by_k1, "--", color=INK, linewidth=0.9, label="k1 alone")
    axes.axhline(0, color=INK, linewidth=0.8)
    for share, name in ((geometry.width_px / 2, "side"), (geometry.height_px / 2, "top")):
        axes.axvline(share, color=INK, linewidth=0.8, linestyle=":")
        axes.annotate(
            name, (share, 1.0), xycoords=("data", "axes fraction"), xytext=(3, -9),
            textcoords="offset points", fontsize=8,
        )  # fmt: skip
    axes.set(
        xlim=(0, corner_px),
        xlabel="ideal distance from the principal point / px",
        ylabel="outward displacement / px",
    )
    axes.legend(loc="lower left" if moved[-1] < 0 else "upper left")
    return figure


@in_report_style
def plot_squareness(geometry: GeometryCalibration) -> Figure | None:
    """Plot the tilt of the target to the sensor as a point on a dial, with its 95 % cross."""
    if geometry.tilt_x_deg is None or geometry.tilt_y_deg is None:
        return None
    figure, axes = new_plot(3.6, 3.6)
    x_err, y_err = (
        NORMAL_95 * (e or 0.0) for e in (geometry.tilt_x_err_deg, geometry.tilt_y_err_deg)
    )
    reach = max(
        np.hypot(geometry.tilt_x_deg, geometry.tilt_y_deg) * 1.25, 3 * x_err, 3 * y_err, 0.1
    )
    step = 10 ** np.floor(np.log10(reach))
    rings = [r for r in step * np.array([0.2, 0.5, 1, 2, 5]) if r <= reach]
    turn = np.linspace(0, 2 * np.pi, 200)
    for ring in rings[-3:]:
        axes.plot(ring * np.cos(turn), ring * np.sin(turn), color=INK, linewidth=0.6, alpha=0.5)
        axes.annotate(
            f"{ring:g}°", (ring * np.sqrt(0.5), ring * np.sqrt(0.5)), fontsize=8, alpha=0.8,
            ha="left", va="top",
        )  # fmt: skip
    axes.errorbar(
        geometry.tilt_x_deg, geometry.tilt_y_deg, xerr=x_err, yerr=y_err, fmt="o",
        color=PALETTE[1], markersize=6,
    )  # fmt: skip
    axes.axhline(0, color=INK, linewidth=0.8)
    axes.axvline(0, color=INK, linewidth=0.8)
    axes.set(
        xlim=(-reach, reach),
        ylim=(reach, -reach),
        aspect="equal",
        xlabel="tilt to the right (+x) / deg",
        ylabel="tilt downwards (+y) / deg",
    )
    axes.grid(visible=False)
    return figure


@in_report_style
def plot_travel(geometry: GeometryCalibration) -> Figure | None:
    """Plot the camera's deviation from the straight line of travel at every height."""
    groups = {n: c for n, c in captures_by_target(geometry).items() if len(c) > 2}
    if not groups:
        return None
    figure, axes = new_plot(6.4, 2.8)
    for (name, captures), colour in zip(groups.items(), target_colours(), strict=False):
        own = [c.height_mm for c in captures]
        for axis, style in ((0, "o-"), (1, "s--")):
            axes.plot(
                own,
                [1e3 * c.sideways_mm[axis] for c in captures],
                style,
                markersize=4,
                linewidth=0.8,
                color=colour,
                label=f"{name}, {'xy'[axis]}",
            )
    axes.axhline(0, color=INK, linewidth=0.8)
    axes.set(xlabel="height read back / mm", ylabel="deviation from line / µm")
    figure.legend(loc="outside upper center", ncols=4, fontsize=8)
    return figure


def _height_err_mm(geometry: GeometryCalibration, capture: CaptureGeometry) -> float:
    if capture.scale_px_per_mm is None or capture.scale_err_px_per_mm is None:
        return 0.0
    relative = capture.scale_err_px_per_mm / capture.scale_px_per_mm
    return relative * (capture.height_mm + geometry.pupil_offset_mm)


_UNKNOWN = "not determined"
_SOURCES = {
    "board": "The scale is based on the size of the board's squares.",
    "given": "The scale is based on the value given for the lowest height.",
    "bench": "The scale is based on the focal length and pixel pitch in the bench file, taken as "
    "exact; with a varifocal lens it is only nominal.",
}


def geometry_verdicts(geometry: GeometryCalibration) -> tuple[Verdict, ...]:
    """Return the headline figures with their 95 % uncertainties."""
    factor, scales = geometry.fit_factor, geometry.scale_px_per_mm
    errs, lowest_mm = geometry.scale_err_px_per_mm, geometry.heights_mm[0]
    pupil = geometry.pupil_offset_mm, _times(factor, geometry.pupil_offset_err_mm)
    scale = scales[0] if scales else None, _times(factor, errs[0] if errs else None)
    tilt = geometry.tilt_deg, _times(NORMAL_95, geometry.tilt_err_deg)
    k1 = _times(100, geometry.k1), _times(100 * NORMAL_95, geometry.k1_err)
    return (
        _verdict("entrance pupil above height 0", *pupil, 3, " mm"),
        _verdict(f"scale at {lowest_mm:g} mm", *scale, 4, " px/mm"),
        _verdict("tilt of target to sensor", *tilt, 3, "°"),
        _verdict("distortion k1 at the corner", *k1, 3, " %"),
    )


def _verdict(
    name: str, value: float | None, reach: float | None, digits: int, unit: str
) -> Verdict:
    remark = ""
    if value is not None and reach is not None:
        remark = f"{with_reach(value, reach, digits)}{unit}"
    return Verdict(name, number_text(value, f".{digits}f", _UNKNOWN, unit), remark)


def geometry_sections(geometry: GeometryCalibration) -> tuple[ReportSection, ...]:
    """Return the sections on the geometry of camera and stage."""
    return present(
        _scale_section(geometry),
        _squareness_section(geometry),
        _distortion_section(geometry),
        _captures_section(geometry),
    )


def _distortion_section(geometry: GeometryCalibration) -> ReportSection | None:
    distortion = plot_distortion(geometry)
    if distortion is None:
        return None
    rows = (
        ("k1, at the image corner", geometry.k1, geometry.k1_err),
        ("k2, at the image corner", geometry.k2, geometry.k2_err),
        ("k1 of OpenCV", geometry.k1_opencv, None),
        ("k2 of OpenCV", geometry.k2_opencv, None),
    )
    return ReportSection.of(
        "Distortion",
        "The ideal radius r, 1 at the image corner, is imaged at "
        "r (1 + k1 r² + k2 r⁴). Negative values are barrel distortion.",
        _values_table((name, value, err, 5) for name, value, err in rows),
        ReportFigure.of(distortion, "Radial displacement of a point from its ideal position."),
    )


def _values_table(rows: Iterable[tuple[str, float | None, float | None, int]]) -> ReportTable:
    """Values, with half their 95 % intervals."""
    return ReportTable.of(
        rows,
        {
            "": lambda row: row[0],
            "value": lambda row: number_text(row[1], f".{row[3]}f", _UNKNOWN),
            "±": lambda row: number_text(_times(NORMAL_95, row[2]), f".{row[3]}f"),
        },
    )


def _scale_section(geometry: GeometryCalibration) -> ReportSection:
    lowest, factor = geometry.heights_mm[0], geometry.fit_factor
    zooms = {z.far_height_mm: z for z in geometry.zooms if z.near_height_mm == lowest}
    nothing = (None,) * len(geometry.heights_mm)
    scales = geometry.scale_px_per_mm or nothing
    errs = geometry.scale_err_px_per_mm or nothing
    source = geometry.scale_source
    return ReportSection.of(
        "Scale and zoom",
        "Pinhole model at the entrance pupil: the scale is the focal length in pixels over the "
        "distance, which is the height plus the pupil's offset.",
        _SOURCES[source] if source else "No length is known, so there is no absolute scale.",
        *(f"{name} is not determined: {why}." for name, why in geometry.undetermined.items()),
        *geometry.notes,
        ReportTable.of(
            zip(geometry.heights_mm, scales, errs, strict=True),
            {
                "height / mm": lambda row: f"{row[0]:g}",
                "scale / (px/mm)": lambda row: number_text(row[1], ".5f", _UNKNOWN),
                "± px/mm": lambda row: number_text(_times(factor, row[2]), ".5f"),
                f"zoom from {lowest:g} mm": lambda row: (
                    f"{zooms[row[0]].zoom:.5f}" if row[0] in zooms else "1"
                ),
                "± zoom": lambda row: (
                    f"{factor * zooms[row[0]].zoom_err:.5f}" if row[0] in zooms else ""
                ),
            },
        ),
        ReportFigure.of(
            plot_scale_by_height(geometry),
            "Scale of every capture, and the height read back minus the one fitted to its "
            "image, with the 95 % interval of the fit.",
        ),
    )


def _squareness_section(geometry: GeometryCalibration) -> ReportSection:
    tilt = geometry.tilt_deg, geometry.tilt_err_deg, 4
    drift = geometry.axis_drift_px_per_mm, geometry.axis_drift_err_px_per_mm, 5
    line_of_sight = geometry.stage_angle_deg, geometry.stage_angle_err_deg, 4
    return ReportSection.of(
        "Squareness",
        _values_table(
            (
                ("tilt of target to sensor / deg", *tilt),
                (f"drift of the axis at {geometry.heights_mm[0]:g} mm / (px/mm)", *drift),
                ("stage travel to line of sight / deg", *line_of_sight),
            )
        ),
        ReportFigure.if_drawn(
            plot_squareness(geometry),
            "Direction in which the optical axis leans, as seen in the image; the cross is "
            "the 95 % interval, the centre is square.",
        ),
        ReportFigure.if_drawn(
            plot_travel(geometry), "Sideways deviation of the camera from straight travel."
        ),
    )


def _captures_section(geometry: GeometryCalibration) -> ReportSection:
    used = ReportTable.of(
        geometry.captures,
        {
            "image": lambda one: PurePath(one.image).name,
            "height / mm": lambda one: f"{one.height_mm:.3f}",
            "scale / (px/mm)": lambda one: number_text(one.scale_px_per_mm, ".5f", _UNKNOWN),
            "height residual / µm": lambda one: f"{1e3 * one.height_residual_mm:.1f}",
            "matches": lambda one: str(one.matches),
            "rms / px": lambda one: f"{one.rms_px:.4f}",
            "remarks": lambda one: "",
        },
    )
    left_out = tuple(
        (PurePath(item.image).name, "", "", "", "", "", f"excluded: {item.reason}")
        for item in geometry.excluded
    )
    table = replace(used, rows=(*used.rows, *left_out))
    return ReportSection.of("Captures", table, is_folded=True)


def _times(factor: float, err: float | None) -> float | None:
    return None if err is None else factor * err
