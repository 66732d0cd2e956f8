"""The measured geometry of camera and stage, as geometry.json stores it."""

from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from pydantic import Field

from acquisition.dataframe import dataframe
from acquisition.files import Provenance, StoredModel
from calibration.estimate import NORMAL_95
from simulation.notebook import Shown
from simulation.palette import INK, PALETTE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

TARGET_COLOURS = PALETTE


def draw_scale_by_height(axes: "Axes", geometry: "GeometryCalibration") -> None:
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


GEOMETRY_SCHEMA: Final = "standoff.geometry/1"
_BEYOND_MM = 0.1
"""Heights read back scatter by the tolerance of the stage, which is less."""

ScaleSource = Literal["board", "given", "bench"]


class _Stored(StoredModel, allow_inf_nan=False):
    """Whose numbers are finite."""


class HeightZoom(_Stored):
    """True zoom-out of a pair of heights."""

    near_height_mm: float
    far_height_mm: float
    zoom: float
    zoom_err: float


class CaptureGeometry(_Stored):
    """One capture that was used.

    ``height_residual_mm`` is the height read back minus that which fits its image; ``sideways_mm``
    is the distance of the camera from the straight line of travel, x and y on the target.
    """

    image: str
    capture: int | None = None
    kind: str
    target: str
    orientation_deg: float | None = None
    height_mm: float
    scale_px_per_mm: float | None
    scale_err_px_per_mm: float | None
    height_residual_mm: float
    sideways_mm: tuple[float, float]
    matches: int
    rms_px: float


class ExcludedCapture(_Stored):
    """A capture that was not used, and why."""

    image: str
    reason: str


class HeldOut(_Stored):
    """How well one half of the data is predicted by the other half.

    ``chi2_reduced`` is chi-squared over its ``degrees_of_freedom``, relative to the errors of the
    images, and ``p_value`` the probability of a larger value. ``worst`` is the largest error of a
    prediction, relative to the distance of the camera; it is at ``worst_height_mm``.
    """

    chi2_reduced: float
    degrees_of_freedom: int
    p_value: float
    worst: float
    worst_height_mm: float


class PlaneSag(_Stored):
    """The bend of the targets that fits the points best.

    ``sag`` is the height of the bent surface at the corner of the nearest capture's field of view,
    relative to that capture's distance; ``p_value`` is the probability of as large a sag if the
    target is flat. ``chi2_reduced`` is the ratio of the mean squared residuals in one half of the
    target's regions, predicted from the other half, to those in the half that was fitted.
    """

    sag: float
    sag_err: float
    p_value: float
    chi2_reduced: float


class CrossValidation(_Stored):
    """Test of half of the heights, and of half of the points, against the rest; None if too few.

    ``heights`` tests the distances, ``travel`` the sideways deviations from a straight travel,
    ``points`` the flatness of the targets. ``faults`` are sentences on misfits that are large
    enough to make changes harder to find.
    """

    heights: HeldOut | None = None
    travel: HeldOut | None = None
    points: PlaneSag | None = None
    faults: tuple[str, ...] = ()


class GeometryCalibration(Shown, _Stored):
    """The geometry of camera and stage; None, or null in a file, means not determined.

    Only the keys without a default are required. Errors are standard errors.

    Parameters
    ----------
    heights_mm
        Distinct heights, ascending.
    scale_px_per_mm, scale_err_px_per_mm, scale_source
        Scale on the target at each height, its standard error, and what it is based on.
    pupil_offset_mm, height_scatter_mm
        Distance of the entrance pupil from the target plane at height 0, and scatter of the heights
        beyond what the errors of the images explain.
    focal_length_px
        Focal length, measured if a board or a scale is given; otherwise that of the bench file,
        without error.
    k1, k2
        Coefficients of the radial distortion, relative to the radius of the image corner; those
        named ``opencv`` follow OpenCV's convention.
    principal_x_px, principal_y_px
        Offset of the principal point from the centre of the image.
    tilt_deg, tilt_x_deg, tilt_y_deg
        Angle between the optical axis and the normal of the target, and its components.
    axis_drift_px_per_mm
        Drift of the image per mm of stage travel, at ``axis_drift_height_mm``; and its components.
    stage_angle_deg
        Angle between the stage's travel and the line of sight of the image centre.
    pierce_px
        Point ``(x, y)`` at which the line of the stage's travel meets the image.
    captures, excluded
        The captures that were used, and those that were not.
    undetermined
        Reason for each value that is None, by name.
    notes
        Remarks on anything unusual, one sentence each.
    cross_validation
        Test of one half of the data against the other; None in older files.
    """

    schema_name: Literal["standoff.geometry/1"] = Field(default=GEOMETRY_SCHEMA, alias="schema")
    heights_mm: tuple[float, ...]
    scale_px_per_mm: tuple[float, ...] | None
    scale_err_px_per_mm: tuple[float, ...] | None = None
    scale_source: ScaleSource | None = None
    pupil_offset_mm: float
    pupil_offset_err_mm: float | None = None
    pupil_offset_interval_95_mm: tuple[float, float] | None = None
    height_scatter_mm: float | None = None
    focal_length_px: float | None = None
    focal_length_err_px: float | None = None
    k1: float | None
    k1_err: float | None = None
    k2: float | None
    k2_err: float | None = None
    k1_opencv: float | None = None
    k1_opencv_err: float | None = None
    k2_opencv: float | None = None
    k2_opencv_err: float | None = None
    principal_x_px: float | None = None
    principal_x_err_px: float | None = None
    principal_y_px: float | None = None
    principal_y_err_px: float | None = None
    tilt_deg: float | None
    tilt_err_deg: float | None = None
    tilt_x_deg: float | None = None
    tilt_x_err_deg: float | None = None
    tilt_y_deg: float | None = None
    tilt_y_err_deg: float | None = None
    axis_drift_px_per_mm: float | None
    axis_drift_err_px_per_mm: float | None = None
    axis_drift_x_px_per_mm: float | None = None
    axis_drift_x_err_px_per_mm: float | None = None
    axis_drift_y_px_per_mm: float | None = None
    axis_drift_y_err_px_per_mm: float | None = None
    axis_drift_height_mm: float | None = None
    stage_angle_deg: float | None = None
    stage_angle_err_deg: float | None = None
    pierce_px: tuple[float, float] | None = None
    width_px: int | None = None
    height_px: int | None = None
    zooms: tuple[HeightZoom, ...] = ()
    captures: tuple[CaptureGeometry, ...] = ()
    excluded: tuple[ExcludedCapture, ...] = ()
    undetermined: dict[str, str] = {}  # noqa: RUF012 - pydantic copies it
    notes: tuple[str, ...] = ()
    cross_validation: CrossValidation | None = None
    provenance: Provenance | None = None

    def to_dataframe(self) -> "DataFrame":
        """Return the captures that were used as a pandas table, one row per capture.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return dataframe(one.model_dump() for one in self.captures)

    @property
    def fit_factor(self) -> float:
        """Half of a 95 % interval, in standard errors, for what the fit of the heights gives.

        That is the pupil offset, the scales, the zooms and the focal length. It is Student's
        quantile if the heights scatter more than the images explain: 12.7 for three heights.
        """
        if self.pupil_offset_interval_95_mm is None or not self.pupil_offset_err_mm:
            return NORMAL_95
        low, high = self.pupil_offset_interval_95_mm
        return 0.5 * (high - low) / self.pupil_offset_err_mm

    def zoom(self, near_mm: float, far_mm: float) -> float:
        """Zoom-out between two heights: the ratio of the distances from the entrance pupil."""
        return (far_mm + self.pupil_offset_mm) / (near_mm + self.pupil_offset_mm)

    def scale_at(self, height_mm: float) -> float | None:
        """Scale on the target in px/mm at a height; None beyond the heights that were captured.

        It is computed from the scale at the nearest captured height, in inverse proportion to the
        distance from the entrance pupil.
        """
        known = list(zip(self.heights_mm, self.scale_px_per_mm or (), strict=False))
        distance_mm = height_mm + self.pupil_offset_mm
        if not known or distance_mm <= 0:
            return None
        if not min(known)[0] - _BEYOND_MM <= height_mm <= max(known)[0] + _BEYOND_MM:
            return None
        at_mm, scale = min(known, key=lambda pair: abs(pair[0] - height_mm))
        return scale * (at_mm + self.pupil_offset_mm) / distance_mm

    def __repr__(self) -> str:
        figures = (
            ("pupil offset", self.pupil_offset_mm, self.pupil_offset_err_mm, " mm"),
            ("focal length", self.focal_length_px, self.focal_length_err_px, " px"),
            ("k1", self.k1, self.k1_err, ""),
            ("tilt", self.tilt_deg, self.tilt_err_deg, " deg"),
        )
        known = ", ".join(
            f"{name} {value:.6g}{'' if err is None else f' ± {err:.2g}'}{unit}"
            for name, value, err, unit in figures
            if value is not None
        )
        counts = f"{len(self.captures)} captures at {len(self.heights_mm)} heights"
        return f"{type(self).__name__}({known}; {counts}, {len(self.excluded)} left out)"

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of every capture's scale against its height, with the fit."""
        from simulation.figures import drawn

        def draw(axes: "Axes") -> None:
            draw_scale_by_height(axes, self)
            axes.set(xlabel="height read back / mm")

        return drawn(draw, ax)
