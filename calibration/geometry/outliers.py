"""Captures that contradict the others: a wrong height, a moved target, a target lifted."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import degrees, exp, hypot, sqrt

import numpy as np
from numpy.typing import NDArray

from calibration.errors import GeometryError
from calibration.geometry.pupil import PupilFit, fit_pupil, height_outlier
from calibration.geometry.series import GeometryCapture, SeriesAdjustment

__all__ = ["ConsistentSeries", "without_outliers"]

FloatArray = NDArray[np.float64]

_MOVED_SIGMAS = 6.0
_MOVED_MIN_MM = 0.5
"""A stage that wanders sideways is no mistake; a target that was pushed is."""
_TURNED_MIN_RAD = float(np.deg2rad(0.5))
_LIFTED_MIN_MM = 0.1
_DISAGREEMENT_SIGMAS = 4.0


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ConsistentSeries:
    """Series whose captures agree, their pupil offset, and remarks on series left out whole."""

    series: SeriesAdjustment
    pupil: PupilFit
    notes: tuple[str, ...]


def without_outliers(
    series: SeriesAdjustment, captures: Sequence[GeometryCapture], excluded: dict[int, str]
) -> ConsistentSeries:
    """Leave out captures whose height or place contradicts all others, worst first.

    Parameters
    ----------
    series
        The adjustment of all.
    captures
        What the members of ``series`` number.
    excluded
        Captures that are left out are added, with the reason.

    Raises
    ------
    GeometryError
        If the distances do not grow with the heights, or no target is left at two of them.
    """
    notes: list[str] = []
    while True:
        heights, numbers, log_distances, covariance = _distances(series, captures)
        found = height_outlier(heights, numbers, log_distances, covariance)
        if found is not None:
            place, fits_mm = found
            excluded[series.members[place]] = (
                f"its image fits a height of {fits_mm:.3f} mm, but {heights[place]:.3f} mm was "
                "read back: the stage slipped, or the target was lifted; retake it"
            )
            series = series.without([series.members[place]])
            continue
        pupil = _pupil(series, captures)
        moved = _moved(series, pupil)
        if moved is not None:
            place, reason = moved
            excluded[series.members[place]] = reason
            series = series.without([series.members[place]])
            continue
        lifted = _disagreeing_series(series, captures)
        if lifted is None:
            return ConsistentSeries(series=series, pupil=pupil, notes=tuple(notes))
        number, text = lifted
        notes.append(text)
        members = [m for m, s in zip(series.members, numbers, strict=True) if s == number]
        excluded.update(dict.fromkeys(members, "its target lies at another height"))
        series = series.without(members)


def _pupil(series: SeriesAdjustment, captures: Sequence[GeometryCapture]) -> PupilFit:
    heights, numbers, log_distances, covariance = _distances(series, captures)
    # Each series has a unit of its own: one height a series tells nothing, however many there are.
    if all(len(set(heights[np.equal(numbers, number)])) < 2 for number in set(numbers)):
        name = captures[series.members[0]].name
        raise GeometryError(
            f"{name}: no target is left that was captured at two heights; capture one at two "
            "heights or more without moving it in between"
        )
    try:
        return fit_pupil(heights, numbers, log_distances, covariance)
    except ValueError as error:
        target = captures[series.members[0]].target
        raise GeometryError(
            f"{target}: {error}; set stage.direction and the heights so that they grow upwards"
        ) from error


def _distances(
    series: SeriesAdjustment, captures: Sequence[GeometryCapture]
) -> tuple[FloatArray, tuple[int, ...], FloatArray, FloatArray]:
    """Heights, series, log distances and their covariance, one a capture."""
    layout = series.adjustment.layout
    columns = [layout.pose_columns(number)[0] for number in range(len(series.members))]
    return (
        np.array([captures[m].height_mm for m in series.members]),
        layout.series,
        np.array([pose.log_distance for pose in series.adjustment.poses]),
        series.adjustment.covariance[np.ix_(columns, columns)],
    )


def _moved(series: SeriesAdjustment, pupil: PupilFit) -> tuple[int, str] | None:
    """Find the capture that stands furthest beside the travel of the others of its series."""
    layout, poses = series.adjustment.layout, series.adjustment.poses
    worst: tuple[float, int, str] | None = None
    for number in range(layout.series_count):
        own = [c for c, s in enumerate(layout.series) if s == number]
        if len(own) < 4:
            continue
        to_mm = exp(-pupil.log_units[number])
        place = np.array([(p.x, p.y, p.distance) for p in (poses[c] for c in own)]) * to_mm
        turns = np.unwrap([poses[c].turn_rad for c in own])
        for left_out, capture in enumerate(own):
            rest = np.arange(len(own)) != left_out
            design = np.column_stack([np.ones(rest.sum()), place[rest, 2]])
            line, *_ = np.linalg.lstsq(design, place[rest, :2], rcond=None)
            beside = place[:, :2] - np.column_stack([np.ones(len(own)), place[:, 2]]) @ line
            freedom = 2 * (len(own) - 3)
            scatter = sqrt(float(np.sum(beside[rest] ** 2)) / freedom)
            away_mm = float(np.hypot(*beside[left_out]))
            turned = abs(turns[left_out] - float(np.median(turns[rest])))
            excess = away_mm / max(_MOVED_SIGMAS * scatter, _MOVED_MIN_MM)
            spread = float(np.ptp(turns[rest]))
            turned_excess = turned / max(_MOVED_SIGMAS * spread, _TURNED_MIN_RAD)
            most = max(excess, turned_excess)
            if most > 1 and (worst is None or most > worst[0]):
                what = (
                    f"{away_mm:.2f} mm sideways"
                    if excess >= turned_excess
                    else f"by {degrees(turned):.1f} degrees"
                )
                worst = most, capture, f"the target was moved {what} against the others; retake it"
    return None if worst is None else (worst[1], worst[2])


def _disagreeing_series(
    series: SeriesAdjustment, captures: Sequence[GeometryCapture]
) -> tuple[int, str] | None:
    """Find a series whose own pupil offset contradicts that of the first that has one."""
    heights, numbers, log_distances, covariance = _distances(series, captures)
    fits: list[tuple[int, PupilFit]] = []
    for number in range(max(numbers) + 1):
        own = np.array([s == number for s in numbers])
        if len(set(heights[own])) < 2:
            continue
        try:
            fit = fit_pupil(
                heights[own],
                [0] * int(own.sum()),
                log_distances[own],
                covariance[np.ix_(own, own)],
            )
        except ValueError:
            continue
        fits.append((number, fit))
    for number, fit in fits[1:]:
        first = fits[0][1]
        difference = fit.pupil_offset_mm - first.pupil_offset_mm
        err = hypot(
            fit.pupil_offset_err_mm * fit.interval_factor,
            first.pupil_offset_err_mm * first.interval_factor,
        )
        if abs(difference) > max(_DISAGREEMENT_SIGMAS / 1.96 * err, _LIFTED_MIN_MM):
            names = [
                next(captures[m] for m, s in zip(series.members, numbers, strict=True) if s == n)
                for n in (fits[0][0], number)
            ]
            return number, (
                f"{names[1].kind} {names[1].target} lies {-difference:+.2f} mm higher than "
                f"{names[0].kind} {names[0].target}; heights are counted from the latter, and "
                "the former is left out"
            )
    return None
