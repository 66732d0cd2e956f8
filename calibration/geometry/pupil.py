"""The entrance pupil's place: distances from the images against heights from the stage.

Every distance of a series is ``unit * (height + pupil_offset)``. The unit is the series' own, the
offset is common to all. Heights that scatter more than the images account for are given an error of
their own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import t as student_t

__all__ = ["PupilFit", "fit_pupil", "height_outlier"]

FloatArray = NDArray[np.float64]

HEIGHT_FLOOR_MM = 0.0005
"""Half of the last digit that heights are recorded with."""

_SCATTER_MAX_MM = 1000.0
_ITERATIONS = 50
_OUTLIER_SIGMAS = 6.0
_OUTLIER_MIN_MM = 0.02
"""Two motor steps or so: less is a stage's ordinary error, not a mistake."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PupilFit:
    """The pupil offset and the unit of each series, with what is left.

    Parameters
    ----------
    pupil_offset_mm
        Distance of the entrance pupil from the plane at height zero.
    log_units
        Logarithm of each series' unit: its distance per mm.
    covariance
        Of the offset and the log units, in this order.
    scatter_mm
        Error of a height beyond what the images account for.
    degrees_of_freedom
        Captures beyond those that are needed; without any nothing was checked.
    height_residuals_mm
        Height that was read less the one that each capture's distance fits.
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
        """Standard errors on each side of a 95 % interval: Student's where heights scatter."""
        if self.scatter_mm <= HEIGHT_FLOOR_MM or self.degrees_of_freedom == 0:
            return 1.96
        return float(student_t.ppf(0.975, self.degrees_of_freedom))

    def zoom(self, near_mm: float, far_mm: float) -> tuple[float, float]:
        """True zoom-out of two heights and its standard error."""
        near, far = near_mm + self.pupil_offset_mm, far_mm + self.pupil_offset_mm
        return far / near, abs(near - far) / near**2 * self.pupil_offset_err_mm

    def log_distance_err(self, height_mm: float, series: int) -> float:
        """Standard error of the logarithm of a fitted distance, in the unit of its series."""
        slope = np.zeros(len(self.covariance))
        slope[0] = 1 / (height_mm + self.pupil_offset_mm)
        slope[1 + series] = 1.0
        return float(np.sqrt(slope @ self.covariance @ slope))


def fit_pupil(
    heights_mm: FloatArray,
    series: Sequence[int],
    log_distances: FloatArray,
    covariance: FloatArray,
) -> PupilFit:
    """Fit offset and units to the distances of all captures.

    Parameters
    ----------
    heights_mm
        Read back, one a capture; at least one series has two different ones.
    series
        Number of each capture's series, from 0 on without gaps.
    log_distances, covariance
        From the images, shapes (n,) and (n, n).

    Raises
    ------
    ValueError
        If the distances do not grow with the heights.

    References
    ----------
    The scatter makes the weighted squares equal to their expectation: Paule and Mandel,
    "Consensus values and weighting factors", J. Res. NBS 87, 1982.
    """
    count = max(series) + 1
    freedom = len(heights_mm) - 1 - count
    start = _start_mm(heights_mm, np.asarray(series), log_distances)

    def fitted(scatter_mm: float) -> tuple[PupilFit, float]:
        return _weighted_fit(
            heights_mm, np.asarray(series), log_distances, covariance, scatter_mm, start, freedom
        )

    fit, square = fitted(HEIGHT_FLOOR_MM)
    if freedom > 0 and square > freedom:
        scatter_mm = float(
            brentq(
                lambda value: fitted(value)[1] - freedom,
                HEIGHT_FLOOR_MM,
                _SCATTER_MAX_MM,
                xtol=1e-5,
            )
        )
        fit, _ = fitted(scatter_mm)
    return fit


def height_outlier(
    heights_mm: FloatArray,
    series: Sequence[int],
    log_distances: FloatArray,
    covariance: FloatArray,
) -> tuple[int, float] | None:
    """Find the capture whose height does not fit its image, while all others agree.

    Returns
    -------
    tuple of int and float, or None
        Its place, and the height in mm that its image fits. None where no single capture stands
        out, or too few are left to tell.
    """
    worst: tuple[float, int, float] | None = None
    places = np.asarray(series)
    for capture in range(len(heights_mm)):
        rest = np.arange(len(heights_mm)) != capture
        own = places[rest] == places[capture]
        if np.count_nonzero(own) < 3 or len(set(heights_mm[rest][own])) < 3:
            continue
        inside = np.ix_(rest, rest)
        try:
            fit = fit_pupil(
                heights_mm[rest], places[rest].tolist(), log_distances[rest], covariance[inside]
            )
        except ValueError:
            continue
        unit = fit.log_units[places[capture]]
        fits_mm = float(np.exp(log_distances[capture] - unit)) - fit.pupil_offset_mm
        distance_mm = fits_mm + fit.pupil_offset_mm
        err_mm = distance_mm * np.hypot(
            fit.log_distance_err(fits_mm, int(places[capture])),
            np.sqrt(covariance[capture, capture]),
        )
        # With few captures the scatter of the others is itself uncertain.
        limit_mm = fit.interval_factor / 1.96 * np.hypot(err_mm, fit.scatter_mm)
        excess = abs(heights_mm[capture] - fits_mm) / max(
            limit_mm * _OUTLIER_SIGMAS, _OUTLIER_MIN_MM
        )
        if excess > 1 and (worst is None or excess > worst[0]):
            worst = excess, capture, fits_mm
    return None if worst is None else (worst[1], worst[2])


def _start_mm(heights_mm: FloatArray, series: NDArray[np.intp], log_distances: FloatArray) -> float:
    """Offset by a straight line through the series that spans most heights."""
    spans = [np.ptp(heights_mm[series == number]) for number in range(int(series.max()) + 1)]
    chosen = series == int(np.argmax(spans))
    slope, level = np.polyfit(heights_mm[chosen], np.exp(log_distances[chosen]), 1)
    if slope <= 0:
        raise ValueError("the images say that the camera comes nearer where the stage goes up")
    return float(level / slope)


def _weighted_fit(
    heights_mm: FloatArray,
    series: NDArray[np.intp],
    log_distances: FloatArray,
    covariance: FloatArray,
    scatter_mm: float,
    offset_mm: float,
    freedom: int,
) -> tuple[PupilFit, float]:
    lowest_mm = float(heights_mm.min())
    members = np.eye(int(series.max()) + 1)[series]
    for _ in range(_ITERATIONS):
        offset_mm = max(offset_mm, 1e-3 - lowest_mm)
        distance_mm = heights_mm + offset_mm
        weights = np.linalg.inv(covariance + np.diag((scatter_mm / distance_mm) ** 2))
        design = np.column_stack([1 / distance_mm, members])
        normal = np.asarray(np.linalg.inv(design.T @ weights @ design), dtype=np.float64)
        start = np.concatenate([[0.0], np.zeros(members.shape[1])])
        solution = start + normal @ design.T @ weights @ (log_distances - np.log(distance_mm))
        offset_mm += float(solution[0])
        if abs(solution[0]) < 1e-9 * float(distance_mm.max()):
            break
    distance_mm = heights_mm + offset_mm
    left = log_distances - np.log(distance_mm) - members @ solution[1:]
    fit = PupilFit(
        pupil_offset_mm=offset_mm,
        log_units=solution[1:],
        covariance=normal,
        scatter_mm=scatter_mm,
        degrees_of_freedom=freedom,
        height_residuals_mm=-left * distance_mm,
    )
    return fit, float(left @ weights @ left)
