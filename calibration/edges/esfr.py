"""Contrast against frequency from one edge, without a model of the PSF (e-SFR).

ISO 12233:2023 (annex D) bins the pixels by their distance from the edge, differentiates and
transforms. Here a penalised spline is fitted to the unbinned pixels: its derivative and its
Fourier transform are sums in closed form, so no bin, window or difference blurs the curve.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import cos, exp, log, pi, sin, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.optimize import brentq
from scipy.special import sici

from calibration.edges.penalised_spline import (
    DEGREE,
    band_solve,
    curve_values,
    fit_penalised_spline,
)
from calibration.edges.samples import EdgeSamples
from calibration.robust import robust_sigma
from simulation.arrays import FloatArray


def gaussian_mtf50(sigma_px: float) -> float:
    """Frequency in cy/px at which a Gaussian of this width transfers half the contrast."""
    return sqrt(log(2) / 2) / (pi * sigma_px)


def pixel_mtf50(optical_sigma_px: float, normal_rad: float) -> float:
    """Frequency in cy/px along an edge normal at which half the contrast is left.

    The transfer is ``exp(-2 pi^2 sigma^2 f^2) sinc(f cos) sinc(f sin)``: the optical Gaussian
    and the pixel square (ISO 12233:2023, annex D, system MTF as a product).
    """

    def above_half(frequency: float) -> float:
        gauss = exp(-2 * (pi * optical_sigma_px * frequency) ** 2)
        square = np.sinc(frequency * cos(normal_rad)) * np.sinc(frequency * sin(normal_rad))
        return float(gauss * square) - 0.5

    # The square alone has its first zero at 1 cy/px or beyond and falls below a half before.
    return float(brentq(above_half, 0.0, 1.0, xtol=1e-12))


SFR_FREQ_CY_PER_PX = tuple(round(0.05 * k, 2) for k in range(1, 11))
"""Frequencies at which tables list the contrast, up to Nyquist."""

_KNOT_PX = 0.25
_BAND_SIGMAS = 8.0
_BAND_EXTRA_PX = 14.0
_FEWEST_SAMPLES = 60
_LEAST_HALF_WIDTH_PX = 3.0
_OUTLIER_SIGMAS = 6.0
_OUTLIER_LEAST = 0.01  # of the contrast
_DETAIL_SIGMAS = 2.0
_DETAIL_EXTRA_PX = 0.5
_TAIL_SIGMAS = 4.0
_MEDIAN_ERR = sqrt(pi / 2)  # standard error of a median over that of a mean, Gaussian scatter
_FEWEST_FOR_SCATTER = 4
_FREQ_GRID = np.linspace(0.0, 1.0, 51)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeSfr:
    """Contrast by frequency across one edge: lens and pixel together, 1 at frequency 0.

    ``place_px`` and ``weight`` are the derivative of the edge as a sum of splines ``knot_px``
    wide: its transform is their sum times ``sinc(f h)^3``. Beyond ``reach_px`` on either side
    it goes on as ``tail_px / x^2``. The MTF values are None where the contrast does not fall
    so far below 1 cy/px. ``factor`` is the banded Cholesky factor of the spline's normal equations,
    ``variance`` that of a pixel in units of the squared contrast.
    """

    place_px: FloatArray = field(repr=False)
    weight: FloatArray = field(repr=False)
    knot_px: float
    reach_px: float
    tail_px: float
    factor: FloatArray = field(repr=False)
    variance: float
    mtf50_cy_per_px: float | None = None
    mtf50_err_cy_per_px: float | None = None
    mtf20_cy_per_px: float | None = None

    def at(self, freq_cy_per_px: FloatArray) -> FloatArray:
        """Contrast at frequencies in cy/px, shape ``(n,)``."""
        return np.abs(self.transform(freq_cy_per_px))

    def transform(self, freq_cy_per_px: FloatArray) -> NDArray[np.complex128]:
        """Fourier transform of the line spread function about the fitted edge, shape ``(n,)``."""
        freq = np.asarray(freq_cy_per_px, dtype=np.float64)
        sums = _sums(freq, float(self.place_px[0]), self.knot_px, self.weight)
        inside = sums * np.sinc(freq * self.knot_px) ** DEGREE
        if self.tail_px == 0:
            return np.asarray(inside)
        turns = 2 * pi * freq * self.reach_px
        beyond = (np.cos(turns) + turns * (sici(turns)[0] - pi / 2)) / self.reach_px
        return np.asarray(inside + 2 * self.tail_px * beyond)

    def lsf(self, distance_px: FloatArray) -> FloatArray:
        """Line spread function per px at distances from the fitted edge, of area 1."""
        distance = np.asarray(distance_px, dtype=np.float64)
        steps = (distance[:, None] - self.place_px) / self.knot_px
        inner, outer = np.abs(steps) <= 0.5, np.abs(steps) < 1.5
        bump = np.where(
            inner, 0.75 - steps**2, np.where(outer, 0.5 * (1.5 - np.abs(steps)) ** 2, 0)
        )
        beyond = np.abs(distance) > self.reach_px
        tail = self.tail_px / np.where(beyond, distance, self.reach_px) ** 2
        return np.asarray(bump @ self.weight / self.knot_px + np.where(beyond, tail, 0.0))

    def esf(self, distance_px: FloatArray) -> FloatArray:
        """Level at distances from the fitted edge, from dark 0 to bright 1; shape ``(n,)``."""
        distance = np.asarray(distance_px, dtype=np.float64)
        steps = np.clip((distance[:, None] - self.place_px) / self.knot_px, -1.5, 1.5)
        rising = np.where(
            np.abs(steps) <= 0.5,
            0.5 + 0.75 * steps - steps**3 / 3,
            np.where(steps < 0, (steps + 1.5) ** 3 / 6, 1 - (1.5 - steps) ** 3 / 6),
        )
        far = np.maximum(np.abs(distance), self.reach_px)
        before = self.tail_px / np.where(distance < 0, far, self.reach_px)
        after = self.tail_px / self.reach_px - self.tail_px / far
        return np.asarray(rising @ self.weight + before + np.where(distance > 0, after, 0.0))

    def transform_err(self, freq_cy_per_px: FloatArray) -> FloatArray:
        """Standard error, from the pixels' noise, of the part in phase with the edge."""
        freq = np.asarray(freq_cy_per_px, dtype=np.float64)
        transform = self.transform(freq).real
        return np.array(
            [
                self.err_of(
                    (np.cos(2 * pi * f * self.place_px) * np.sinc(f * self.knot_px) ** DEGREE) - t
                )
                for f, t in zip(freq.tolist(), transform.tolist(), strict=True)
            ]
        )

    def err_of(self, by_step: FloatArray) -> float:
        """Standard error of what depends so on the steps between the spline's coefficients."""
        by_coefficient = np.concatenate([[-by_step[0]], -np.diff(by_step), [by_step[-1]]])
        solved = band_solve(self.factor, by_coefficient)
        return sqrt(max(self.variance * float(by_coefficient @ solved), 0.0))


@njit(cache=True)
def _sums(
    freq_cy_per_px: FloatArray, first_px: float, step_px: float, weight: FloatArray
) -> NDArray[np.complex128]:
    """Sum of ``weight exp(-2 pi i f x)`` over equal steps of x, each rotated from the last."""
    out = np.empty(freq_cy_per_px.size, dtype=np.complex128)
    for i in range(freq_cy_per_px.size):
        angle = -2.0 * pi * freq_cy_per_px[i]
        turn = complex(cos(angle * step_px), sin(angle * step_px))
        phase = complex(cos(angle * first_px), sin(angle * first_px))
        total = 0.0j
        for k in range(weight.size):
            total += weight[k] * phase
            phase *= turn
        out[i] = total
    return out


def esfr_half_width_px(sigma_px: float) -> float:
    """Half width of the band, wide enough for the tails, where lost contrast ends up."""
    return _BAND_SIGMAS * sigma_px + _BAND_EXTRA_PX


def measure_esfr(samples: EdgeSamples, sigma_px: float) -> EdgeSfr | None:
    """Measure the contrast by frequency across an edge.

    Parameters
    ----------
    samples
        Raw pixels around the edge, best within ``esfr_half_width_px`` of it.
    sigma_px
        Approximate width of the edge.

    Returns
    -------
    EdgeSfr or None
        None where the pixels are too few or reach too little to either side.
    """
    distance = samples.distance_px
    if distance.size < _FEWEST_SAMPLES:
        return None
    reach = min(-float(distance.min()), float(distance.max()))
    if reach < _LEAST_HALF_WIDTH_PX:
        return None
    count = int(2 * reach / _KNOT_PX) - 1
    half = 0.5 * (count + 1) * _KNOT_PX
    # Pixels beyond belong to the flat ends.
    positions = np.clip((distance + half) / _KNOT_PX, 0.0, count + 1.0)
    levels = samples.unit_levels
    weights = np.ones(distance.size)
    stiffness = _stiffness(count, half, sigma_px)
    coefficients, factor, variance = fit_penalised_spline(positions, levels, weights, stiffness)
    if factor[0, 0] == 0.0:
        return None
    residuals = levels - curve_values(positions, coefficients)
    outside = np.abs(residuals) > max(_OUTLIER_SIGMAS * robust_sigma(residuals), _OUTLIER_LEAST)
    if outside.any():
        weights[outside] = 0.0
        coefficients, factor, variance = fit_penalised_spline(positions, levels, weights, stiffness)
        if factor[0, 0] == 0.0:
            return None
    tail = _tail_px(distance[~outside], levels[~outside], half, sigma_px)
    rise = float(coefficients[-1] - coefficients[0]) + 2 * tail / half
    if not rise > 0:
        return None
    curve = EdgeSfr(
        place_px=np.asarray((np.arange(1, count) + 0.5) * _KNOT_PX - half, dtype=np.float64),
        weight=np.diff(coefficients) / rise,
        knot_px=_KNOT_PX,
        reach_px=half,
        tail_px=tail / rise,
        factor=factor,
        variance=variance / rise**2,
    )
    contrast = curve.at(_FREQ_GRID)
    half_contrast = _falls_to(0.5, curve, contrast)
    err = None
    if half_contrast is not None:
        err = _frequency_err(half_contrast, curve)
    return replace(
        curve,
        mtf50_cy_per_px=half_contrast,
        mtf50_err_cy_per_px=err,
        mtf20_cy_per_px=_falls_to(0.2, curve, contrast),
    )


def _stiffness(count: int, half_width_px: float, sigma_px: float) -> FloatArray:
    """Penalty by position: far out, a PSF has no detail much finer than its distance.

    The smoothing length of a spline grows with the sixth root of its penalty's weight.
    """
    position = (np.arange(count + 3) - 0.5) * _KNOT_PX - half_width_px
    return np.asarray((1.0 + (position / (_DETAIL_SIGMAS * sigma_px + _DETAIL_EXTRA_PX)) ** 2) ** 3)


def _tail_px(distance: FloatArray, levels: FloatArray, reach_px: float, sigma_px: float) -> float:
    """Constant c of a tail ``c / x^2``, mean of both sides: what a round aperture diffracts.

    Fitted as ``end - c / x`` to the outer half of the band, and shrunk towards 0 by as much as
    its own error allows (James and Stein).
    """
    inner = 0.5 * reach_px
    if inner < _TAIL_SIGMAS * sigma_px + 1.0:
        return 0.0
    tails, variances = [], []
    for side in (-1.0, 1.0):
        far = side * distance
        chosen = far > inner
        if np.count_nonzero(chosen) < _FEWEST_SAMPLES:
            return 0.0
        inverse = 1.0 / far[chosen]
        away = inverse - inverse.mean()
        power = float(away @ away)
        level = side * levels[chosen]
        tail = -float(away @ level) / power
        left = level - level.mean() + tail * away
        tails.append(tail)
        variances.append(float(left @ left) / (left.size - 2) / power)
    tail = 0.5 * sum(tails)
    variance = 0.25 * sum(variances)
    return max(tail - variance / tail, 0.0) if tail > 0 else 0.0


def _falls_to(level: float, curve: EdgeSfr, contrast: FloatArray) -> float | None:
    """First frequency at which the contrast falls to a level; None where it does not.

    ``contrast`` is the curve's on the grid of frequencies.
    """
    below = np.flatnonzero(contrast < level)
    if below.size == 0:
        return None
    low, high = float(_FREQ_GRID[below[0] - 1]), float(_FREQ_GRID[below[0]])

    def above(freq: float) -> float:
        return float(curve.at(np.array([freq]))[0]) - level

    return float(brentq(above, low, high, xtol=1e-9))


def _frequency_err(freq: float, curve: EdgeSfr) -> float | None:
    """Standard error of a frequency that was read off the curve at a given contrast."""
    around = np.array([freq - 1e-4, freq + 1e-4])
    slope = float(np.diff(curve.at(around))[0]) / 2e-4
    if slope >= 0:
        return None
    transform = curve.transform(np.array([freq]))[0]
    wave = np.exp(-2j * pi * freq * curve.place_px) * np.sinc(freq * curve.knot_px) ** DEGREE
    by_step = (np.conj(transform) / abs(transform) * wave).real - abs(transform)
    return curve.err_of(by_step) / -slope


TRANSFER_FREQ_CY_PER_PX = np.linspace(0.0, 1.0, 51)
"""Frequencies at which the transfer is stored; beyond Nyquist for the aliased part."""


class AxisTransfer(BaseModel):
    """Contrast by frequency along one axis, lens and pixel together, from ``edges`` edges.

    ``mtf_err`` are standard errors at each frequency; None in files of before.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    freq_cy_per_px: tuple[float, ...] = Field(repr=False)
    mtf: tuple[float, ...] = Field(repr=False)
    edges: int | None = None
    mtf_err: tuple[float, ...] | None = Field(default=None, repr=False)


class MeasuredTransfer(BaseModel):
    """Transfer along x (from vertical edges) and y (horizontal ones); None without edges."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    x: AxisTransfer | None = None
    y: AxisTransfer | None = None


def mean_transfer(edges: Sequence[EdgeSfr]) -> AxisTransfer | None:
    """Return the median over edges at each frequency; None where there is no edge.

    The part in phase with the edge is taken: noise is positive and negative in it and cancels,
    while a modulus would pile it up where little contrast is left.
    """
    if not edges:
        return None
    curves = np.array([edge.transform(TRANSFER_FREQ_CY_PER_PX).real for edge in edges])
    mtf = np.maximum(np.median(curves, axis=0), 0.0)
    return AxisTransfer(
        freq_cy_per_px=tuple(round(freq, 6) for freq in TRANSFER_FREQ_CY_PER_PX.tolist()),
        mtf=tuple(mtf.tolist()),
        edges=len(edges),
        mtf_err=tuple(_median_err(edges, curves).tolist()),
    )


def _median_err(edges: Sequence[EdgeSfr], curves: FloatArray) -> FloatArray:
    """Standard error of the median: from the pixels' noise, or the edges' scatter if that is more.

    The scatter of few edges is no measure: up to three, noise alone counts.
    """
    errs = np.array([edge.transform_err(TRANSFER_FREQ_CY_PER_PX) for edge in edges])
    count = len(edges)
    share = 1.0 if count < 3 else _MEDIAN_ERR
    noise = share * np.sqrt(np.sum(errs**2, axis=0)) / count
    if count < _FEWEST_FOR_SCATTER:
        return np.asarray(noise)
    away = curves - np.median(curves, axis=0)
    scatter = np.array([robust_sigma(column) for column in away.T])
    return np.asarray(np.maximum(noise, _MEDIAN_ERR * scatter / sqrt(count)))
