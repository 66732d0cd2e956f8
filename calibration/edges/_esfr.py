"""Contrast by frequency across one edge, whatever the shape of the PSF (e-SFR).

ISO 12233:2023 (annex D) bins the pixels by their distance from the edge, differentiates and
transforms. Here the edge is the fitted Gaussian, a tail, and a penalised spline that follows what
is left: all three have their transform in closed form, so that no bin, window or difference blurs
the curve, and only as much noise is let in as the pixels ask for.
"""

from dataclasses import dataclass, field
from math import atan, atan2, cos, exp, log, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calibration.edges._model import EdgeShape, edge_shape, shape_slopes, shape_value
from calibration.edges._penalised_spline import (
    DEGREE,
    SplineFit,
    curve_slopes,
    curve_values,
    fit_penalised_spline,
    variances,
)
from calibration.edges._samples import BinnedEdge
from simulation.arrays import FloatArray
from simulation.compiled import compiled, compiled_part

_STEPS = 60  # of bisection and secant together: 12 are usual
_EXACT = 1e-13


def gaussian_mtf50(sigma_px: float) -> float:
    """Frequency in cy/px at which a Gaussian of this width transfers half the contrast."""
    return sqrt(log(2) / 2) / (pi * sigma_px)


def pixel_mtf50(optical_sigma_px: float, normal_rad: float) -> float:
    """Frequency in cy/px along an edge normal at which half the contrast is left.

    ``exp(-2 pi^2 sigma^2 f^2) sinc(f cos) sinc(f sin)``: the optical Gaussian and the pixel square
    (ISO 12233:2023, annex D, system MTF as a product).
    """
    return float(_half_contrast(optical_sigma_px, cos(normal_rad), sin(normal_rad)))


@compiled_part()
def _pixel_transfer(freq_cy_per_px: float, sigma_px: float, cosine: float, sine: float) -> float:
    """Contrast that a Gaussian behind the unit square passes; without cosine and sine, alone."""
    contrast = exp(-2.0 * (pi * sigma_px * freq_cy_per_px) ** 2)
    return contrast * np.sinc(freq_cy_per_px * cosine) * np.sinc(freq_cy_per_px * sine)


@compiled()
def _half_contrast(sigma_px: float, cosine: float, sine: float) -> float:
    # The square alone has its first zero at 1 cy/px or beyond and falls below a half before.
    low, high = 0.0, 1.0
    at_low, at_high = 0.5, _pixel_transfer(1.0, sigma_px, cosine, sine) - 0.5
    for _ in range(_STEPS):
        # The secant of Illinois: an end that stays counts half.
        middle = high - at_high * (high - low) / (at_high - at_low)
        here = _pixel_transfer(middle, sigma_px, cosine, sine) - 0.5
        if abs(here) < _EXACT:
            return middle
        if here > 0:
            low, at_low = middle, here
            at_high *= 0.5
        else:
            high, at_high = middle, here
            at_low *= 0.5
    return 0.5 * (low + high)


SFR_FREQ_CY_PER_PX = tuple(round(0.05 * k, 2) for k in range(1, 11))
"""Frequencies at which tables list the contrast, up to Nyquist."""

_KNOT_PX = 0.25
_BAND_SIGMAS = 8.0
_BAND_EXTRA_PX = 14.0
_DETAIL_SIGMAS = 2.0
_DETAIL_EXTRA_PX = 0.5
# A Lorentzian this much wider than the Gaussian: beyond it falls as 1 / x^2, as diffraction does.
_TAIL_WIDER, _TAIL_EXTRA_PX = 1.5, 0.3
_TAIL_PRIOR = 0.3  # standard deviation of the tail's share: a round aperture has about 0.2
# A sampled Gaussian instead of one behind the pixel only where it fits far better: the spline
# follows a lens with the pixel's kinks less well.
_POINTS_SURE = 0.25
_GRID_STEPS = 50  # from 0 to 1 cy/px
_HALF, _FIFTH = 0.5, 0.2
_ROOT_STEPS, _ROOT_EXACT = 60, 1e-11
_UNEVEN_MOST = 0.2  # of the contrast, between the levels beside the edge and at the band's ends
_SLOPE_STEP = 1e-4
WIDEST_GAP_PX = 0.5
_CORE_SIGMAS = 1.5
_MOST_ALIASED = 0.02  # contrast that samples as far apart as the gap fold onto that of one half


class _Curve(NamedTuple):
    """The edge as a sum: ``shape`` and what the fit adds to it, over the whole ``rise``.

    The terms are a further rise of the Gaussian, its change with log sigma and with its place, and
    a Lorentzian of half width ``tail_px``; the spline has knots ``knot_px`` apart.
    """

    shape: EdgeShape
    tail_px: float
    knot_px: float
    fit: SplineFit
    steps: FloatArray
    rise: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeSfr:
    """Contrast by frequency across one edge: lens and pixel together, 1 at frequency 0.

    MTF values are None where the contrast does not fall so far below 1 cy/px.
    """

    curve: _Curve = field(repr=False)
    reach_px: float
    mtf50_cy_per_px: float | None = None
    mtf50_err_cy_per_px: float | None = None
    mtf20_cy_per_px: float | None = None

    def at(self, freq_cy_per_px: FloatArray) -> FloatArray:
        """Contrast at frequencies in cy/px, shape ``(n,)``."""
        return np.abs(self.transform(freq_cy_per_px))

    def transform(self, freq_cy_per_px: FloatArray) -> NDArray[np.complex128]:
        """Fourier transform of the line spread function about the fitted edge, shape ``(n,)``."""
        freq = np.ascontiguousarray(freq_cy_per_px, dtype=np.float64)
        return np.asarray(_transform(self.curve, freq))

    def transform_err(self, freq_cy_per_px: FloatArray) -> FloatArray:
        """Standard error of the part in phase with the edge, shape ``(n,)``."""
        freq = np.ascontiguousarray(freq_cy_per_px, dtype=np.float64)
        return np.asarray(_errors(self.curve, freq, np.zeros(freq.size)))

    def esf(self, distance_px: FloatArray) -> FloatArray:
        """Edge spread function, from 0 to 1, at signed distances within the reach."""
        distance = np.ascontiguousarray(distance_px, dtype=np.float64)
        return np.asarray(_profile(self.curve, distance))

    def esf_err(self, distance_px: FloatArray) -> FloatArray:
        """Standard error of the edge spread function at signed distances within the reach."""
        distance = np.ascontiguousarray(distance_px, dtype=np.float64)
        return np.asarray(_profile_errors(self.curve, distance))

    def lsf(self, distance_px: FloatArray) -> FloatArray:
        """Line spread function per px at signed distances within the reach."""
        distance = np.asarray(distance_px, dtype=np.float64)
        half = self.curve.knot_px / 4
        return (self.esf(distance + half) - self.esf(distance - half)) / (2 * half)


def esfr_half_width_px(sigma_px: float) -> float:
    """Half width of the band, wide enough for the tails, where lost contrast ends up."""
    return _BAND_SIGMAS * sigma_px + _BAND_EXTRA_PX


def measure_esfr(edge: BinnedEdge) -> EdgeSfr | None:
    """Measure the contrast by frequency across an edge.

    None where the levels do not rise along the normal, or change beside the edge as no PSF does.
    """
    distance = edge.distance_px
    shapes = (
        edge_shape(edge.sigma_px, None, edge.normal_rad),
        edge_shape(edge.sigma_px, edge.optical_sigma_px, edge.normal_rad),
    )
    knot_px = _KNOT_PX * edge.pitch_px
    curve = _fitted(distance, edge.levels, edge.weights, shapes, edge.sigma_px, knot_px)
    if not curve.fit.is_found:
        return None
    half, err, fifth = _read(curve)
    return EdgeSfr(
        curve=curve,
        reach_px=min(-float(distance[0]), float(distance[-1])),
        mtf50_cy_per_px=half if half > 0 else None,
        mtf50_err_cy_per_px=err if err > 0 else None,
        mtf20_cy_per_px=fifth if fifth > 0 else None,
    )


def widest_gap_px(edge: BinnedEdge) -> float:
    """Widest gap between the pixels' distances where the edge rises."""
    core = max(_CORE_SIGMAS * edge.sigma_px, float(edge.pitch_px))
    return float(_widest_gap(edge.distance_px, core))


@compiled()
def _widest_gap(distance: FloatArray, core: float) -> float:
    widest = 0.0
    for i in range(1, distance.size):
        # The neighbours of the core count: a gap may reach over its end.
        if distance[i] >= -core and distance[i - 1] <= core:
            widest = max(widest, distance[i] - distance[i - 1])
    return widest


def is_aliased(edge: BinnedEdge, gap_px: float) -> bool:
    """Whether gaps so wide fold contrast onto MTF50.

    Samples as far apart as the widest gap fold the contrast at their frequency less MTF50 onto that
    at MTF50.
    """
    if gap_px <= WIDEST_GAP_PX * edge.pitch_px:
        return False
    half = gaussian_mtf50(edge.sigma_px)
    folded = 1 / gap_px - half
    return folded < half or exp(-2 * (pi * edge.sigma_px * folded) ** 2) > _MOST_ALIASED


def gap_message(edge: BinnedEdge, gap_px: float) -> str:
    """Say what is wrong with an edge whose pixels leave too wide a gap, and the remedy."""
    return (
        f"its pixels leave gaps of {gap_px:.2f} px across the edge, too wide for a PSF of "
        f"{edge.sigma_px:.2f} px; turn the target by 2 to 10 degrees"
    )


@compiled()
def _fitted(
    distance: FloatArray,
    levels: FloatArray,
    weights: FloatArray,
    shapes: tuple[EdgeShape, EdgeShape],
    sigma_px: float,
    knot_px: float,
) -> _Curve:
    shape = shapes[1]
    misfit = _misfit(distance, levels, weights, shape)
    if _misfit(distance, levels, weights, shapes[0]) < _POINTS_SURE * misfit:
        shape = shapes[0]
    count = int(2 * min(-distance[0], distance[-1]) / knot_px) - 1
    half = 0.5 * (count + 1) * knot_px
    tail_px = _TAIL_WIDER * (sigma_px + _TAIL_EXTRA_PX)
    terms = np.empty((distance.size, 4))
    left = np.empty(distance.size)
    positions = np.empty(distance.size)
    for i in range(distance.size):
        here = _terms(shape, tail_px, distance[i])
        terms[i, 0], terms[i, 1], terms[i, 2], terms[i, 3] = here
        left[i] = levels[i] - here[0]
        # Pixels beyond belong to the flat ends.
        positions[i] = min(max((distance[i] + half) / knot_px, 0.0), count + 1.0)
    precision = np.array([0.0, 0.0, 0.0, 1.0 / _TAIL_PRIOR**2])
    stiffness = _stiffness(count, half, knot_px, sigma_px)
    fit = fit_penalised_spline(positions, left, weights, terms, precision, stiffness)
    if not fit.is_found:
        return _Curve(shape, tail_px, knot_px, fit, fit.coefficients, 0.0)
    steps = np.empty(fit.coefficients.size - 1)
    rise = 1.0 + fit.terms[0]
    for k in range(steps.size):
        steps[k] = fit.coefficients[k + 1] - fit.coefficients[k]
        rise += steps[k]
    return _Curve(
        shape, tail_px, knot_px, _marked(fit, abs(rise - 1.0) < _UNEVEN_MOST), steps, rise
    )


@compiled_part()
def _misfit(
    distance: FloatArray, levels: FloatArray, weights: FloatArray, shape: EdgeShape
) -> float:
    total = 0.0
    for i in range(distance.size):
        total += weights[i] * (levels[i] - shape_value(shape, distance[i])) ** 2
    return total


@compiled_part()
def _marked(fit: SplineFit, is_found: bool) -> SplineFit:
    return SplineFit(
        is_found, fit.coefficients, fit.terms, fit.factor, fit.cross, fit.border, fit.scale
    )


@compiled_part()
def _terms(shape: EdgeShape, tail_px: float, distance: float) -> tuple[float, float, float, float]:
    """The Gaussian edge, its derivatives by log sigma and by place, and what a tail changes."""
    value, slope, by_log_sigma = shape_slopes(shape, distance)
    return value, by_log_sigma, slope, 0.5 + atan(distance / tail_px) / pi - value


@compiled_part()
def _stiffness(count: int, half_px: float, knot_px: float, sigma_px: float) -> FloatArray:
    """Penalty by position: far out, a PSF has no detail much finer than its distance.

    The smoothing length of a spline grows with the sixth root of its penalty's weight.
    """
    detail = _DETAIL_SIGMAS * sigma_px + _DETAIL_EXTRA_PX
    out = np.empty(count + 3)
    for k in range(count + 3):
        out[k] = (1.0 + (((k - 0.5) * knot_px - half_px) / detail) ** 2) ** 3
    return out


@compiled()
def _transform(curve: _Curve, freq_cy_per_px: FloatArray) -> NDArray[np.complex128]:
    out = np.empty(freq_cy_per_px.size, dtype=np.complex128)
    for i in range(out.size):
        out[i] = _transform_at(curve, freq_cy_per_px[i])
    return out


@compiled_part()
def _transform_at(curve: _Curve, freq: float) -> complex:
    shape, terms, steps = curve.shape, curve.fit.terms, curve.steps
    gauss = _pixel_transfer(freq, shape.sigma_px, shape.cosine, shape.sine)
    by_log_sigma = -((2.0 * pi * shape.sigma_px * freq) ** 2) * gauss
    total = (1.0 + terms[0]) * gauss + terms[1] * by_log_sigma
    total += terms[3] * (exp(-2.0 * pi * curve.tail_px * abs(freq)) - gauss)
    # The steps lie symmetrically about the edge, a knot apart: pairs turn either way.
    angle = 2.0 * pi * freq * curve.knot_px
    turn_c, turn_s = cos(angle), sin(angle)
    angle *= 0.5 * ((steps.size - 1) % 2)
    c, s = cos(angle), sin(angle)
    even = odd = 0.0
    first = steps.size // 2
    for k in range(first, steps.size):
        after, before = steps[k], steps[steps.size - 1 - k]
        even += c * (after + before)
        odd += s * (before - after)
        c, s = c * turn_c - s * turn_s, c * turn_s + s * turn_c
    if steps.size % 2 == 1:
        even -= steps[first]
    smooth = np.sinc(freq * curve.knot_px) ** DEGREE
    slope = 2.0 * pi * freq * terms[2] * gauss
    return complex(total + even * smooth, slope + odd * smooth) / curve.rise


@compiled()
def _errors(curve: _Curve, freq_cy_per_px: FloatArray, phase_rad: FloatArray) -> FloatArray:
    """Standard errors of the parts of the transform in given phases."""
    shape, fit = curve.shape, curve.fit
    count, several = fit.coefficients.size, fit.terms.size
    transform = _transform(curve, freq_cy_per_px)
    by_coefficient = np.zeros((count, freq_cy_per_px.size))
    by_term = np.zeros((several, freq_cy_per_px.size))
    for i in range(freq_cy_per_px.size):
        freq = freq_cy_per_px[i]
        c, s = cos(phase_rad[i]), sin(phase_rad[i])
        here = c * transform[i].real + s * transform[i].imag
        gauss = _pixel_transfer(freq, shape.sigma_px, shape.cosine, shape.sine)
        by_term[0, i] = c * gauss - here
        by_term[1, i] = -((2.0 * pi * shape.sigma_px * freq) ** 2) * c * gauss
        by_term[2, i] = 2.0 * pi * freq * s * gauss
        by_term[3, i] = c * (exp(-2.0 * pi * curve.tail_px * abs(freq)) - gauss)
        smooth = np.sinc(freq * curve.knot_px) ** DEGREE
        angle = -2.0 * pi * freq * curve.knot_px
        turn = complex(cos(angle), sin(angle))
        angle *= -0.5 * (count - 2)
        wave = complex(cos(angle), sin(angle))
        for k in range(count - 1):
            by_step = smooth * (c * wave.real + s * wave.imag) - here
            by_coefficient[k, i] -= by_step
            by_coefficient[k + 1, i] += by_step
            wave *= turn
    return np.sqrt(variances(fit, by_coefficient, by_term)) / curve.rise


@compiled()
def _profile(curve: _Curve, distance: FloatArray) -> FloatArray:
    coefficients = curve.fit.coefficients
    positions = _in_knots(curve, distance)
    out = np.empty(distance.size)
    for i in range(distance.size):
        terms = _terms(curve.shape, curve.tail_px, distance[i])
        out[i] = terms[0]
        for k in range(4):
            out[i] += curve.fit.terms[k] * terms[k]
    out += curve_values(positions, coefficients) - coefficients[0]
    return out / curve.rise


@compiled()
def _profile_errors(curve: _Curve, distance: FloatArray) -> FloatArray:
    count = curve.fit.coefficients.size
    profile = _profile(curve, distance)
    by_coefficient = curve_slopes(_in_knots(curve, distance), count)
    by_term = np.zeros((curve.fit.terms.size, distance.size))
    for i in range(distance.size):
        by_coefficient[0, i] -= 1.0 - profile[i]
        by_coefficient[count - 1, i] -= profile[i]
        by_term[0, i], by_term[1, i], by_term[2, i], by_term[3, i] = _terms(
            curve.shape, curve.tail_px, distance[i]
        )
        by_term[0, i] -= profile[i]
    return np.sqrt(variances(curve.fit, by_coefficient, by_term)) / curve.rise


@compiled_part()
def _in_knots(curve: _Curve, distance: FloatArray) -> FloatArray:
    """Positions along the spline; beyond it they stay at its ends."""
    count = curve.fit.coefficients.size
    half = 0.5 * (count + 1) * curve.knot_px
    out = np.empty(distance.size)
    for i in range(distance.size):
        out[i] = min(max((distance[i] + half) / curve.knot_px, 0.0), count + 1.0)
    return out


@compiled()
def _read(curve: _Curve) -> tuple[float, float, float]:
    """MTF50, its standard error and MTF20 in cy/px; each 0 where there is none."""
    half = fifth = 0.0
    below, here = 0.0, 1.0
    for k in range(1, _GRID_STEPS + 1):
        before, here = here, _contrast(curve, k / _GRID_STEPS)
        below = (k - 1) / _GRID_STEPS
        if half == 0.0 and here < _HALF:
            half = _falls_to(_HALF, curve, below, before - _HALF, here - _HALF)
        if here < _FIFTH:
            fifth = _falls_to(_FIFTH, curve, below, before - _FIFTH, here - _FIFTH)
            break
    if half == 0.0:
        return half, 0.0, fifth
    slope = _contrast(curve, half + _SLOPE_STEP) - _contrast(curve, half - _SLOPE_STEP)
    if slope >= 0:
        return half, 0.0, fifth
    here_at = _transform_at(curve, half)
    phase = atan2(here_at.imag, here_at.real)
    err = _errors(curve, np.array([half]), np.array([phase]))[0]
    return half, err * 2 * _SLOPE_STEP / -slope, fifth


@compiled_part()
def _contrast(curve: _Curve, freq_cy_per_px: float) -> float:
    return float(abs(_transform_at(curve, freq_cy_per_px)))


@compiled_part()
def _falls_to(
    level: float, curve: _Curve, low: float, above_low: float, above_high: float
) -> float:
    """Frequency in the step of the grid from ``low`` at which the contrast falls to a level.

    By the secant of Illinois, from what the contrast is above the level at either end.
    """
    high = low + 1 / _GRID_STEPS
    for _ in range(_ROOT_STEPS):
        middle = high - above_high * (high - low) / (above_high - above_low)
        above = _contrast(curve, middle) - level
        if abs(above) < _ROOT_EXACT:
            return middle
        if above > 0:
            low, above_low = middle, above
            above_high *= 0.5
        else:
            high, above_high = middle, above
            above_low *= 0.5
    return 0.5 * (low + high)
