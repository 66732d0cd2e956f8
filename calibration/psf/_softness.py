"""The softness of the target itself: constant in mm, so that it grows in px as the camera nears.

Over captures at several heights the variance across an edge is that of the camera and ``B s^2``,
with s the scale of the capture over that of the nearest. B is a target's softness where it is
significant, fits each height, and explains the heights as well as a straight line over height does,
which a focus that drifts would give. Then it is no property of the camera, and is taken off.
"""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Literal

import numpy as np
from scipy.special import fdtrc, ndtr, stdtr

from acquisition.files import StoredModel
from calibration.edges import EdgeMeasurement
from calibration.psf._covariance import VarianceFit, fit_variances
from calibration.psf._repeatability import SharedByCapture, by_capture, capture_of, widths_of
from simulation.arrays import FloatArray
from simulation.compiled import compiled

ScaleSource = Literal["heights", "sides"]

_SAME_SCALE = 0.02
_SAME_DIRECTION_DEG, _SAME_LENGTH = 4.0, 0.15
# Of the length that was measured, which ends before the corners: by so much more, in px.
_LEAST_APART, _MOST_APART, _CORNERS_PX = 0.9, 1.2, 12.0
_PUPIL_ERR_MM = 30.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _CaptureScales:
    """Relative scale of the target in the capture of each edge; shape ``(edges,)``.

    ``sides_px`` are the sides of squares, None where the scales are those of the heights;
    ``height_mm`` is None where they are not known.
    """

    source: ScaleSource
    height_mm: FloatArray | None
    sides_px: FloatArray | None

    @property
    def has_pupil(self) -> bool:
        """Whether the scales depend on the distance of the entrance pupil."""
        return self.sides_px is None

    @property
    def pupil_precision(self) -> float:
        """Inverse variance of the distance from the height's zero to the entrance pupil."""
        return _PUPIL_ERR_MM**-2

    def relative(self, pupil_mm: float) -> FloatArray:
        """Scale of each edge over that of the nearest capture."""
        if self.sides_px is not None:
            return np.asarray(self.sides_px / self.sides_px.max())
        assert self.height_mm is not None
        away_mm = self.height_mm + pupil_mm
        return np.asarray(away_mm.min() / away_mm)

    def slope_per_mm(self, pupil_mm: float) -> FloatArray:
        """Derivative of the squared scale by the distance of the pupil."""
        if self.sides_px is not None:
            return np.zeros_like(self.sides_px)
        assert self.height_mm is not None
        away_mm = self.height_mm + pupil_mm
        nearest_mm = away_mm.min()
        return np.asarray(2 * nearest_mm * (away_mm - nearest_mm) / away_mm**3)

    @property
    def distinct(self) -> int:
        """Number of scales that differ by more than a few per cent."""
        scales = np.sort(np.log(self.relative(0.0)))
        return 1 + int(np.count_nonzero(np.diff(np.unique(scales)) > _SAME_SCALE))


def _capture_scales(edges: Sequence[EdgeMeasurement]) -> _CaptureScales | None:
    """Return the scales of the captures: by the squares they show, or by their heights.

    Sides tell a scale without the distance of the entrance pupil; where heights are known as well,
    they count if they shrink with the height as in a pinhole, and are then those of one square.
    None where a capture has neither a height nor two sides that face each other.
    """
    heights = [edge.height_mm for edge in edges if edge.height_mm is not None]
    is_known = len(heights) == len(edges) and min(heights, default=0.0) > 0
    height_mm = np.array(heights) if is_known else None
    sides_px = _sides_px(edges)
    if sides_px is not None and (height_mm is None or _is_pinhole(height_mm, sides_px)):
        return _CaptureScales(source="sides", height_mm=height_mm, sides_px=sides_px)
    if height_mm is None:
        return None
    return _CaptureScales(source="heights", height_mm=height_mm, sides_px=None)


def _is_pinhole(height_mm: FloatArray, sides_px: FloatArray) -> bool:
    """Whether the side is inversely proportional to the distance from some point."""
    if np.ptp(height_mm) == 0:
        return False
    design = np.column_stack([height_mm, np.ones_like(height_mm)]) * sides_px[:, None]
    values = np.linalg.lstsq(design, np.ones_like(height_mm), rcond=None)[0]
    return bool(np.abs(design @ values - 1).max() < _SAME_SCALE)


def _sides_px(edges: Sequence[EdgeMeasurement]) -> FloatArray | None:
    sides = {key: side_px(some) for key, some in by_capture(edges).items()}
    known = [sides[capture_of(edge)] for edge in edges]
    if any(side is None for side in known):
        return None
    return np.array(known, dtype=np.float64)


def side_px(edges: Sequence[EdgeMeasurement]) -> float | None:
    """Median distance between sides of a square that face each other; None for no such sides."""
    values = [(edge.angle_deg + 90.0, edge.x_px, edge.y_px, edge.length_px) for edge in edges]
    known = _facing_px(np.array(values, dtype=np.float64).reshape(-1, 4))
    return float(np.median(known)) if known.size else None


@compiled()
def _facing_px(edges: FloatArray) -> FloatArray:
    """Distances between sides that face each other; rows of normal in degrees, x, y and length."""
    apart_px = np.empty(len(edges) * (len(edges) - 1) // 2)
    count = 0
    for i in range(len(edges)):
        normal_deg, x_px, y_px, length_px = edges[i]
        for j in range(i + 1, len(edges)):
            turn_deg = (normal_deg - edges[j, 0] + 90.0) % 180.0 - 90.0
            mean_px = 0.5 * (length_px + edges[j, 3])
            if abs(turn_deg) > _SAME_DIRECTION_DEG:
                continue
            if abs(length_px - edges[j, 3]) > _SAME_LENGTH * mean_px:
                continue
            normal_rad = np.deg2rad(normal_deg - 0.5 * turn_deg)
            dx, dy = x_px - edges[j, 1], y_px - edges[j, 2]
            apart = abs(dx * np.cos(normal_rad) + dy * np.sin(normal_rad))
            aside = abs(dy * np.cos(normal_rad) - dx * np.sin(normal_rad))
            if aside >= 0.5 * mean_px:
                continue
            if _LEAST_APART * mean_px < apart < _MOST_APART * mean_px + _CORNERS_PX:
                apart_px[count] = apart
                count += 1
    return apart_px[:count]


_SOFT_P = 0.01
_MISFIT_P = 0.01
_AS_WELL = 2.0  # of chi-squared
_FEWEST_SCALES = 3
_ROUNDS = 4


class TargetSoftness(StoredModel):
    """The blur of the edge target itself, over which the camera's PSF lies.

    ``variance_px2`` is what it adds across edges in the nearest capture, below 0 where widths fall
    towards the target, ``mean_variance_px2`` the average over the edges. ``sigma_mm`` is null where
    focal length, pixel pitch or heights are not known, ``pupil_offset_mm`` where the scales are
    those of sides. ``p_value`` is one-sided, of so much softness of a sharp target,
    ``p_value_misfit`` of heights so far from this model. If it ``is_removed``, the PSF is that of
    the camera.
    """

    variance_px2: float
    variance_err_px2: float
    sigma_px: float
    mean_variance_px2: float
    sigma_mm: float | None = None
    sigma_err_mm: float | None = None
    scale_from: ScaleSource
    nearest_height_mm: float | None
    pupil_offset_mm: float | None
    p_value: float
    p_value_misfit: float
    is_removed: bool

    def in_mm(self, focal_length_mm: float, pixel_pitch_um: float) -> "TargetSoftness":
        """Return it with the blur on the target in mm."""
        if self.nearest_height_mm is None or self.sigma_px == 0:
            return self
        away_mm = self.nearest_height_mm + (self.pupil_offset_mm or 0.0)
        mm_per_px = away_mm * pixel_pitch_um * 1e-3 / focal_length_mm
        err_px = self.variance_err_px2 / (2 * self.sigma_px)
        return self.model_copy(
            update={"sigma_mm": self.sigma_px * mm_per_px, "sigma_err_mm": err_px * mm_per_px}
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SoftnessFit:
    """The softness, what it adds in each capture, and what it leaves unknown there.

    ``columns`` and ``precision`` are those of ``SharedByCapture``, empty where nothing is taken
    off.
    """

    document: TargetSoftness
    blur_px2: dict[Hashable, float]
    columns: FloatArray
    precision: FloatArray


def measure_softness(edges: Sequence[EdgeMeasurement]) -> SoftnessFit | None:
    """Tell the softness of the target from the widths at three or more scales, if they tell it."""
    scales = _capture_scales(edges) if edges else None
    if scales is None or scales.distinct < _FEWEST_SCALES:
        return None
    series = _Series.of(edges, scales)
    if np.linalg.matrix_rank(series.soft_design(0.0), tol=1e-6) < series.directions.shape[1] + 1:
        return None
    found = series.fitted()
    is_removed = found.is_soft and series.is_as_good_as_trend(found)
    squares = found.variance_px2 * scales.relative(found.pupil_mm) ** 2
    document = TargetSoftness(
        variance_px2=found.variance_px2,
        variance_err_px2=found.err_px2,
        sigma_px=sqrt(max(found.variance_px2, 0.0)),
        mean_variance_px2=float(squares.mean()),
        scale_from=scales.source,
        nearest_height_mm=None if scales.height_mm is None else float(scales.height_mm.min()),
        pupil_offset_mm=found.pupil_mm if scales.has_pupil else None,
        p_value=found.p_value,
        p_value_misfit=found.p_value_misfit,
        is_removed=is_removed,
    )
    columns, precision = np.empty((len(edges), 0)), np.empty(0)
    if is_removed:
        columns, precision = series.unknowns(found)
    keys = [capture_of(edge) for edge in edges]
    return SoftnessFit(
        document=document,
        blur_px2=dict(zip(keys, squares.tolist(), strict=True)) if is_removed else {},
        columns=columns,
        precision=precision,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Softness:
    """The softness of the nearest capture with its tests, chi-squared and weights."""

    variance_px2: float
    err_px2: float
    pupil_mm: float
    p_value: float
    p_value_misfit: float
    left: float
    weight: FloatArray
    between_px4: float

    @property
    def is_soft(self) -> bool:
        return self.variance_px2 > 0 and self.p_value < _SOFT_P and self.p_value_misfit > _MISFIT_P


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Series:
    """Edges of one target at several scales, in terms of a linear model of squared widths."""

    directions: FloatArray
    sigma_px: FloatArray
    err_px: FloatArray
    shared: SharedByCapture
    scales: _CaptureScales

    @classmethod
    def of(cls, edges: Sequence[EdgeMeasurement], scales: _CaptureScales) -> "_Series":
        sigma_px, err_px = widths_of(edges)
        return cls(
            directions=direction_columns(edges),
            sigma_px=sigma_px,
            err_px=err_px,
            shared=SharedByCapture.of(edges),
            scales=scales,
        )

    def soft_design(self, pupil_mm: float) -> FloatArray:
        return np.column_stack([self.directions, self.scales.relative(pupil_mm) ** 2])

    def fitted(self) -> _Softness:
        """Fit softness and pupil in turn; the pupil is known beforehand to a few cm."""
        pupil_mm, column = 0.0, np.zeros_like(self.sigma_px)
        has_pupil = self.scales.has_pupil
        for _ in range(_ROUNDS if has_pupil else 1):
            fit = self._fit(pupil_mm, column)
            variance_px2 = max(float(fit.values[-1]), 0.0)
            if has_pupil and fit.by_capture is not None and fit.by_capture.shared_values.size:
                pupil_mm = float(np.clip(fit.by_capture.shared_values[0], -90.0, 90.0))
            column = variance_px2 * self.scales.slope_per_mm(pupil_mm)
        fit = self._fit(pupil_mm, column)
        value, err = float(fit.values[-1]), sqrt(float(fit.covariance[-1, -1]))
        last = np.eye(fit.values.size)[-1]
        freedom = np.inf if fit.by_capture is None else fit.by_capture.freedom(last)
        p_value = float(ndtr(-value / err) if np.isinf(freedom) else stdtr(freedom, -value / err))
        weight = fit.weights / (4 * self.sigma_px**2 * (self.err_px**2 + fit.scatter_px**2))
        shared = fit.by_capture
        between = shared.scatter2_px4 if shared is not None and shared.holds_scatter else 0.0
        left = self._chi2(self.soft_design(pupil_mm), weight, between)
        if self.scales.has_pupil:  # how far it is from where pupils are counts as well
            left += pupil_mm**2 * self.scales.pupil_precision
        return _Softness(
            variance_px2=value,
            err_px2=err,
            pupil_mm=pupil_mm,
            p_value=p_value,
            p_value_misfit=self._p_misfit(left, weight, between),
            left=left,
            weight=weight,
            between_px4=between,
        )

    def unknowns(self, found: _Softness) -> tuple[FloatArray, FloatArray]:
        """Columns and precisions of what is not known exactly: the softness, and the pupil."""
        softness = self.scales.relative(found.pupil_mm) ** 2
        if not self.scales.has_pupil:
            return softness[:, None], np.zeros(1)
        pupil = found.variance_px2 * self.scales.slope_per_mm(found.pupil_mm)
        precision = np.array([0.0, self.scales.pupil_precision])
        return np.column_stack([softness, pupil]), precision

    def is_as_good_as_trend(self, found: _Softness) -> bool:
        """Whether a straight line over height, or over distance, explains no more."""
        away = self.scales.height_mm
        if away is None:
            away = 1 / self.scales.relative(0.0)
        design = np.column_stack([self.directions, away / away.max()])
        left = self._chi2(design, found.weight, found.between_px4)
        return found.left <= left + _AS_WELL

    def _fit(self, pupil_mm: float, column: FloatArray) -> VarianceFit:
        """Fit with the pupil as an unknown whose effect is linear about ``pupil_mm``."""
        design = self.soft_design(pupil_mm)
        squares = np.maximum(self.sigma_px**2 + pupil_mm * column, 0.01 * self.sigma_px**2)
        sigma = np.sqrt(squares)
        err = self.err_px * self.sigma_px / sigma
        shared = self.shared
        if column.any():
            precision = np.array([self.scales.pupil_precision])
            shared = replace(shared, columns=column[:, None], precision=precision)
        return fit_variances(design, sigma, err, shared=shared, is_resampled=False)

    def _p_misfit(self, left: float, weight: FloatArray, between_px4: float) -> float:
        """Probability of so much better a model in which each scale has a variance of its own."""
        scale = np.unique(np.round(np.log(self.scales.relative(0.0)), 3), return_inverse=True)[1]
        each = np.eye(int(scale.max()) + 1)[scale]
        free = np.column_stack([self.directions, each[:, 1:]])
        left_free = self._chi2(free, weight, between_px4)
        # The pupil takes none: it is known beforehand, and counted in ``left``.
        extra = int(scale.max()) - 1
        freedom = float(np.count_nonzero(weight)) - free.shape[1]
        if extra < 1 or freedom < 1 or left_free <= 0:
            return 1.0
        scatter = max(left_free / freedom, 1.0)
        return float(fdtrc(extra, freedom, max(left - left_free, 0.0) / extra / scatter))

    def _chi2(self, design: FloatArray, weight: FloatArray, between_px4: float) -> float:
        """Chi-squared with the scatter between captures in the weights."""
        group = self.shared.group
        sums = np.bincount(group, weight)
        shrunk = between_px4 / (1 + between_px4 * sums)
        one = np.eye(sums.size)[group]

        def over(left: FloatArray, right: FloatArray) -> FloatArray:
            by_capture = one.T @ (weight[:, None] * left), one.T @ (weight[:, None] * right)
            return np.asarray(
                left.T @ (weight[:, None] * right)
                - by_capture[0].T @ (shrunk[:, None] * by_capture[1])
            )

        squares = (self.sigma_px**2)[:, None]
        right = over(design, squares)
        values = np.linalg.lstsq(over(design, design), right, rcond=1e-12)[0]
        return float((over(squares, squares) - right.T @ values)[0, 0])


def direction_columns(edges: Sequence[EdgeMeasurement]) -> FloatArray:
    """Columns of the variance across edges: of xx, xy and yy, or of what they determine of it."""
    normal = np.array([edge.normal_rad for edge in edges])
    nx, ny = np.cos(normal), np.sin(normal)
    full = np.column_stack([nx**2, 2 * nx * ny, ny**2])
    if np.linalg.matrix_rank(full, tol=1e-3) == 3:
        return full
    names = sorted({edge.orientation for edge in edges})
    if len(names) == 1:
        return np.ones((len(edges), 1))
    return np.column_stack([[float(edge.orientation == name) for edge in edges] for name in names])
