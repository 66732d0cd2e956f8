"""From captures at several heights to the geometry of camera and stage."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp, sqrt

from calibration.errors import GeometryError
from calibration.geometry.board import DEFAULT_BOARD, CharucoBoard
from calibration.geometry.bundle_adjustment import Adjustment
from calibration.geometry.camera import PlaneLens
from calibration.geometry.cross_validation import cross_validation
from calibration.geometry.document import ExcludedCapture, GeometryCalibration
from calibration.geometry.matching import adjust_captures
from calibration.geometry.outliers import ConsistentSeries, without_outliers
from calibration.geometry.series import Exclusion, GeometryCapture
from calibration.geometry.summary import FocalLength, summarised

_FOCAL_PER_WIDTH = 1.2
"""Focal length assumed if none is known, in image widths; it cancels except in the tilt."""
_FOCAL_CONVERGED = 2e-4
_FOCAL_ROUNDS = 4
_ALONE = "the other captures of its target are left out, and one capture alone is of no use"


@dataclass(frozen=True, slots=True, kw_only=True)
class GeometryOptions:
    """What is known beforehand.

    Parameters
    ----------
    nominal_focal_px
        Focal length divided by pixel pitch, both from the bench file.
    scale_px_per_mm
        Scale at the lowest height, if it was measured.
    board
        The ChArUco board that captures of kind board show.
    """

    nominal_focal_px: float | None = None
    scale_px_per_mm: float | None = None
    board: CharucoBoard = DEFAULT_BOARD


def calibrate_geometry(
    captures: Sequence[GeometryCapture],
    options: GeometryOptions | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> GeometryCalibration:
    """Measure pupil offset, scales, distortion, tilt and drift.

    Parameters
    ----------
    captures
        Captures of boards and textured targets, in any order, all of one image size.
    options
        What is known beforehand.
    progress
        Called with the number of captures matched.

    Raises
    ------
    GeometryError
        If the captures were made at one height, do not match, or contradict the stage; the message
        is one line that names the capture or target and the remedy.
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
    found = summarised(adjustment, consistent.pupil, focal, excluded, [*notes, *validated.faults])
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


def _focal_length(consistent: ConsistentSeries, given: GeometryOptions) -> FocalLength | None:
    adjustment, pupil = consistent.adjustment, consistent.pupil
    number = adjustment.first_in_mm
    if number is not None:
        value = adjustment.series[number].lens.focal_length_px * exp(-pupil.log_units[number])
        err = value * sqrt(float(pupil.covariance[1 + number, 1 + number]))
        return FocalLength(value=value, err=err, source="board")
    if given.scale_px_per_mm is not None:
        lowest_mm = min(one.capture.height_mm for one in adjustment.captures)
        return FocalLength(
            value=given.scale_px_per_mm * (lowest_mm + pupil.pupil_offset_mm),
            err=given.scale_px_per_mm * pupil.pupil_offset_err_mm,
            source="given",
        )
    if given.nominal_focal_px is not None:
        return FocalLength(value=given.nominal_focal_px, err=0.0, source="bench")
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
