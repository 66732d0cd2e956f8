"""What lenses do: the transfer functions of many drawn lenses, as the prior of a measured one.

The transfer function of lens and pixel is written as

    H(f) = (sinc(fx) sinc(fy))^(1 - p) exp(-2 pi^2 f' S f) (psi(u) + i q),

with the angular series ``u = u_0 + sum u_m cos/sin(m a)``, m = 2 and 4, and ``q`` likewise with m =
1 and 3, which are those of coma; a is the direction of f. A Gaussian lens is S alone, and p is 0
but for pixels that are no full square, as of rendered photographs. ``psi`` is
``exp(-u)`` down to a low contrast and straight on below, so that a defocused lens may change its
sign, and it saturates a little above 1, beyond which no lens passes. Each radial function is a
Gaussian process whose covariance is that of drawn lenses: circular pupils, some partly covered or
clipped, with random aberrations up to the fifth order. Its modes are the parameters, with a
standard deviation of 1 each.

References
----------
C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning (2006), sections 2.1 and
4.3. R. J. Noll, "Zernike polynomials and atmospheric turbulence", J. Opt. Soc. Am. 66 (1976).
"""

from dataclasses import dataclass
from functools import cache
from math import log, pi, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from simulation.arrays import FloatArray

ComplexArray = NDArray[np.complex128]

_FREQ_CY_PER_PX = np.linspace(0.0, 1.5, 76)
"""At which the radial functions are tabulated; beyond, they stay as they are at the end."""

_LOG_DOWN_TO = 0.08
_OVER = 0.2
"""How far psi may rise above 1: cameras without a pixel's square, and slopes for the fit."""

_DRAWS = 400
_SEED = 20
_PUPIL = 32  # samples across the pupil
_RADII = 65
_ANGLES = 24
_CUT_OFF_CY_PER_PX = (0.5, 4.5)
_ABERRATION_WAVES = 0.13  # standard deviation of the root mean square
_PERFECT, _COVERED, _CLIPPED = 0.3, 0.2, 0.2  # shares of the lenses
_LEAST_MODE = {0: 0.0007, 2: 0.004, 4: 0.012, 1: 0.003, 3: 0.003}
"""Root mean square over frequency below which a mode of a harmonic is left out."""

_WIDER = 1.5  # than the draws, as no list of lenses is complete
PIXEL_SPREAD = 0.3
"""Standard deviation of p."""

_LEAST_PIXEL = 0.02
_GAUSSIAN_PX2 = (0.25, 0.0, 0.25)
_GAUSSIAN_SPREAD_PX2 = 0.6
GAUSSIAN_PARAMETERS = 3
"""The first parameters: the elements xx, xy and yy of S. The next one is p."""

_MOST_WIDTH = 1.0  # logarithm: beyond it only a step of the fit that goes astray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _RadialModes:
    """Modes of one harmonic by frequency, shape ``(modes, frequencies)``."""

    harmonic: int
    modes: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensPrior:
    """Means of the lens's parameters, and the inverse of their variances."""

    mean: FloatArray
    precision: FloatArray


@cache
def lens_prior() -> LensPrior:
    """What is known of a lens before it is measured."""
    mean = np.zeros(LensGrid(np.zeros(1), np.zeros(1)).parameters)
    precision = np.ones(mean.size)
    mean[:GAUSSIAN_PARAMETERS] = _GAUSSIAN_PX2
    precision[:GAUSSIAN_PARAMETERS] = _GAUSSIAN_SPREAD_PX2**-2
    return LensPrior(mean=mean, precision=precision)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensFactors:
    """A lens's transfer at the frequencies of a grid, and what its slopes are made of.

    The slope of ``transfer`` is itself times `LensGrid.widths`, ``even`` times `LensGrid.even`
    and ``odd`` times `LensGrid.odd`, one for each parameter in this order.
    """

    transfer: ComplexArray
    even: FloatArray
    odd: ComplexArray


class LensGrid:
    """The transfer of lens and pixel at frequencies in cycles per pixel, shape (n,) each."""

    def __init__(self, fx: FloatArray, fy: FloatArray) -> None:
        self.pixel = np.sinc(fx) * np.sinc(fy)
        freq, angle = np.hypot(fx, fy), np.arctan2(fy, fx)
        even: list[FloatArray] = []
        odd: list[FloatArray] = []
        for part in _lens_modes():
            rows = _between(freq, part.modes)
            turns = [np.cos(part.harmonic * angle), np.sin(part.harmonic * angle)]
            turned = [row * turn for turn in turns[: 1 + (part.harmonic > 0)] for row in rows]
            (odd if part.harmonic % 2 else even).extend(turned)
        self.even, self.odd = np.array(even), np.array(odd)
        square = -PIXEL_SPREAD * np.log(np.maximum(np.abs(self.pixel), _LEAST_PIXEL))
        widths = -2 * pi**2 * np.array([fx**2, 2 * fx * fy, fy**2])
        self.widths = np.concatenate([widths, square[None]])

    @property
    def parameters(self) -> int:
        """Number of a lens's parameters."""
        return len(self.widths) + len(self.even) + len(self.odd)

    def factors(self, lens: FloatArray) -> LensFactors:
        """Transfer of a lens, and what its slopes are made of."""
        widths, even, odd = np.split(lens, np.cumsum([len(self.widths), len(self.even)]))
        width = np.exp(np.minimum(widths @ self.widths, _MOST_WIDTH)) * self.pixel
        u, q = even @ self.even, odd @ self.odd
        return LensFactors(
            transfer=width * (_psi(u) + 1j * q), even=width * _slope_of_psi(u), odd=1j * width
        )

    def slopes(self, factors: LensFactors) -> ComplexArray:
        """Derivatives of the transfer, shape ``(parameters, n)``."""
        return np.concatenate(
            [
                factors.transfer * self.widths,
                factors.even * self.even,
                factors.odd * self.odd,
            ]
        )


def lens_transfer(lens: FloatArray, fx: FloatArray, fy: FloatArray) -> ComplexArray:
    """Transfer of one lens at frequencies that nothing else is asked of, without their grid."""
    freq, angle = np.hypot(fx, fy), np.arctan2(fy, fx)
    xx, xy, yy, square = lens[: GAUSSIAN_PARAMETERS + 1].tolist()
    pixel = np.sinc(fx) * np.sinc(fy)
    width = -2 * pi**2 * (xx * fx**2 + 2 * xy * fx * fy + yy * fy**2)
    width -= square * PIXEL_SPREAD * np.log(np.maximum(np.abs(pixel), _LEAST_PIXEL))
    u, q = np.zeros_like(freq), np.zeros_like(freq)
    at = GAUSSIAN_PARAMETERS + 1
    for part in _lens_modes():
        turns = [np.cos(part.harmonic * angle), np.sin(part.harmonic * angle)]
        for turn in turns[: 1 + (part.harmonic > 0)]:
            radial = lens[at : at + len(part.modes)] @ part.modes
            at += len(part.modes)
            field = q if part.harmonic % 2 else u
            field += _between(freq, radial[None])[0] * turn
    return np.asarray(np.exp(np.minimum(width, _MOST_WIDTH)) * pixel * (_psi(u) + 1j * q))


def _psi(u: FloatArray) -> FloatArray:
    end = -log(_LOG_DOWN_TO)
    middle = np.exp(-np.clip(u, 0.0, end))
    above = -_OVER * np.expm1(np.minimum(u, 0.0) / _OVER)
    return np.asarray(middle + above - _LOG_DOWN_TO * np.maximum(u - end, 0.0))


def _slope_of_psi(u: FloatArray) -> FloatArray:
    below = np.maximum(np.exp(-np.maximum(u, 0.0)), _LOG_DOWN_TO)
    return np.asarray(-np.where(u < 0, np.exp(np.minimum(u, 0.0) / _OVER), below))


def _inverse_of_psi(contrast: FloatArray) -> FloatArray:
    """Of contrasts up to 1."""
    straight = 1 - log(_LOG_DOWN_TO) - contrast / _LOG_DOWN_TO
    logarithm = -np.log(np.maximum(contrast, _LOG_DOWN_TO))
    return np.where(contrast > _LOG_DOWN_TO, logarithm, straight)


def _between(freq: FloatArray, tables: FloatArray) -> FloatArray:
    step = float(_FREQ_CY_PER_PX[1])
    at = np.minimum(freq, _FREQ_CY_PER_PX[-1]) / step
    return np.asarray(CubicSpline(np.arange(_FREQ_CY_PER_PX.size), tables, axis=1)(at))


@cache
def _lens_modes() -> tuple[_RadialModes, ...]:
    """Modes of the harmonics 0, 2 and 4 of u, 1 and 3 of q."""
    drawn = _drawn_lenses(np.random.default_rng(_SEED))
    angle = np.arange(_ANGLES) * (pi / _ANGLES)
    levels, odd = _inverse_of_psi(drawn.real), drawn.imag
    found = []
    for harmonic, least in _LEAST_MODE.items():
        field = odd if harmonic % 2 else levels
        part = np.tensordot(field, np.exp(1j * harmonic * angle), axes=(1, 0)) / _ANGLES
        samples = np.concatenate([2 * part.real, 2 * part.imag]) if harmonic else part.real
        _, sizes, rows = np.linalg.svd(samples, full_matrices=False)
        kept = sizes > least * sqrt(samples.size)
        modes = (_WIDER / sqrt(len(samples)) * sizes[kept])[:, None] * rows[kept]
        found.append(_RadialModes(harmonic=harmonic, modes=modes))
    return tuple(found)


def _drawn_lenses(rng: np.random.Generator) -> ComplexArray:
    """Transfer functions without their shifts, shape ``(draws, angles, frequencies)``."""
    spread = np.abs(np.fft.fft2(_drawn_pupils(rng), (2 * _PUPIL, 2 * _PUPIL))) ** 2
    otf = np.fft.fftshift(np.fft.ifft2(spread), axes=(1, 2))
    otf /= otf[:, _PUPIL, _PUPIL, None, None].real
    relative = np.linspace(0, 1, _RADII)
    angle = (np.arange(_ANGLES) * (pi / _ANGLES))[:, None]
    fx, fy = relative * np.cos(angle), relative * np.sin(angle)
    polar = _unshifted(_bilinear(otf, _PUPIL * (1 + fy), _PUPIL * (1 + fx)), fx, fy)
    polar[..., -1] = 0
    cut_off = np.exp(rng.uniform(log(_CUT_OFF_CY_PER_PX[0]), log(_CUT_OFF_CY_PER_PX[1]), _DRAWS))
    at = np.minimum(_FREQ_CY_PER_PX / cut_off[:, None], 1.0) * (_RADII - 1)
    below = np.minimum(at.astype(np.intp), _RADII - 2)
    share = (at - below)[:, None, :]
    low, high = (np.take_along_axis(polar, k[:, None, :], axis=2) for k in (below, below + 1))
    return np.asarray((1 - share) * low + share * high)


def _drawn_pupils(rng: np.random.Generator) -> ComplexArray:
    """Complex amplitudes over the pupil's square, shape ``(draws, samples, samples)``."""
    y, x = (np.mgrid[:_PUPIL, :_PUPIL] - (_PUPIL - 1) / 2) / (_PUPIL / 2)
    r2 = x * x + y * y

    def disc(away_from: FloatArray, radius: FloatArray) -> FloatArray:
        return np.asarray(np.clip((radius - away_from) * _PUPIL / 2 + 0.5, 0, 1))

    def drawn(low: float, high: float) -> FloatArray:
        return rng.uniform(low, high, (_DRAWS, 1, 1))

    hole = np.where(drawn(0, 1) < _COVERED, drawn(0.15, 0.5), -1.0)
    away = np.where(drawn(0, 1) < _CLIPPED, drawn(0.1, 0.6), 0.0)
    turn = drawn(0, 2 * pi)
    beside = np.hypot(x - away * np.cos(turn), y - away * np.sin(turn))
    passed = disc(np.sqrt(r2), np.ones(1)) * (1 - disc(np.sqrt(r2), hole))
    passed = passed * np.where(away > 0, disc(beside, np.full(1, 1.1)), 1.0)
    terms = np.stack([
        sqrt(3) * (2 * r2 - 1),
        sqrt(6) * 2 * x * y,
        sqrt(6) * (x * x - y * y),
        sqrt(8) * (3 * r2 - 2) * x,
        sqrt(8) * (3 * r2 - 2) * y,
        sqrt(5) * (6 * r2 * r2 - 6 * r2 + 1),
        sqrt(8) * (x**3 - 3 * x * y * y),
        sqrt(8) * (3 * x * x * y - y**3),
    ])  # fmt: skip
    size = (_DRAWS, len(terms))
    weights = rng.normal(size=size) * rng.exponential(size=size)
    weights *= [1.5, 1, 1, 1, 1, 1, 0.5, 0.5]
    rms = np.abs(rng.normal(0, _ABERRATION_WAVES, (_DRAWS, 1)))
    rms[rng.random(_DRAWS) < _PERFECT] = 0
    waves = rms * weights / np.linalg.norm(weights, axis=1, keepdims=True)
    return np.asarray(passed * np.exp(2j * pi * np.tensordot(waves, terms, axes=1)))


def _bilinear(images: ComplexArray, y: FloatArray, x: FloatArray) -> ComplexArray:
    """Values of all images at the same places."""
    most = images.shape[1] - 2
    row, col = np.minimum(y.astype(np.intp), most), np.minimum(x.astype(np.intp), most)
    down, right = y - row, x - col
    top = (1 - right) * images[:, row, col] + right * images[:, row, col + 1]
    bottom = (1 - right) * images[:, row + 1, col] + right * images[:, row + 1, col + 1]
    return np.asarray((1 - down) * top + down * bottom)


def _unshifted(polar: ComplexArray, fx: FloatArray, fy: FloatArray) -> ComplexArray:
    """Without the shift that leaves the least phase, weighted by the squared contrast."""
    for _ in range(3):
        power, phase = np.abs(polar) ** 2, np.angle(polar)
        xx, xy, yy = (np.sum(power * one, axis=(1, 2)) for one in (fx * fx, fx * fy, fy * fy))
        x, y = (np.sum(power * phase * one, axis=(1, 2)) for one in (fx, fy))
        det = xx * yy - xy * xy
        along_x, along_y = (yy * x - xy * y) / det, (xx * y - xy * x) / det
        polar = polar * np.exp(-1j * (along_x[:, None, None] * fx + along_y[:, None, None] * fy))
    return polar
