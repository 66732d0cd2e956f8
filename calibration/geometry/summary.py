"""The values of geometry.json from the adjusted series."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import atan, degrees, exp, hypot, sqrt

import numpy as np

from calibration.geometry.bundle_adjustment import Adjustment
from calibration.geometry.document import (
    CaptureGeometry,
    ExcludedCapture,
    GeometryCalibration,
    HeightZoom,
    ScaleSource,
)
from calibration.geometry.pupil import HEIGHT_FLOOR_MM, PupilFit
from calibration.geometry.stage_axis import StageAxis, stage_axis

Fields = dict[str, object]

_DETERMINED = 0.5
"""Relative to the prior's standard deviation: with a larger error a value is not determined."""
_TILT_ERR_MAX_DEG = 2.0
_SMOOTH_ERROR_PX = 0.02
"""Error at the image corner that is common to neighbouring matches, so that leaving out regions
does not show it: from shading, aliasing and a PSF that changes over the field, measured on the
simulated bench.
"""
_DISAGREEMENT_SIGMAS = 4.0
_SCATTER_NOTED_MM = 0.05

_NO_LENGTH = (
    "no length is known: capture a ChArUco board, give --scale, or enter the focal length and "
    "pixel pitch in the bench file"
)
_SHORT = "the captures do not determine it: span a wider range of heights, or capture a board"


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """A value and its standard error."""

    value: float
    err: float

    def times(self, factor: float) -> "Measured":
        """The same value in another unit."""
        return Measured(value=self.value * factor, err=self.err * abs(factor))


@dataclass(frozen=True, slots=True, kw_only=True)
class FocalLength(Measured):
    """Focal length in px, and its basis."""

    source: ScaleSource


def length_of(x: Measured, y: Measured) -> Measured:
    """Length of a vector of two values with independent errors."""
    length = hypot(x.value, y.value)
    if length == 0:
        return Measured(value=0.0, err=hypot(x.err, y.err) / sqrt(2))
    return Measured(value=length, err=hypot(x.value * x.err, y.value * y.err) / length)


def summarised(
    adjustment: Adjustment,
    pupil: PupilFit,
    focal: FocalLength | None,
    excluded: Sequence[ExcludedCapture] = (),
    notes: Sequence[str] = (),
) -> GeometryCalibration:
    """Collect the results of consistent series.

    Parameters
    ----------
    adjustment, pupil
        Results of captures that agree.
    focal
        None if no length is known.
    excluded, notes
        Captures left out, and remarks.
    """
    heights = tuple(sorted({one.capture.height_mm for one in adjustment.captures}))
    # Without a target at two heights there would be no pupil fit, so there is at least one axis.
    axes = _axes(adjustment)
    _, axis = min(axes.items(), key=lambda one: float(np.trace(one[1].covariance_px2)))
    tilt, tilt_notes = _tilt(adjustment, focal)
    lens = adjustment.series[0].lens
    fields: Fields = {
        "heights_mm": heights,
        **_scales(adjustment, pupil, focal, heights),
        **_pupil(pupil),
        **_pair("focal_length_px", "focal_length_err_px", focal),
        **_distortion(adjustment, focal),
        **_principal_point(adjustment),
        **tilt,
        **_drift(axis, heights[0] + pupil.pupil_offset_mm, focal),
        "axis_drift_height_mm": heights[0],
        "pierce_px": axis.pierce_px.tolist(),
        "width_px": lens.width_px,
        "height_px": lens.height_px,
        "zooms": _zooms(pupil, heights),
        "captures": _captures(adjustment, pupil, focal, axes),
        "excluded": excluded,
        "notes": (*notes, *tilt_notes, *_pupil_notes(pupil)),
    }
    return GeometryCalibration.model_validate({**fields, "undetermined": _undetermined(fields)})


def _pair(name: str, err_name: str, measured: Measured | None) -> Fields:
    """A value and its error, None if it is not determined."""
    if measured is None:
        return {name: None, err_name: None}
    return {name: measured.value, err_name: measured.err}


def _undetermined(fields: Fields) -> dict[str, str]:
    """The reason for every value that is None."""
    reasons = (
        ("scale_px_per_mm", "scale_px_per_mm", _NO_LENGTH),
        ("focal_length_px", "focal_length_px", _NO_LENGTH),
        ("k1", "k1", _SHORT),
        ("k2", "k2", _SHORT),
        ("principal_px", "principal_x_px", "only a lens with distortion shows its centre"),
        (
            "tilt_deg",
            "tilt_deg",
            "the focal length is not known: give it in the bench file"
            if fields["focal_length_px"] is None
            else _SHORT,
        ),
    )
    return {name: reason for name, field, reason in reasons if fields[field] is None}


def _scales(
    adjustment: Adjustment,
    pupil: PupilFit,
    focal: FocalLength | None,
    heights_mm: tuple[float, ...],
) -> Fields:
    if focal is None:
        return {"scale_px_per_mm": None, "scale_err_px_per_mm": None, "scale_source": None}
    board = adjustment.first_in_mm
    scales, errs = [], []
    for height_mm in heights_mm:
        distance_mm = height_mm + pupil.pupil_offset_mm
        if board is not None:
            relative = pupil.log_distance_err(height_mm, board)
        elif focal.source == "given":
            # Exact at the height it was given for; elsewhere as good as the zoom-out from there.
            zoom, err = pupil.zoom(heights_mm[0], height_mm)
            relative = err / zoom
        else:
            relative = pupil.pupil_offset_err_mm / distance_mm
        scales.append(focal.value / distance_mm)
        errs.append(scales[-1] * relative)
    return {
        "scale_px_per_mm": scales,
        "scale_err_px_per_mm": errs,
        "scale_source": focal.source,
    }


def _pupil(pupil: PupilFit) -> Fields:
    offset_mm, reach_mm = pupil.pupil_offset_mm, pupil.interval_factor * pupil.pupil_offset_err_mm
    return {
        "pupil_offset_mm": offset_mm,
        "pupil_offset_err_mm": pupil.pupil_offset_err_mm,
        "pupil_offset_interval_95_mm": (offset_mm - reach_mm, offset_mm + reach_mm),
        "height_scatter_mm": pupil.scatter_mm,
    }


def _pupil_notes(pupil: PupilFit) -> list[str]:
    if pupil.degrees_of_freedom == 0:
        return ["only two heights: nothing checks them, and their error is not included"]
    if pupil.scatter_mm > _SCATTER_NOTED_MM:
        return [
            f"heights and images disagree by {pupil.scatter_mm:.3f} mm: check the stage, "
            "and that the lens was not refocused between captures"
        ]
    return []


def _distortion(adjustment: Adjustment, focal: FocalLength | None) -> Fields:
    """Radial distortion at the corner, and in OpenCV's units of the focal length."""
    lens, prior, errs = adjustment.series[0].lens, adjustment.prior, adjustment.lens_errs
    values = (
        ("k1", Measured(value=lens.k1, err=errs[0]), prior.k1, 2),
        ("k2", Measured(value=lens.k2, err=errs[1]), prior.k2, 4),
    )
    fields: Fields = {}
    opencv: Fields = {}
    for name, measured, beforehand, power in values:
        known = measured if measured.err < _DETERMINED * beforehand else None
        converted = None
        if known is not None and focal is not None:
            converted = known.times((focal.value / lens.corner_radius_px) ** power)
        fields |= _pair(name, f"{name}_err", known)
        opencv |= _pair(f"{name}_opencv", f"{name}_opencv_err", converted)
    return fields | opencv


def _principal_point(adjustment: Adjustment) -> Fields:
    lens = adjustment.series[0].lens
    # The corner moves by three times k1 times the offset of the principal point.
    smooth_px = _SMOOTH_ERROR_PX / max(3 * abs(lens.k1), 1e-9)
    x, y = (
        Measured(value=value, err=hypot(err, smooth_px))
        for value, err in zip(
            (lens.principal_x_px, lens.principal_y_px), adjustment.lens_errs[2:4], strict=True
        )
    )
    is_known = max(x.err, y.err) < _DETERMINED * adjustment.prior.principal_px
    return {
        **_pair("principal_x_px", "principal_x_err_px", x if is_known else None),
        **_pair("principal_y_px", "principal_y_err_px", y if is_known else None),
    }


def _tilt(adjustment: Adjustment, focal: FocalLength | None) -> tuple[Fields, list[str]]:
    """Weighted mean of the tilts of the series, leaving out those that contradict the first."""
    found = []
    for number, series in enumerate(adjustment.series):
        columns = adjustment.columns.shared(number)[-2:]
        errs = np.sqrt(np.diag(adjustment.covariance)[columns])
        found.append((np.array([series.lens.tilt_x_rad, series.lens.tilt_y_rad]), errs))
    notes = []
    value, err = found[0]
    for series, (other, other_err) in zip(adjustment.series[1:], found[1:], strict=True):
        away = np.abs(other - value) / np.hypot(err, other_err)
        if np.any(away > _DISAGREEMENT_SIGMAS):
            notes.append(
                f"{series.target} is inclined by {degrees(float(np.hypot(*(other - value)))):.2f} "
                "degrees relative to the first target; the tilt given is that of the first"
            )
            continue
        weight, other_weight = err**-2.0, other_err**-2.0
        value = (weight * value + other_weight * other) / (weight + other_weight)
        # The lens is common to all, so their errors are not independent: take the smaller one.
        err = np.minimum(err, other_err)
    # A tilt t moves the corner, at the radius r, by t r^2 / f.
    lens = adjustment.series[0].lens
    err = np.hypot(err, _SMOOTH_ERROR_PX * lens.focal_length_px / lens.corner_radius_px**2)
    tilts: tuple[Measured | None, ...] = (None, None, None)
    if focal is not None and degrees(float(err.max())) <= _TILT_ERR_MAX_DEG:
        x, y = (
            Measured(value=degrees(float(v)), err=degrees(float(e)))
            for v, e in zip(value, err, strict=True)
        )
        tilts = length_of(x, y), x, y
    fields: Fields = {}
    for name, measured in zip(("tilt", "tilt_x", "tilt_y"), tilts, strict=True):
        fields |= _pair(f"{name}_deg", f"{name}_err_deg", measured)
    return fields, notes


def _axes(adjustment: Adjustment) -> dict[int, StageAxis]:
    """Lines of travel of the series with two heights, by number of the series."""
    return {
        number: stage_axis(adjustment, number)
        for number, series in enumerate(adjustment.series)
        if len(set(series.heights_mm)) >= 2
    }


def _drift(axis: StageAxis, distance_mm: float, focal: FocalLength | None) -> Fields:
    """Drift of the image, and the angle of the stage's travel to the central line of sight."""
    x, y = (
        Measured(
            value=float(axis.offset_px[i]) / distance_mm,
            err=sqrt(float(axis.covariance_px2[i, i])) / distance_mm,
        )
        for i in (0, 1)
    )
    drift, angle = length_of(x, y), None
    if focal is not None:
        per_focal = drift.times(distance_mm / focal.value)
        angle = Measured(value=degrees(atan(per_focal.value)), err=degrees(per_focal.err))
    return {
        **_pair("axis_drift_px_per_mm", "axis_drift_err_px_per_mm", drift),
        **_pair("axis_drift_x_px_per_mm", "axis_drift_x_err_px_per_mm", x),
        **_pair("axis_drift_y_px_per_mm", "axis_drift_y_err_px_per_mm", y),
        **_pair("stage_angle_deg", "stage_angle_err_deg", angle),
    }


def _zooms(pupil: PupilFit, heights_mm: tuple[float, ...]) -> list[HeightZoom]:
    found = []
    for near_mm, far_mm in combinations(heights_mm, 2):
        zoom, err = pupil.zoom(near_mm, far_mm)
        found.append(
            HeightZoom(near_height_mm=near_mm, far_height_mm=far_mm, zoom=zoom, zoom_err=err)
        )
    return found


def _captures(
    adjustment: Adjustment,
    pupil: PupilFit,
    focal: FocalLength | None,
    axes: dict[int, StageAxis],
) -> list[CaptureGeometry]:
    columns = adjustment.columns
    residuals_mm = iter(pupil.height_residuals_mm.tolist())
    found = []
    for number, series in enumerate(adjustment.series):
        unit = float(pupil.log_units[number])
        sideways_mm = np.zeros((len(series.captures), 2))
        if number in axes:
            sideways_mm = axes[number].sideways * exp(-unit)
        for one, (x_mm, y_mm) in zip(series.captures, sideways_mm.tolist(), strict=True):
            distance_mm = exp(one.pose.log_distance - unit)
            variance = float(adjustment.covariance[(columns.pose(one.capture)[0],) * 2])
            relative = sqrt(variance + (HEIGHT_FLOOR_MM / distance_mm) ** 2)
            scale = None if focal is None else focal.value / distance_mm
            found.append(
                CaptureGeometry(
                    image=one.capture.name,
                    capture=one.capture.index,
                    kind=one.capture.kind,
                    target=one.capture.target,
                    orientation_deg=one.capture.orientation_deg,
                    height_mm=one.capture.height_mm,
                    scale_px_per_mm=scale,
                    scale_err_px_per_mm=None if scale is None else scale * relative,
                    height_residual_mm=next(residuals_mm),
                    sideways_mm=(x_mm, y_mm),
                    matches=one.match_count,
                    rms_px=one.rms_px,
                )
            )
    return found
