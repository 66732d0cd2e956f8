"""The entrance pupil: distances from the images against heights from the stage.

Every distance of a series is ``unit * (height + pupil_offset)``. Each series has its own unit; the
offset is common to all. Heights that scatter by more than the errors of the images are given an
error of their own.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import degrees, exp, hypot, sqrt
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import t as student_t

from calibration.errors import GeometryError
from calibration.geometry._bundle_adjustment import Adjustment, Exclusion, Series
from simulation.arrays import BoolArray, FloatArray

HEIGHT_FLOOR_MM = 0.0005
"""Half of the last digit to which heights are recorded."""

_SCATTER_MAX_MM = 1000.0
_ITERATIONS = 50
_OUTLIER_SIGMAS = 6.0
_OUTLIER_MIN_MM = 0.02
"""Two motor steps or so: less is the normal error of a stage, not a mistake."""
_REVERSED = -0.5
"""Rank correlation: -1 where all heights fall, -1/3 where one of three is wrong."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PupilFit:
    """The pupil offset and the unit of each series, its distance per mm, with residuals.

    The covariance is of the offset and the log units. ``scatter_mm`` is the error of a height
    beyond that explained by the images. With no degrees of freedom, nothing was checked.
    """

    pupil_offset_mm: float
    log_units: FloatArray
    covariance: FloatArray
    scatter_mm: float
    degrees_of_freedom: int
    height_residuals_mm: FloatArray

    @property
    def pupil_offset_err_mm(self) -> float:
        """Standard error of the offset."""
        return float(np.sqrt(self.covariance[0, 0]))

    @property
    def interval_factor(self) -> float:
        """Half-width of a 95 % interval in standard errors: Student's if heights scatter."""
        if self.scatter_mm <= HEIGHT_FLOOR_MM or self.degrees_of_freedom == 0:
            return 1.96
        return float(student_t.ppf(0.975, self.degrees_of_freedom))

    def zoom(self, near_mm: float, far_mm: float) -> tuple[float, float]:
        """True zoom-out between two heights and its standard error."""
        near, far = near_mm + self.pupil_offset_mm, far_mm + self.pupil_offset_mm
        return far / near, abs(near - far) / near**2 * self.pupil_offset_err_mm

    def log_distance_err(self, height_mm: float, series: int) -> float:
        """Standard error of the logarithm of a fitted distance, in the unit of its series."""
        slope = np.zeros(len(self.covariance))
        slope[0] = 1 / (height_mm + self.pupil_offset_mm)
        slope[1 + series] = 1.0
        return float(np.sqrt(slope @ self.covariance @ slope))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SeriesDistances:
    """Heights of captures, and the distances of the camera according to the images.

    Log distances and their covariance are in each series' own unit; series count from 0.
    """

    heights_mm: FloatArray
    series: NDArray[np.intp]
    log_distances: FloatArray
    covariance: FloatArray

    @classmethod
    def of(cls, adjustment: Adjustment) -> Self:
        """Distances of the captures of an adjustment."""
        captures, columns = adjustment.captures, adjustment.columns
        log_distance = [columns.pose(one.capture)[0] for one in captures]
        counts = [len(own.captures) for own in adjustment.series]
        return cls(
            heights_mm=np.array([one.capture.height_mm for one in captures]),
            series=np.repeat(np.arange(len(counts)), counts),
            log_distances=np.array([one.pose.log_distance for one in captures]),
            covariance=adjustment.covariance[np.ix_(log_distance, log_distance)],
        )

    def only(self, chosen: BoolArray) -> Self:
        """Distances of the chosen captures, with their series renumbered."""
        return replace(
            self,
            heights_mm=self.heights_mm[chosen],
            series=np.unique(self.series[chosen], return_inverse=True)[1],
            log_distances=self.log_distances[chosen],
            covariance=self.covariance[np.ix_(chosen, chosen)],
        )

    @property
    def spans_mm(self) -> FloatArray:
        """Range of each series' heights."""
        return np.array(
            [np.ptp(self.heights_mm[self.series == n]) for n in range(int(self.series.max()) + 1)]
        )

    @property
    def degrees_of_freedom(self) -> int:
        """Number of captures minus one for the pupil offset and one for the unit of each series."""
        return len(self.heights_mm) - 2 - int(self.series.max())


def _fit_pupil(distances: SeriesDistances) -> PupilFit:
    """Fit the offset and units to the distances of all captures.

    References
    ----------
    The scatter brings the weighted squares to their expected value: Paule and Mandel,
    "Consensus values and weighting factors", J. Res. NBS 87, 1982.
    """
    freedom = distances.degrees_of_freedom
    start_mm = _start_mm(distances)
    fit, square = _weighted_fit(distances, start_mm, HEIGHT_FLOOR_MM)
    if freedom > 0 and square > freedom:
        scatter_mm = float(
            brentq(
                lambda value: _weighted_fit(distances, start_mm, value)[1] - freedom,
                HEIGHT_FLOOR_MM,
                _SCATTER_MAX_MM,
                xtol=1e-5,
            )
        )
        fit, _ = _weighted_fit(distances, start_mm, scatter_mm)
    return fit


def _counts_downwards(distances: SeriesDistances) -> bool:
    """Whether the heights of one series fall as the camera rises, according to the images.

    By Kendall's rank correlation of what differs beyond errors: one wrong height does not turn it.
    """
    first, second = np.triu_indices(len(distances.heights_mm), k=1)
    rise_mm = distances.heights_mm[second] - distances.heights_mm[first]
    growth = distances.log_distances[second] - distances.log_distances[first]
    own = np.diag(distances.covariance)
    variance = own[first] + own[second] - 2 * distances.covariance[first, second]
    told = (np.abs(rise_mm) > _OUTLIER_MIN_MM) & (growth**2 > _OUTLIER_SIGMAS**2 * variance)
    if not told.any():
        return False
    return bool(np.mean(np.sign(rise_mm[told] * growth[told])) <= _REVERSED)


def _height_outlier(distances: SeriesDistances) -> tuple[int, float] | None:
    """Find the capture whose height does not fit its image, while all others agree.

    Its index, and the height in mm that fits its image; None if no single capture stands out, or if
    too few are left to decide.
    """
    worst: tuple[float, int, float] | None = None
    for capture, (height_mm, series) in enumerate(
        zip(distances.heights_mm, distances.series, strict=True)
    ):
        rest = np.arange(len(distances.heights_mm)) != capture
        # The series is kept, so that its number does not change.
        if len(set(distances.heights_mm[rest & (distances.series == series)])) < 3:
            continue
        try:
            fit = _fit_pupil(distances.only(rest))
        except ValueError:
            continue
        distance_mm = float(np.exp(distances.log_distances[capture] - fit.log_units[series]))
        fits_mm = distance_mm - fit.pupil_offset_mm
        err_mm = distance_mm * np.hypot(
            fit.log_distance_err(fits_mm, int(series)),
            np.sqrt(distances.covariance[capture, capture]),
        )
        # With few captures the scatter of the others is itself uncertain.
        limit_mm = fit.interval_factor / 1.96 * np.hypot(err_mm, fit.scatter_mm)
        ratio = abs(height_mm - fits_mm) / max(limit_mm * _OUTLIER_SIGMAS, _OUTLIER_MIN_MM)
        if ratio > 1 and (worst is None or ratio > worst[0]):
            worst = ratio, capture, fits_mm
    return None if worst is None else (worst[1], worst[2])


def _start_mm(distances: SeriesDistances) -> float:
    """Offset by a straight line through the series with the widest range of heights."""
    chosen = distances.series == int(np.argmax(distances.spans_mm))
    slope, level = np.polyfit(
        distances.heights_mm[chosen], np.exp(distances.log_distances[chosen]), 1
    )
    if slope <= 0:
        raise ValueError("according to the images, the camera comes nearer as the stage goes up")
    return float(level / slope)


def _weighted_fit(
    distances: SeriesDistances, start_mm: float, scatter_mm: float
) -> tuple[PupilFit, float]:
    """Offset and units for heights with this scatter, and the weighted squares left."""
    heights_mm, offset_mm = distances.heights_mm, start_mm
    members = np.eye(int(distances.series.max()) + 1)[distances.series]
    for _ in range(_ITERATIONS):
        offset_mm = max(offset_mm, 1e-3 - float(heights_mm.min()))
        distance_mm = heights_mm + offset_mm
        weights = np.linalg.inv(distances.covariance + np.diag((scatter_mm / distance_mm) ** 2))
        design = np.column_stack([1 / distance_mm, members])
        normal = np.asarray(np.linalg.inv(design.T @ weights @ design), dtype=np.float64)
        solution = normal @ design.T @ weights @ (distances.log_distances - np.log(distance_mm))
        offset_mm += float(solution[0])
        if abs(solution[0]) < 1e-9 * float(distance_mm.max()):
            break
    distance_mm = heights_mm + offset_mm
    left = distances.log_distances - np.log(distance_mm) - members @ solution[1:]
    fit = PupilFit(
        pupil_offset_mm=offset_mm,
        log_units=solution[1:],
        covariance=normal,
        scatter_mm=scatter_mm,
        degrees_of_freedom=distances.degrees_of_freedom,
        height_residuals_mm=-left * distance_mm,
    )
    return fit, float(left @ weights @ left)


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
    """Series whose captures agree, their pupil offset, captures left out, and remarks."""

    adjustment: Adjustment
    pupil: PupilFit
    exclusions: tuple[Exclusion, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Contradiction:
    exclusions: tuple[Exclusion, ...]
    note: str | None = None


def without_outliers(adjustment: Adjustment) -> ConsistentSeries:
    """Leave out captures whose height or position contradicts all others, worst first."""
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
        if not _counts_downwards(own):
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
        return _fit_pupil(SeriesDistances.of(adjustment))
    except ValueError as error:
        target = adjustment.series[0].target
        raise GeometryError(
            f"{target}: {error}; {_UPWARDS}",
            reason="heights_reversed",
            subject=target,
        ) from error


def _slipped(adjustment: Adjustment) -> _Contradiction | None:
    """Find the capture whose height does not fit its image."""
    found = _height_outlier(SeriesDistances.of(adjustment))
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
            fits.append((series, _fit_pupil(distances.only(distances.series == number))))
        except ValueError:
            continue
    return fits
