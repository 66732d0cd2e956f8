"""From captures at several heights to the geometry of camera and stage."""

from collections.abc import Callable, Sequence
from math import degrees, exp, sqrt

import numpy as np
from numpy.typing import NDArray

from calibration.errors import GeometryError
from calibration.geometry.bundle_adjustment import LensPrior
from calibration.geometry.camera import PlaneLens
from calibration.geometry.outliers import without_outliers
from calibration.geometry.pupil import HEIGHT_FLOOR_MM, PupilFit
from calibration.geometry.results import (
    CaptureGeometry,
    GeometryCalibration,
    GeometryOptions,
    Measured,
    ScaleSource,
    length_of,
)
from calibration.geometry.series import GeometryCapture, SeriesAdjustment, adjust_captures
from calibration.geometry.stage_axis import StageAxis, stage_axis

__all__ = ["calibrate_geometry"]

FloatArray = NDArray[np.float64]

_FOCAL_PER_WIDTH = 1.2
"""Focal length taken where none is known, in image widths; it cancels but for the tilt."""
_FOCAL_CONVERGED = 2e-4
_FOCAL_ROUNDS = 4
_DETERMINED = 0.5
"""Of the prior's standard deviation: an error above it says that the captures told nothing."""
_TILT_ERR_MAX_DEG = 2.0
_SMOOTH_ERROR_PX = 0.02
"""Error at the image corner that neighbouring matches share and leaving out regions cannot show:
what shading, aliasing and a PSF that changes over the field leave, measured on the simulated bench.
"""
_DISAGREEMENT_SIGMAS = 4.0


def calibrate_geometry(
    captures: Sequence[GeometryCapture],
    options: GeometryOptions | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> GeometryCalibration:
    """Measure pupil offset, scales, distortion, tilt and drift.

    Parameters
    ----------
    captures
        Of boards and textured targets, in any order, all of one image size.
    options
        What is known beforehand.
    progress
        Called with the number of captures that are matched.

    Raises
    ------
    GeometryError
        If the captures were made at one height, do not match, or contradict the stage; one line
        that names the capture or target and the remedy.
    """
    given = options or GeometryOptions()
    _check(captures)
    excluded: dict[int, str] = {}
    notes: list[str] = []
    height_px, width_px = captures[0].image.shape
    focal_px = given.nominal_focal_px or _FOCAL_PER_WIDTH * width_px
    ordered = sorted(range(len(captures)), key=lambda i: _order(captures[i]))
    captures = [captures[i] for i in ordered]
    lens = PlaneLens(width_px=width_px, height_px=height_px, focal_length_px=focal_px)
    series = adjust_captures(captures, lens, given.board, excluded, progress)
    for _ in range(_FOCAL_ROUNDS):
        consistent = without_outliers(series, captures, excluded)
        series = consistent.series
        notes += consistent.notes
        source, focal = _focal_length(series, consistent.pupil, captures, given)
        if focal is None or abs(focal.value / focal_px - 1) < _FOCAL_CONVERGED:
            break
        focal_px = focal.value
        series = series.with_focal_length(focal_px)
    return _summary(series, captures, consistent.pupil, source, focal, excluded, notes)


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
        raise GeometryError("no capture of kind board, chart or texture")
    shapes = {capture.image.shape for capture in captures}
    if len(shapes) > 1:
        raise GeometryError(f"the captures have several sizes: {sorted(shapes)}")
    heights = sorted({round(capture.height_mm, 3) for capture in captures})
    if len(heights) < 2:
        raise GeometryError(
            f"all {len(captures)} captures are at height {heights[0]:g} mm; geometry needs two "
            "heights or more: capture a height series, or import each photograph with its "
            "--height-mm"
        )


def _focal_length(
    series: SeriesAdjustment,
    pupil: PupilFit,
    captures: Sequence[GeometryCapture],
    given: GeometryOptions,
) -> tuple[ScaleSource | None, Measured | None]:
    """Focal length in px and what it rests on."""
    if series.boards:
        number = min(series.boards)
        assumed = series.adjustment.lenses[number].focal_length_px
        value = assumed * exp(-pupil.log_units[number])
        err = sqrt(float(pupil.covariance[1 + number, 1 + number]))
        return "board", Measured(value=value, err=value * err)
    if given.scale_px_per_mm is not None:
        lowest = min(captures[m].height_mm for m in series.members)
        value = given.scale_px_per_mm * (lowest + pupil.pupil_offset_mm)
        return "given", Measured(value=value, err=given.scale_px_per_mm * pupil.pupil_offset_err_mm)
    if given.nominal_focal_px is not None:
        return "bench", Measured(value=given.nominal_focal_px, err=0.0)
    return None, None


def _summary(
    series: SeriesAdjustment,
    captures: Sequence[GeometryCapture],
    pupil: PupilFit,
    source: ScaleSource | None,
    focal: Measured | None,
    excluded: dict[int, str],
    notes: list[str],
) -> GeometryCalibration:
    undetermined: dict[str, str] = {}
    adjustment = series.adjustment
    heights = tuple(sorted({captures[m].height_mm for m in series.members}))
    board = min(series.boards, default=None)
    scales = None
    if focal is None:
        text = (
            "no length is known: capture a ChArUco board, give --scale, or the focal length and "
            "pixel pitch of the bench"
        )
        undetermined["scale_px_per_mm"] = undetermined["focal_length_px"] = text
    else:
        scales = tuple(
            _scale(h, pupil, focal, source, board, lowest_mm=heights[0]) for h in heights
        )
    errors = np.sqrt(np.diag(adjustment.covariance))
    lens, prior = adjustment.lenses[0], LensPrior()
    k1 = k2 = None
    principal = None
    short = "the captures do not tell it: span a greater range of heights, or capture a board"
    if errors[0] < _DETERMINED * prior.k1:
        k1 = Measured(value=lens.k1, err=float(errors[0]))
    else:
        undetermined["k1"] = short
    if errors[1] < _DETERMINED * prior.k2:
        k2 = Measured(value=lens.k2, err=float(errors[1]))
    else:
        undetermined["k2"] = short
    # The corner moves by three times k1 times the offset of the principal point.
    errors[2:4] = np.hypot(errors[2:4], _SMOOTH_ERROR_PX / max(3 * abs(lens.k1), 1e-9))
    if max(errors[2:4]) < _DETERMINED * prior.principal_px:
        principal = (
            Measured(value=lens.principal_x_px, err=float(errors[2])),
            Measured(value=lens.principal_y_px, err=float(errors[3])),
        )
    else:
        undetermined["principal_px"] = "only a lens that distorts shows where its centre is"
    tilts: tuple[Measured, Measured] | None = _tilt(series, captures, notes)
    if focal is None:
        undetermined["tilt_deg"] = "the focal length is not known: give it in the bench file"
        tilts = None
    elif tilts and max(t.err for t in tilts) > _TILT_ERR_MAX_DEG:
        undetermined["tilt_deg"] = short
        tilts = None
    axes = _axes(series, captures)
    # Without a target at two heights there is no pupil, either: one of the axes is there.
    axis = axes[0][1]
    distance = heights[0] + pupil.pupil_offset_mm
    drift = (
        Measured(
            value=float(axis.offset_px[0]) / distance,
            err=sqrt(float(axis.covariance_px2[0, 0])) / distance,
        ),
        Measured(
            value=float(axis.offset_px[1]) / distance,
            err=sqrt(float(axis.covariance_px2[1, 1])) / distance,
        ),
    )
    pierce = (float(axis.pierce_px[0]), float(axis.pierce_px[1]))
    if pupil.degrees_of_freedom == 0:
        notes = [*notes, "two heights alone: nothing checks them, and their error is not counted"]
    elif pupil.scatter_mm > 0.05:
        notes = [
            *notes,
            f"heights and images disagree by {pupil.scatter_mm:.3f} mm: check the stage, "
            "or that the lens was not refocused between captures",
        ]
    return GeometryCalibration(
        width_px=lens.width_px,
        height_px=lens.height_px,
        pupil=pupil,
        heights_mm=heights,
        scales=scales,
        scale_source=source,
        focal_length_px=focal,
        k1=k1,
        k2=k2,
        principal_px=principal,
        tilt_x_deg=tilts[0] if tilts else None,
        tilt_y_deg=tilts[1] if tilts else None,
        tilt_deg=length_of(*tilts) if tilts else None,
        axis_drift=drift,
        pierce_px=pierce,
        captures=_captures(series, captures, pupil, focal, axes),
        excluded=tuple((captures[i].name, reason) for i, reason in sorted(excluded.items())),
        undetermined=undetermined,
        notes=tuple(notes),
    )


def _scale(
    height_mm: float,
    pupil: PupilFit,
    focal: Measured,
    source: ScaleSource | None,
    board: int | None,
    *,
    lowest_mm: float,
) -> Measured:
    distance = height_mm + pupil.pupil_offset_mm
    value = focal.value / distance
    if board is not None:
        relative = pupil.log_distance_err(height_mm, board)
    elif source == "given":
        # Exact where it was given; elsewhere as good as the zoom-out from there.
        zoom, err = pupil.zoom(lowest_mm, height_mm)
        relative = err / zoom
    else:
        relative = pupil.pupil_offset_err_mm / distance
    return Measured(value=value, err=value * relative)


def _tilt(
    series: SeriesAdjustment, captures: Sequence[GeometryCapture], notes: list[str]
) -> tuple[Measured, Measured]:
    """Weighted mean of the series' tilts; of those that contradict the first, the first alone."""
    adjustment = series.adjustment
    found = []
    for number, lens in enumerate(adjustment.lenses):
        columns = adjustment.layout.shared_columns(number)[-2:]
        errs = np.sqrt(np.diag(adjustment.covariance)[columns])
        found.append((np.array([lens.tilt_x_rad, lens.tilt_y_rad]), errs))
    value, err = found[0]
    for number, (other, other_err) in enumerate(found[1:], start=1):
        away = np.abs(other - value) / np.hypot(err, other_err)
        if np.any(away > _DISAGREEMENT_SIGMAS):
            difference = degrees(float(np.hypot(*(other - value))))
            target = next(
                captures[m].target
                for m, s in zip(series.members, adjustment.layout.series, strict=True)
                if s == number
            )
            notes.append(
                f"{target} is inclined by {difference:.2f} degrees against the first target; "
                "the tilt is that of the first"
            )
            continue
        weight, other_weight = err**-2.0, other_err**-2.0
        value = (weight * value + other_weight * other) / (weight + other_weight)
        # The lens is common to all, so that their errors are not independent: the smaller one.
        err = np.minimum(err, other_err)
    # A tilt t moves the corner, at the radius r, by t r^2 / f.
    lens = adjustment.lenses[0]
    err = np.hypot(err, _SMOOTH_ERROR_PX * lens.focal_length_px / lens.corner_radius_px**2)
    return (
        Measured(value=degrees(float(value[0])), err=degrees(float(err[0]))),
        Measured(value=degrees(float(value[1])), err=degrees(float(err[1]))),
    )


def _axes(
    series: SeriesAdjustment, captures: Sequence[GeometryCapture]
) -> list[tuple[int, StageAxis]]:
    """Lines of travel, one a series, that of the smallest error first."""
    layout = series.adjustment.layout
    axes = []
    for number in range(layout.series_count):
        own = [c for c, s in enumerate(layout.series) if s == number]
        if len({captures[series.members[c]].height_mm for c in own}) >= 2:
            axes.append((number, stage_axis(series.adjustment, own)))
    return sorted(axes, key=lambda axis: float(np.trace(axis[1].covariance_px2)))


def _captures(
    series: SeriesAdjustment,
    captures: Sequence[GeometryCapture],
    pupil: PupilFit,
    focal: Measured | None,
    axes: list[tuple[int, StageAxis]],
) -> tuple[CaptureGeometry, ...]:
    adjustment, layout = series.adjustment, series.adjustment.layout
    by_series = dict(axes)
    result = []
    for place, member in enumerate(series.members):
        capture, number = captures[member], layout.series[place]
        unit = float(pupil.log_units[number])
        distance = exp(adjustment.poses[place].log_distance - unit)
        err = sqrt(
            float(adjustment.covariance[(layout.pose_columns(place)[0],) * 2])
            + (HEIGHT_FLOOR_MM / distance) ** 2
        )
        sideways = (0.0, 0.0)
        if number in by_series:
            own = [c for c, s in enumerate(layout.series) if s == number]
            x, y = by_series[number].sideways[own.index(place)] * exp(-unit)
            sideways = float(x), float(y)
        scale = None
        if focal is not None:
            value = focal.value / distance
            scale = Measured(value=value, err=value * err)
        result.append(
            CaptureGeometry(
                name=capture.name,
                index=capture.index,
                kind=capture.kind,
                target=capture.target,
                orientation_deg=capture.orientation_deg,
                height_mm=capture.height_mm,
                scale_px_per_mm=scale,
                height_residual_mm=float(pupil.height_residuals_mm[place]),
                sideways_mm=sideways,
                match_count=adjustment.match_counts[place],
                rms_px=adjustment.rms_px[place],
            )
        )
    return tuple(result)
