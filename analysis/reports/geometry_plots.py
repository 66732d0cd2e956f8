"""Figures of a geometry calibration: scale against height, distortion, straightness of travel."""

import numpy as np
from matplotlib.figure import Figure

from analysis.reports.page import in_report_style, new_figure
from calibration.geometry import (
    CaptureGeometry,
    GeometryCalibration,
    captures_by_target,
    draw_scale_by_height,
    target_colours,
)
from calibration.sharpness import NORMAL_95
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
    figure = new_figure(6.4, 3.0)
    axes = figure.subplots()
    axes.plot(radius * corner_px, moved, color=PALETTE[0], label="k1 and k2 together")
    axes.plot(
        radius * corner_px, corner_px * radius**3 * geometry.k1, "--", color=INK, linewidth=0.9,
        label="k1 alone",
    )  # fmt: skip
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
    figure = new_figure(3.6, 3.6)
    axes = figure.subplots()
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
    figure = new_figure(6.4, 2.8)
    axes = figure.subplots()
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
