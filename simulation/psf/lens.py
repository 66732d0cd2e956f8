"""The transfer function of a lens: a circular pupil out of focus, stretched, and a Gaussian."""

from dataclasses import dataclass
from functools import cache, lru_cache
from math import ceil, isfinite, pi, sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from simulation.arrays import FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import BSpline


CORRECTION_KNOTS_CY_PER_PX = np.array(
    [0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3]
)
"""Dense where a halo shows; above the last, edges are lost in noise."""

CORRECTION_SPLINES = len(CORRECTION_KNOTS_CY_PER_PX) - 2
"""Cubic splines that are 0 at the first knot and, with two derivatives, at the last."""

CORRECTION_HARMONICS = (1, 3, 5)
"""How many of 1, cos 2a, sin 2a, cos 4a and sin 4a there may be."""


@cache
def _splines() -> "BSpline":
    from scipy.interpolate import BSpline  # .2 s, where edges show more than a lens

    # The first knot fourfold: the first spline is 1 there, and has no weight. Beyond the last one
    # there must be three more; the splines that reach there have no weight either.
    return BSpline(
        np.concatenate([np.zeros(3), CORRECTION_KNOTS_CY_PER_PX, [1.4, 1.5, 1.6]]),
        np.eye(CORRECTION_SPLINES + 4)[:, 1:-3],
        3,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class OtfCorrection:
    """A part of a transfer function that is added to a parametric one; 0 at frequency 0.

    ``sum_m T_m(a) sum_j c_mj B_j(|f|)`` with the angle a of the frequency, the harmonics T_m and
    cubic B-splines B_j over ``CORRECTION_KNOTS_CY_PER_PX``. ``coefficients`` has a row for each
    harmonic, with ``CORRECTION_SPLINES`` finite numbers each.
    """

    coefficients: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        rows = self.coefficients
        if len(rows) not in CORRECTION_HARMONICS or {len(r) for r in rows} != {CORRECTION_SPLINES}:
            raise ValueError(
                f"a correction has 1, 3 or 5 rows of {CORRECTION_SPLINES} coefficients, "
                f"got rows of {[len(row) for row in rows]}"
            )
        if not all(isfinite(value) for row in rows for value in row):
            raise ValueError("the coefficients of a correction must be finite")

    def __repr__(self) -> str:
        return f"OtfCorrection({len(self.coefficients)} x {CORRECTION_SPLINES} coefficients)"

    def __call__(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """Return the correction at frequencies in cycles per pixel; the two are broadcast."""
        fx, fy = np.asarray(fx_cy_per_px), np.asarray(fy_cy_per_px)
        radial = correction_splines(np.hypot(fx, fy)) @ np.array(self.coefficients).T
        angular = correction_harmonics(np.arctan2(fy, fx), len(self.coefficients))
        return np.asarray(np.sum(radial * angular, axis=-1))


def correction_splines(freq_cy_per_px: FloatArray) -> FloatArray:
    """Values of the radial splines, shape ``(..., CORRECTION_SPLINES)``; 0 beyond the knots."""
    freq = np.asarray(freq_cy_per_px, dtype=np.float64)
    first, last = CORRECTION_KNOTS_CY_PER_PX[[0, -1]]
    return np.asarray(_splines()(np.clip(freq, first, last)))


def correction_roughness() -> FloatArray:
    """Integrals of the products of the splines' second derivatives, as a matrix."""
    node, weight = np.polynomial.legendre.leggauss(2)  # exact for products of straight lines
    widths = np.diff(CORRECTION_KNOTS_CY_PER_PX)[:, None]
    freq = CORRECTION_KNOTS_CY_PER_PX[:-1, None] + widths * (node + 1) / 2
    bend = _splines()(freq.ravel(), 2)
    return np.asarray((bend * (widths * weight / 2).reshape(-1, 1)).T @ bend)


def correction_harmonics(angle_rad: FloatArray, count: int) -> FloatArray:
    """Values of the first ``count`` harmonics of angles, shape ``(..., count)``."""
    angle = np.asarray(angle_rad, dtype=np.float64)
    turns = [np.ones_like(angle)]
    for order in (2, 4)[: count // 2]:
        turns += [np.cos(order * angle), np.sin(order * angle)]
    return np.stack(turns, axis=-1)


DEFOCUS_MAX_WAVES = 8.0
"""Beyond, the quadrature of the pupil is too coarse, and no measured PSF is so soft."""

_PUPIL_NODES = 96
_TABLE_STEPS = 1024
# Coarser tables, quick to make for each step of a fit: steps and nodes that are right to 3e-6 up to
# a squared defocus.
_SLOPE_TABLES = ((1.0, 128, 24), (4.0, 256, 24), (16.0, 512, 40))
_NO_WAVES = 1e-4  # below, the sine is its argument
# Over a range of squared defocus, curves at Chebyshev's points are right to 1e-8 if there are so
# many, and one for every two radians that the range turns the pupil's phase by.
_RANGE_CURVES = 10
_RAD_PER_WAVE = 2 * pi  # the most, half-way to the cut-off

SymmetricMatrix = tuple[float, float, float]
"""Elements xx, xy and yy."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LensOtf:
    """Optical transfer function of a lens without the pixel: real, signed, 1 at frequency 0.

    ``OTF(|B f|, w) exp(-2 pi^2 f^T S f) + C(f)``: a circular pupil with the defocus w, its cut-off
    stretched to an ellipse, a Gaussian for all else that blurs, and what edges show beyond. The
    path difference of an astigmatic pupil is a quadratic form of its coordinates with a matrix D.
    Along an axis of D the defocus is its eigenvalue, exactly; between the axes ``|D n|`` stands for
    it, which also blurs across n (a lens of 0.8 and 0.4 waves at f/4 is then right to 0.004, one
    with foci on both sides of the sensor, 0.8 and -0.4, to 0.04).

    ``cut_off_period_px`` is the symmetric matrix B in px: the pupil passes nothing where ``|B f|``
    is 1 or more. With zeros there is no pupil, and no diffraction. ``defocus_waves2`` is the
    symmetric matrix ``D^2``, in squared wavelengths of path difference at the pupil's rim; ``(w2,
    0, w2)`` for a defocus of w waves without astigmatism, up to ``DEFOCUS_MAX_WAVES``.
    ``gaussian_px2`` is the covariance S of the Gaussian, ``correction`` the part C.

    References
    ----------
    H. H. Hopkins, "The frequency response of a defocused optical system", Proc. R. Soc. A 231
    (1955), 91-103.
    """

    cut_off_period_px: SymmetricMatrix = (0.0, 0.0, 0.0)
    defocus_waves2: SymmetricMatrix = (0.0, 0.0, 0.0)
    gaussian_px2: SymmetricMatrix = (0.0, 0.0, 0.0)
    correction: OtfCorrection | None = None

    def __post_init__(self) -> None:
        for name in ("cut_off_period_px", "defocus_waves2", "gaussian_px2"):
            xx, xy, yy = values = getattr(self, name)
            if not all(isfinite(value) for value in values):
                raise ValueError(f"{name} must be finite, got {values}")
            # Rounding may leave a singular matrix a hair below 0.
            if min(xx, yy) < 0 or xx * yy - xy * xy < -1e-9 * (xx + yy) ** 2:
                raise ValueError(f"{name} must not be negative definite, got {values}")
        if max(self.defocus_waves2) > DEFOCUS_MAX_WAVES**2:
            raise ValueError(
                f"defocus_waves2 must be at most {DEFOCUS_MAX_WAVES**2:g}, "
                f"got {self.defocus_waves2}"
            )

    def __call__(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """Return the transfer at frequencies in cycles per pixel; the two are broadcast."""
        fx, fy = np.asarray(fx_cy_per_px), np.asarray(fy_cy_per_px)
        xx, xy, yy = self.gaussian_px2
        transfer = np.exp(-2 * pi**2 * (xx * fx * fx + 2 * xy * fx * fy + yy * fy * fy))
        xx, xy, yy = self.cut_off_period_px
        if not xx == xy == yy == 0:
            relative = np.hypot(xx * fx + xy * fy, xy * fx + yy * fy)
            transfer = transfer * _pupil_otf(relative, self._defocus_waves(fx, fy))
        return np.asarray(
            transfer if self.correction is None else transfer + self.correction(fx, fy)
        )

    def _defocus_waves(self, fx: FloatArray, fy: FloatArray) -> float | FloatArray:
        """Defocus that counts along frequencies: one for all without astigmatism."""
        xx, xy, yy = self.defocus_waves2
        if xx == yy and xy == 0:
            return sqrt(xx)
        square = np.maximum(fx * fx + fy * fy, 1e-300)
        along = (xx * fx * fx + 2 * xy * fx * fy + yy * fy * fy) / square
        return np.asarray(np.sqrt(np.maximum(along, 0.0)))


def _pupil_otf(relative_freq: FloatArray, defocus_waves: float | FloatArray) -> FloatArray:
    """Transfer of a circular pupil out of focus, at frequencies over the cut-off frequency.

    From a table over ``acos``, in which the curve is smooth up to its end; right to 1e-9 up to a
    wave of defocus, and to 3e-6 at the most. A defocus for each frequency, as an astigmatic pupil
    has, broadcasts with them, and is between tables.
    """
    relative = np.asarray(relative_freq, dtype=np.float64)
    if isinstance(defocus_waves, np.ndarray):
        relative, waves = np.broadcast_arrays(relative, defocus_waves)
        inside = relative < 1
        out = np.zeros(relative.shape)
        out[inside] = _between_tables(np.arccos(relative[inside]), waves[inside] ** 2)
        return out
    values, _ = _pupil_table(abs(defocus_waves)).at(np.arccos(np.minimum(relative, 1.0)))
    return np.where(relative < 1, values[..., 0], 0.0)


def _between_tables(angle_rad: FloatArray, defocus_waves2: FloatArray) -> FloatArray:
    """Transfer at angles ``acos(nu)`` and squared defocus, shape ``(n,)``, a polynomial in that."""
    if not angle_rad.size:
        return np.zeros(0)
    low, high = float(defocus_waves2.min()), float(defocus_waves2.max())
    turn_rad = _RAD_PER_WAVE * (sqrt(high) - sqrt(low))
    count = _RANGE_CURVES + ceil(turn_rad / 2)
    place = np.cos(pi * (np.arange(count) + 0.5) / count)
    nodes = 0.5 * (low + high) + 0.5 * (high - low) * place
    curves = np.stack([_pupil_table(sqrt(node)).at(angle_rad)[0][:, 0] for node in nodes.tolist()])
    series = np.polynomial.chebyshev.chebvander(place, count - 1)
    weight = np.where(np.arange(count) == 0, 1.0, 2.0) / count
    at = (2 * defocus_waves2 - low - high) / max(high - low, 1e-300)
    coefficients = (weight[:, None] * series.T) @ curves
    return np.asarray(
        np.polynomial.chebyshev.chebval(np.clip(at, -1, 1), coefficients, tensor=False)
    )


class _PupilSlopes(NamedTuple):
    """Transfer of a pupil, its slope by relative frequency and by the square of the defocus."""

    otf: FloatArray
    by_freq: FloatArray
    by_defocus_waves2: FloatArray


def pupil_slopes(relative_freq: FloatArray, defocus_waves2: FloatArray) -> _PupilSlopes:
    """Return ``_pupil_otf`` with its derivatives, for whoever fits it; right to 3e-6.

    The transfer depends on the square of the defocus, in which it is smooth at 0. There is one for
    each entry of the frequencies' last axis, or one for all.
    """
    relative = np.asarray(relative_freq, dtype=np.float64)
    each, which = np.unique(defocus_waves2, return_inverse=True)
    if each.size == 1:
        return _slopes_at(relative, float(each[0]))
    out = _PupilSlopes(
        *(np.empty(np.broadcast_shapes(relative.shape, which.shape)) for _ in range(3))
    )
    relative = np.broadcast_to(relative, out.otf.shape)
    for k, waves2 in enumerate(each.tolist()):
        for whole, some in zip(out, _slopes_at(relative[..., which == k], waves2), strict=True):
            whole[..., which == k] = some
    return out


def _slopes_at(relative: FloatArray, defocus_waves2: float) -> _PupilSlopes:
    inside = relative < 1
    angle = np.arccos(np.minimum(relative, 1.0))
    values, by_angle = _slope_table(defocus_waves2).at(angle)
    # d(angle)/d(nu) = -1 / sin(angle); at the cut-off the transfer falls with the angle's cube.
    by_freq = -by_angle[..., 0] / np.maximum(np.sin(angle), 1e-9)
    return _PupilSlopes(
        np.where(inside, values[..., 0], 0.0),
        np.where(inside, by_freq, 0.0),
        np.where(inside, values[..., 1], 0.0),
    )


class _Table(NamedTuple):
    """Curves over the angle ``acos(nu)`` in equal steps up to a right angle: a column each."""

    values: FloatArray
    slopes: FloatArray
    """Derivatives by the angle, times its step."""

    def at(self, angle_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values and derivatives by the angle, shape ``(..., curves)``: cubic between steps."""
        steps_per_rad = (len(self.values) - 1) / (pi / 2)
        place = angle_rad * steps_per_rad
        left = np.minimum(place.astype(np.intp), len(self.values) - 2)
        t = (place - left)[..., None]
        start, slope, slope_after = self.values[left], self.slopes[left], self.slopes[left + 1]
        rise = self.values[left + 1] - start
        bend = 3 * rise - 2 * slope - slope_after
        twist = slope + slope_after - 2 * rise
        values = start + t * (slope + t * (bend + t * twist))
        return values, steps_per_rad * (slope + t * (2 * bend + t * 3 * twist))


@lru_cache(maxsize=64)
def _slope_table(defocus_waves2: float) -> _Table:
    """Table of the transfer, and of its slope by the squared defocus."""
    for most, steps, nodes in _SLOPE_TABLES:
        if defocus_waves2 <= most:
            return _pupil_curves(defocus_waves2, steps, nodes)
    return _pupil_curves(defocus_waves2, _TABLE_STEPS, _PUPIL_NODES)


@lru_cache(maxsize=64)
def _pupil_table(defocus_waves: float) -> _Table:
    """Table of the transfer."""
    both = _pupil_curves(defocus_waves**2, _TABLE_STEPS, _PUPIL_NODES)
    return _Table(both.values[:, :1], both.slopes[:, :1])


def _pupil_curves(defocus_waves2: float, steps: int, nodes: int) -> _Table:
    """The transfer, and its slope by the squared defocus; both with their derivatives."""
    area, area_slope, turn, turn_slope = _pupil_slices(steps, nodes)
    waves = sqrt(defocus_waves2)
    cosine, sine = np.cos(turn * waves), np.sin(turn * waves)
    # Twice the slope of the cosine by the squared defocus is -turn sin(turn waves) / waves.
    over = turn if waves < _NO_WAVES else sine / waves
    otf = [area * cosine, area_slope * cosine - area * waves * turn_slope * sine]
    by_square = [
        area * turn * over,
        area_slope * turn * over + area * turn_slope * (over + turn * cosine),
    ]
    step_rad = pi / 2 / steps
    values, slopes = (
        np.column_stack([first.sum(axis=1), -0.5 * second.sum(axis=1)])
        for first, second in zip(otf, by_square, strict=True)
    )
    return _Table(values, step_rad * slopes)


@lru_cache(maxsize=4)
def _pupil_slices(steps: int, nodes: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Per angle, slices of the pupil's overlap, phases per wave in them, and the derivatives."""
    angle = np.linspace(0.0, pi / 2, steps + 1)[:, None]
    nu, fall = np.cos(angle), np.sin(angle)
    node, weight = np.polynomial.legendre.leggauss(nodes)
    share = (node + 1) / 2
    theta = angle * share
    sine, cosine = np.sin(theta), np.cos(theta)
    area = 2 / pi * weight * angle * sine**2
    area_slope = 2 / pi * weight * (sine**2 + 2 * theta * sine * cosine)
    turn = 8 * pi * nu * (cosine - nu)
    turn_slope = 8 * pi * (fall * (2 * nu - cosine) - nu * share * sine)
    return area, area_slope, turn, turn_slope
