"""From captures at several heights to the geometry of camera and stage."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import atan, degrees, exp, hypot, sqrt
from typing import Any

import numpy as np

from acquisition.session import CaptureRecord, Session
from calibration.errors import GeometryError
from calibration.estimate import Estimate
from calibration.geometry._board import DEFAULT_BOARD, CharucoBoard
from calibration.geometry._bundle_adjustment import (
    Adjustment,
    Exclusion,
    GeometryCapture,
    PlaneLens,
)
from calibration.geometry._document import (
    CaptureGeometry,
    ExcludedCapture,
    GeometryCalibration,
    HeightZoom,
    ScaleSource,
)
from calibration.geometry._matching import adjust_captures
from calibration.geometry._pupil import (
    HEIGHT_FLOOR_MM,
    ConsistentSeries,
    PupilFit,
    without_outliers,
)
from calibration.geometry.cross_validation import cross_validation
from simulation.arrays import FloatArray

_STEP = 1e-6


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _StageAxis:
    """The stage's travel as seen by one series.

    The image expands from ``pierce_px`` (x, y), ``offset_px`` from the centre. ``sideways`` are the
    captures' distances from the straight line, shape (n, 2), in the unit of the series.
    """

    pierce_px: FloatArray
    offset_px: FloatArray
    covariance_px2: FloatArray
    sideways: FloatArray


def _stage_axis(adjustment: Adjustment, number: int) -> _StageAxis:
    """Fit a straight line of travel to the positions of one series with two distances or more."""
    series, layout = adjustment.series[number], adjustment.columns
    columns = np.concatenate(
        [layout.shared(number), *(layout.pose(one.capture) for one in series.captures)]
    )
    lens = series.lens
    shared = lens.parameters
    poses = np.array([one.pose.parameters for one in series.captures])

    def pierce_px(values: FloatArray) -> FloatArray:
        own = values[len(shared) :].reshape(-1, 4)
        drift = _drift_px(own)
        c, s = np.cos(own[0, 1]), np.sin(own[0, 1])
        slope = -np.array([[c, s], [-s, c]]) @ drift
        return lens.with_parameters(values[: len(shared)]).pixels(slope[None]).ravel()

    values = np.concatenate([shared, poses.ravel()])
    change = np.empty((2, len(values)))
    for column in range(len(values)):
        step = np.zeros(len(values))
        step[column] = _STEP
        change[:, column] = (pierce_px(values + step) - pierce_px(values - step)) / (2 * _STEP)
    covariance = change @ adjustment.covariance[np.ix_(columns, columns)] @ change.T
    distance = np.exp(poses[:, 0])
    offset = distance - distance.mean()
    sideways = poses[:, 2:] - poses[:, 2:].mean(axis=0) - np.outer(offset, _drift_px(poses))
    if len(poses) > 2:
        # A stage that does not run straight adds to the uncertainty from the images.
        scatter = np.sum(sideways**2) / (2 * (len(poses) - 2)) / np.sum(offset**2)
        wander = np.eye(2) * scatter * lens.focal_length_px**2
        if np.trace(wander) > np.trace(covariance):
            covariance = wander
    middle = np.array([(lens.width_px - 1) / 2, (lens.height_px - 1) / 2])
    pierced = pierce_px(values)
    return _StageAxis(
        pierce_px=pierced,
        offset_px=pierced - middle,
        covariance_px2=covariance,
        sideways=sideways,
    )


def _drift_px(poses: FloatArray) -> FloatArray:
    """Sideways travel (x, y) per unit of travel along the plane's normal."""
    distance = np.exp(poses[:, 0])
    offset = distance - distance.mean()
    return np.asarray(offset @ poses[:, 2:] / (offset @ offset))


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
class _FocalLength(Estimate):
    """Focal length in px, and its basis."""

    source: ScaleSource


def length_of(x: Estimate, y: Estimate) -> Estimate:
    """Length of a vector of two values with independent errors."""
    length = hypot(x.value, y.value)
    if length == 0:
        return Estimate(value=0.0, err=hypot(x.err, y.err) / sqrt(2))
    return Estimate(value=length, err=hypot(x.value * x.err, y.value * y.err) / length)


def _summarised(
    adjustment: Adjustment,
    pupil: PupilFit,
    focal: _FocalLength | None,
    excluded: Sequence[ExcludedCapture] = (),
    notes: Sequence[str] = (),
) -> GeometryCalibration:
    """Collect the results of consistent series."""
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


def _pair(name: str, err_name: str, measured: Estimate | None) -> Fields:
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
    focal: _FocalLength | None,
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


def _distortion(adjustment: Adjustment, focal: _FocalLength | None) -> Fields:
    """Radial distortion at the corner, and in OpenCV's units of the focal length."""
    lens, prior, errs = adjustment.series[0].lens, adjustment.prior, adjustment.lens_errs
    values = (
        ("k1", Estimate(value=lens.k1, err=errs[0]), prior.k1, 2),
        ("k2", Estimate(value=lens.k2, err=errs[1]), prior.k2, 4),
    )
    fields: Fields = {}
    opencv: Fields = {}
    for name, measured, beforehand, power in values:
        known = measured if measured.err < _DETERMINED * beforehand else None
        converted = None
        if known is not None and focal is not None:
            converted = known.scaled((focal.value / lens.corner_radius_px) ** power)
        fields |= _pair(name, f"{name}_err", known)
        opencv |= _pair(f"{name}_opencv", f"{name}_opencv_err", converted)
    return fields | opencv


def _principal_point(adjustment: Adjustment) -> Fields:
    lens = adjustment.series[0].lens
    # The corner moves by three times k1 times the offset of the principal point.
    smooth_px = _SMOOTH_ERROR_PX / max(3 * abs(lens.k1), 1e-9)
    x, y = (
        Estimate(value=value, err=hypot(err, smooth_px))
        for value, err in zip(
            (lens.principal_x_px, lens.principal_y_px), adjustment.lens_errs[2:4], strict=True
        )
    )
    is_known = max(x.err, y.err) < _DETERMINED * adjustment.prior.principal_px
    return {
        **_pair("principal_x_px", "principal_x_err_px", x if is_known else None),
        **_pair("principal_y_px", "principal_y_err_px", y if is_known else None),
    }


def _tilt(adjustment: Adjustment, focal: _FocalLength | None) -> tuple[Fields, list[str]]:
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
    tilts: tuple[Estimate | None, ...] = (None, None, None)
    if focal is not None and degrees(float(err.max())) <= _TILT_ERR_MAX_DEG:
        x, y = (
            Estimate(value=degrees(float(v)), err=degrees(float(e)))
            for v, e in zip(value, err, strict=True)
        )
        tilts = length_of(x, y), x, y
    fields: Fields = {}
    for name, measured in zip(("tilt", "tilt_x", "tilt_y"), tilts, strict=True):
        fields |= _pair(f"{name}_deg", f"{name}_err_deg", measured)
    return fields, notes


def _axes(adjustment: Adjustment) -> dict[int, _StageAxis]:
    """Lines of travel of the series with two heights, by number of the series."""
    return {
        number: _stage_axis(adjustment, number)
        for number, series in enumerate(adjustment.series)
        if len(set(series.heights_mm)) >= 2
    }


def _drift(axis: _StageAxis, distance_mm: float, focal: _FocalLength | None) -> Fields:
    """Drift of the image, and the angle of the stage's travel to the central line of sight."""
    x, y = (
        Estimate(
            value=float(axis.offset_px[i]) / distance_mm,
            err=sqrt(float(axis.covariance_px2[i, i])) / distance_mm,
        )
        for i in (0, 1)
    )
    drift, angle = length_of(x, y), None
    if focal is not None:
        per_focal = drift.scaled(distance_mm / focal.value)
        angle = Estimate(value=degrees(atan(per_focal.value)), err=degrees(per_focal.err))
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
    focal: _FocalLength | None,
    axes: dict[int, _StageAxis],
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


GEOMETRY_KINDS = ("board", "chart", "texture")


def geometry_records(session: Session) -> list[CaptureRecord]:
    """Return the captures with features in two dimensions."""
    records = [record for record in session.records if record.kind in GEOMETRY_KINDS]
    if not records:
        raise GeometryError(
            f"{session.path}: the session has no capture of kind {', '.join(GEOMETRY_KINDS)}; "
            "edges alone do not determine the geometry",
            reason="no_captures",
        )
    return records


def geometry_captures(session: Session) -> Iterator[GeometryCapture]:
    """Load these captures one by one, at the heights that were read back."""
    for record in geometry_records(session):
        yield GeometryCapture(
            name=record.file,
            kind=record.kind,
            target=record.target,
            orientation_deg=record.orientation_deg,
            height_mm=record.height_mm,
            image=session.load(record).mean_dn,
            index=record.index,
        )


def nominal_focal_px(session: Session) -> float | None:
    """Focal length divided by pixel pitch, from the bench file; None if it lacks one of them."""
    optics: Any = session.bench.get("optics")
    if not isinstance(optics, dict):
        return None
    focal_mm, pitch_um = optics.get("focal_length_mm"), optics.get("pixel_pitch_um")
    if not (isinstance(focal_mm, int | float) and isinstance(pitch_um, int | float)):
        return None
    if not (focal_mm > 0 and pitch_um > 0):
        return None
    with np.errstate(over="ignore", divide="ignore"):
        focal_px = float(np.float64(focal_mm) / (np.float64(pitch_um) * 1e-3))
    return focal_px if np.isfinite(focal_px) else None


_FOCAL_PER_WIDTH = 1.2
"""Focal length assumed if none is known, in image widths; it cancels except in the tilt."""
_FOCAL_CONVERGED = 2e-4
_FOCAL_ROUNDS = 4
_ALONE = "the other captures of its target are left out, and one capture alone is of no use"


@dataclass(frozen=True, slots=True, kw_only=True)
class GeometryOptions:
    """What is known beforehand: focal length over pixel pitch, scale at the lowest height."""

    nominal_focal_px: float | None = None
    scale_px_per_mm: float | None = None
    board: CharucoBoard = DEFAULT_BOARD


def geometry_of_captures(
    captures: Sequence[GeometryCapture],
    options: GeometryOptions | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> GeometryCalibration:
    """Measure pupil offset, scales, distortion, tilt and drift.

    The captures, in any order, are of boards and textured targets, all of one image size. A
    `GeometryError` names the capture or target at fault and the remedy.
    """
    given = options or GeometryOptions()
    _check(captures)
    height_px, width_px = captures[0].image.shape
    focal_px = given.nominal_focal_px or _FOCAL_PER_WIDTH * width_px
    ordered = sorted(captures, key=_order)
    lens = PlaneLens(width_px=width_px, height_px=height_px, focal_length_px=focal_px)
    matched = adjust_captures(ordered, lens, given.board, progress)
    adjustment, exclusions = matched.adjustment, [*matched.exclusions]
    notes: list[str] = []
    for _ in range(_FOCAL_ROUNDS):
        consistent = without_outliers(adjustment)
        adjustment = consistent.adjustment
        exclusions += consistent.exclusions
        notes += consistent.notes
        focal = _focal_length(consistent, given)
        if focal is None or abs(focal.value / focal_px - 1) < _FOCAL_CONVERGED:
            break
        focal_px = focal.value
        adjustment = adjustment.with_focal_length(focal_px)
    excluded = _excluded(ordered, adjustment, exclusions)
    validated = cross_validation(adjustment, consistent.pupil)
    found = _summarised(adjustment, consistent.pupil, focal, excluded, [*notes, *validated.faults])
    return found.model_copy(update={"cross_validation": validated})


def _order(capture: GeometryCapture) -> tuple[bool, str, str, float, float]:
    return (
        capture.kind != "board",
        capture.kind,
        capture.target,
        capture.orientation_deg,
        capture.height_mm,
    )


def _check(captures: Sequence[GeometryCapture]) -> None:
    if not captures:
        raise GeometryError("no capture of kind board, chart or texture", reason="no_captures")
    shapes = {capture.image.shape for capture in captures}
    if len(shapes) > 1:
        raise GeometryError(
            f"the captures differ in size (rows, cols): {sorted(shapes)}; "
            "use captures of one camera and region",
            reason="several_sizes",
        )
    heights = sorted({round(capture.height_mm, 3) for capture in captures})
    if len(heights) < 2:
        raise GeometryError(
            f"all {len(captures)} captures are at height {heights[0]:g} mm; geometry needs two "
            "heights or more: capture a height series, or import each photograph with its "
            "--height-mm",
            reason="one_height",
        )


def _focal_length(consistent: ConsistentSeries, given: GeometryOptions) -> _FocalLength | None:
    adjustment, pupil = consistent.adjustment, consistent.pupil
    number = adjustment.first_in_mm
    if number is not None:
        value = adjustment.series[number].lens.focal_length_px * exp(-pupil.log_units[number])
        err = value * sqrt(float(pupil.covariance[1 + number, 1 + number]))
        return _FocalLength(value=value, err=err, source="board")
    if given.scale_px_per_mm is not None:
        lowest_mm = min(one.capture.height_mm for one in adjustment.captures)
        return _FocalLength(
            value=given.scale_px_per_mm * (lowest_mm + pupil.pupil_offset_mm),
            err=given.scale_px_per_mm * pupil.pupil_offset_err_mm,
            source="given",
        )
    if given.nominal_focal_px is not None:
        return _FocalLength(value=given.nominal_focal_px, err=0.0, source="bench")
    return None


def _excluded(
    captures: Sequence[GeometryCapture], adjustment: Adjustment, exclusions: Sequence[Exclusion]
) -> list[ExcludedCapture]:
    """The captures that were not used, in order, each with the reason."""
    reasons = {one.capture: one.reason for one in exclusions}
    used = {one.capture for one in adjustment.captures}
    return [
        ExcludedCapture(image=capture.name, reason=reasons.get(capture, _ALONE))
        for capture in captures
        if capture not in used
    ]
