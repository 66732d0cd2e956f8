"""Captures that contradict the others: a wrong height, a moved target, a lifted target."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import degrees, exp, hypot, sqrt

import numpy as np

from calibration.errors import GeometryError
from calibration.geometry.bundle_adjustment import Adjustment
from calibration.geometry.pupil import (
    PupilFit,
    SeriesDistances,
    counts_downwards,
    fit_pupil,
    height_outlier,
)
from calibration.geometry.series import Exclusion, Series

_MOVED_SIGMAS = 6.0
_MOVED_MIN_MM = 0.5
"""A stage that wanders sideways within this is normal; a target that was pushed is not."""
_TURNED_MIN_RAD = float(np.deg2rad(0.5))
_LIFTED_MIN_MM = 0.1
_DISAGREEMENT_SIGMAS = 4.0
_UPWARDS = (
    "set stage.direction, or read the scale, so that heights grow as the camera rises, and capture "
    "it again, or exclude its captures"
)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ConsistentSeries:
    """Series whose captures agree, their pupil offset, and the captures left out.

    ``notes`` are remarks on series that were left out completely.
    """

    adjustment: Adjustment
    pupil: PupilFit
    exclusions: tuple[Exclusion, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Contradiction:
    exclusions: tuple[Exclusion, ...]
    note: str | None = None


def without_outliers(adjustment: Adjustment) -> ConsistentSeries:
    """Leave out captures whose height or position contradicts all others, worst first.

    Raises
    ------
    GeometryError
        If the distances do not grow with the heights, or no target is left at two heights.
    """
    _refuse_falling_heights(adjustment)
    exclusions: list[Exclusion] = []
    notes: list[str] = []
    while True:
        found = _slipped(adjustment)
        if found is None:
            pupil = _pupil(adjustment)
            found = _moved(adjustment, pupil) or _lifted(adjustment)
        if found is None:
            return ConsistentSeries(
                adjustment=adjustment,
                pupil=pupil,
                exclusions=tuple(exclusions),
                notes=tuple(notes),
            )
        exclusions += found.exclusions
        notes += [] if found.note is None else [found.note]
        adjustment = adjustment.without([one.capture for one in found.exclusions])


def _refuse_falling_heights(adjustment: Adjustment) -> None:
    # One such series among others would not stop the fit, but scatter it by 100 mm.
    distances = SeriesDistances.of(adjustment)
    for number, series in enumerate(adjustment.series):
        own = distances.only(distances.series == number)
        if not counts_downwards(own):
            continue
        low, high = int(np.argmin(own.heights_mm)), int(np.argmax(own.heights_mm))
        larger = exp(own.log_distances[low] - own.log_distances[high])
        raise GeometryError(
            f"{series.target}: its heights count downwards: at {own.heights_mm[high]:g} mm the "
            f"image is {larger:.3g} times as large as at {own.heights_mm[low]:g} mm; "
            f"{_UPWARDS}",
            reason="heights_reversed",
            subject=series.target,
        )


def _pupil(adjustment: Adjustment) -> PupilFit:
    # Each series has its own unit, so series of one height determine nothing, however many.
    if all(len(set(series.heights_mm)) < 2 for series in adjustment.series):
        name = adjustment.captures[0].capture.name
        raise GeometryError(
            f"{name}: no target is left that was captured at two heights; capture one at two "
            "heights or more without moving it in between",
            reason="nothing_left",
            subject=name,
        )
    try:
        return fit_pupil(SeriesDistances.of(adjustment))
    except ValueError as error:
        target = adjustment.series[0].target
        raise GeometryError(
            f"{target}: {error}; {_UPWARDS}",
            reason="heights_reversed",
            subject=target,
        ) from error


def _slipped(adjustment: Adjustment) -> _Contradiction | None:
    """Find the capture whose height does not fit its image."""
    found = height_outlier(SeriesDistances.of(adjustment))
    if found is None:
        return None
    capture, fits_mm = adjustment.captures[found[0]].capture, found[1]
    reason = (
        f"its image fits a height of {fits_mm:.3f} mm, but {capture.height_mm:.3f} mm was "
        "read back: the stage slipped or the target was lifted; retake it"
    )
    return _Contradiction(exclusions=(Exclusion(capture=capture, reason=reason),))


def _moved(adjustment: Adjustment, pupil: PupilFit) -> _Contradiction | None:
    """Find the capture furthest to the side of the travel of the others in its series."""
    found = [
        candidate
        for series, log_unit in zip(adjustment.series, pupil.log_units, strict=True)
        for candidate in _moves(series, exp(-log_unit))
    ]
    if not found:
        return None
    return _Contradiction(exclusions=(max(found, key=lambda one: one[0])[1],))


def _moves(series: Series, mm_per_unit: float) -> Iterator[tuple[float, Exclusion]]:
    """Captures to the side of the others, and their distance relative to the tolerance."""
    count = len(series.captures)
    if count < 4:
        return
    poses = [one.pose for one in series.captures]
    position = np.array([(p.x, p.y, p.distance) for p in poses]) * mm_per_unit
    turns = np.unwrap([p.turn_rad for p in poses])
    for left_out, one in enumerate(series.captures):
        rest = np.arange(count) != left_out
        design = np.column_stack([np.ones(count), position[:, 2]])
        line, *_ = np.linalg.lstsq(design[rest], position[rest, :2], rcond=None)
        beside = position[:, :2] - design @ line
        scatter = sqrt(float(np.sum(beside[rest] ** 2)) / (2 * (count - 3)))
        away_mm = float(np.hypot(*beside[left_out]))
        turned = abs(turns[left_out] - float(np.median(turns[rest])))
        shift_ratio = away_mm / max(_MOVED_SIGMAS * scatter, _MOVED_MIN_MM)
        turn_ratio = turned / max(_MOVED_SIGMAS * float(np.ptp(turns[rest])), _TURNED_MIN_RAD)
        if max(shift_ratio, turn_ratio) > 1:
            what = (
                f"{away_mm:.2f} mm sideways"
                if shift_ratio >= turn_ratio
                else f"by {degrees(turned):.1f} degrees"
            )
            reason = f"the target was moved {what} relative to the other captures; retake it"
            yield max(shift_ratio, turn_ratio), Exclusion(capture=one.capture, reason=reason)


def _lifted(adjustment: Adjustment) -> _Contradiction | None:
    """Find a series whose own pupil offset contradicts that of the first series with one."""
    fits = _own_pupils(adjustment)
    for series, fit in fits[1:]:
        first_series, first = fits[0]
        difference = fit.pupil_offset_mm - first.pupil_offset_mm
        err = hypot(
            fit.pupil_offset_err_mm * fit.interval_factor,
            first.pupil_offset_err_mm * first.interval_factor,
        )
        if abs(difference) <= max(_DISAGREEMENT_SIGMAS / 1.96 * err, _LIFTED_MIN_MM):
            continue
        its, other = (
            f"{one.captures[0].capture.kind} {one.target}" for one in (series, first_series)
        )
        return _Contradiction(
            exclusions=tuple(
                Exclusion(capture=one.capture, reason="its target is at another height")
                for one in series.captures
            ),
            note=f"{its} is {-difference:+.2f} mm higher than {other}; heights are measured from "
            "the latter, and the former is left out",
        )
    return None


def _own_pupils(adjustment: Adjustment) -> list[tuple[Series, PupilFit]]:
    """Pupil offset of each series by itself, if it has two heights that grow with distance."""
    distances = SeriesDistances.of(adjustment)
    fits = []
    for number, series in enumerate(adjustment.series):
        if len(set(series.heights_mm)) < 2:
            continue
        try:
            fits.append((series, fit_pupil(distances.only(distances.series == number))))
        except ValueError:
            continue
    return fits
