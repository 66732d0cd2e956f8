"""Plot of a geometry calibration: scale against height."""

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from simulation.palette import INK, PALETTE

if TYPE_CHECKING:
    from calibration.geometry.document import CaptureGeometry, GeometryCalibration

TARGET_COLOURS = PALETTE


def draw_scale_by_height(axes: Axes, geometry: "GeometryCalibration") -> None:
    """Draw every capture's scale against its height, with the fit."""
    low, high = geometry.heights_mm[0], geometry.heights_mm[-1]
    margin = 0.04 * (high - low)
    heights = np.linspace(low - margin, high + margin, 300)
    focal = geometry.focal_length_px
    unit = 1.0 if focal is None else focal
    reference = 1.0 if focal is not None else low + geometry.pupil_offset_mm
    axes.plot(
        heights,
        unit * reference / (heights + geometry.pupil_offset_mm),
        color=INK,
        linewidth=1,
        label=f"fit, pupil {geometry.pupil_offset_mm:.3f} mm above height 0",
    )
    by_target = captures_by_target(geometry).items()
    for (name, captures), colour in zip(by_target, target_colours(), strict=False):
        own = np.array([one.height_mm for one in captures])
        left = np.array([one.height_residual_mm for one in captures])
        measured = unit * reference / (own - left + geometry.pupil_offset_mm)
        axes.plot(own, measured, "o", markersize=4.5, color=colour, label=name)
    axes.set(
        ylabel="scale / (px/mm)" if focal is not None else f"scale, 1 at {low:g} mm",
        xlim=(low - margin, high + margin),
    )
    axes.legend(loc="upper right")


def captures_by_target(geometry: "GeometryCalibration") -> "dict[str, list[CaptureGeometry]]":
    """Return the captures of each target, by height."""
    groups: dict[str, list[CaptureGeometry]] = {}
    for capture in geometry.captures:
        name = (
            capture.target if capture.target == capture.kind else f"{capture.kind} {capture.target}"
        )
        groups.setdefault(name, []).append(capture)
    return {name: sorted(group, key=lambda c: c.height_mm) for name, group in groups.items()}


def target_colours() -> tuple[str, ...]:
    """Return colours for as many targets as there may be."""
    return TARGET_COLOURS * 20
