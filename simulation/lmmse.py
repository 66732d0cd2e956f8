"""The best linear resampler from the pixels of a reference to those of its follow-up.

Kriging: each follow-up pixel is the combination of the reference pixels around it that has the
least mean squared error over scenes with a first-order covariance, among those that keep a
constant and a ramp. The cameras may have any transfer functions. The theory and the comparison
with the other models are in ``docs/theory-lmmse.md``.
"""

from dataclasses import dataclass
from math import ceil, log, log2, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.linalg import lu_factor, lu_solve, toeplitz

from simulation.arrays import FloatArray
from simulation.psf import CameraTransfer, GaussianTransfer, Transfer
from simulation.resampling import BandedMatrix, SamplingGrid

SCENE_CORRELATION_PX = 30.0
"""Correlation length of the scene prior; from 3 to 100 px the errors differ by less than 1 %."""

_RIDGE = 1e-9
"""Least noise on the diagonal, relative to the scene's variance, for nearly singular systems.
Between 1e-9 and 1e-6 the error against closed-form scenes is the same."""

_AXIS_NOISE = 0.2
"""Noise in the system of one axis per noise of the image: measured, see the theory."""

_STEPS_PER_PX = 64
"""Resolution of the covariance tables; the spectra reach to half of it in cycles per pixel."""

_PERIOD_MIN_PX = 512
"""Period of the tables: that of a periodic scene, much longer than any window."""

_MARGIN_PX = 6.0
"""Reference pixels taken beyond the reach of the far line spread function."""

_REACH_ENERGY = 1e-4
"""Part of the far line spread function's energy beyond its reach."""

_REACH_MAX_PX = 16.0
"""Longest reach in follow-up pixels, for measured curves that end abruptly."""

_TERM_TOLERANCE = 1e-5
"""A correlated PSF's expansion ends where its terms fall below this."""

_TAPS_MULTIPLE = 4
"""The compiled kernel combines four rows at a time."""


@dataclass(frozen=True, slots=True, eq=False)
class _Target:
    """What a follow-up pixel sees along one axis.

    ``transfer`` is on the frequency grid. An odd one represents its product with the imaginary
    unit, whose kernel is real. It turns a constant 1 into ``gain``, and a ramp of slope 1 into
    ``gain`` times the position plus ``shift_px``.
    """

    transfer: FloatArray
    is_odd: bool
    gain: float
    shift_px: float


@dataclass(frozen=True, slots=True)
class _Term:
    """One product of Hermite functions: its factor, and the scale of the argument."""

    factor: float = 1.0
    scale: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class _Axis:
    """One axis of the problem: positions of the outputs, and the near camera's transfer."""

    positions_px: FloatArray
    zoom: float
    size: int
    transfer: Transfer


def lmmse_terms(
    shape: tuple[int, int],
    grid: SamplingGrid,
    transfer: CameraTransfer,
    *,
    noise_ratio: float = 0.0,
    scene_correlation_px: float = SCENE_CORRELATION_PX,
) -> tuple[tuple[BandedMatrix, BandedMatrix], ...]:
    """Pairs ``(Wy, Wx)`` whose ``Wy image Wx^T`` sum to the follow-up.

    Parameters
    ----------
    shape
        ``(rows, cols)`` of the reference.
    grid
        Pixels of the follow-up. A zoom below 1 counts as 1.
    transfer
        Transfer functions of the camera, in its own pixels; the same near and far.
    noise_ratio
        Variance of the reference's noise over that of the scene.
    scene_correlation_px
        Distance at which the scene's covariance has fallen to 1/e, along either axis.

    Returns
    -------
    tuple of pairs of BandedMatrix
        One pair for an uncorrelated transfer. The windows stay inside the reference, so that
        nothing is assumed about the scene beyond its border.

    Raises
    ------
    ValueError
        If the noise is negative or not finite, or the correlation length is not positive.

    References
    ----------
    N. Wiener, "Extrapolation, Interpolation, and Smoothing of Stationary Time Series", 1949;
    G. Matheron, "The intrinsic random functions and their applications", 1973 (kriging with a
    drift); F. G. Mehler, 1866 (the expansion of a correlated Gaussian).
    """
    if not (noise_ratio >= 0 and np.isfinite(noise_ratio)):
        raise ValueError(f"noise_ratio must not be negative, got {noise_ratio}")
    if not (scene_correlation_px > 0 and np.isfinite(scene_correlation_px)):
        raise ValueError(f"scene_correlation_px must be positive, got {scene_correlation_px}")
    axes = (
        _Axis(grid.rows_px, max(grid.zoom_y, 1.0), shape[0], transfer.along_y),
        _Axis(grid.cols_px, max(grid.zoom_x, 1.0), shape[1], transfer.along_x),
    )
    terms = _expansion(_blur_correlation(transfer, axes[0].zoom * axes[1].zoom))
    # The factor of each product goes to one of the axes.
    bare = [_Term(scale=term.scale) for term in terms]
    ridge = max(_AXIS_NOISE * noise_ratio, _RIDGE)
    along_y = _resamplers(axes[0], terms, ridge, scene_correlation_px)
    along_x = _resamplers(axes[1], bare, ridge, scene_correlation_px)
    return tuple(zip(along_y, along_x, strict=True))


def _blur_correlation(transfer: CameraTransfer, zoom_product: float) -> float:
    """Correlation of the far PSF once that of the near one is attributed to the scene."""
    y, x = transfer.along_y, transfer.along_x
    if not (isinstance(y, GaussianTransfer) and isinstance(x, GaussianTransfer)):
        return 0.0
    if transfer.covariance_px2 == 0:
        return 0.0
    return transfer.covariance_px2 / (y.sigma_px * x.sigma_px) * (1 - 1 / zoom_product)


def _resamplers(
    axis: _Axis, terms: list[_Term], ridge: float, scene_correlation_px: float
) -> list[BandedMatrix]:
    """Weights along one axis, one matrix for each term of the expansion."""
    reach_px = _reach_px(axis)
    period_px = 2 ** ceil(log2(max(_PERIOD_MIN_PX, 16 * (reach_px + _MARGIN_PX))))
    freq: FloatArray = np.arange(_STEPS_PER_PX * period_px // 2 + 1) / period_px
    near = axis.transfer(freq)
    angular_length = 2 * np.pi * scene_correlation_px
    # Transform of exp(-|d| / length), the covariance of a first-order process.
    seen = 2 * scene_correlation_px / (1 + (angular_length * freq) ** 2) * near

    taps = _TAPS_MULTIPLE * ceil(2 * (reach_px + _MARGIN_PX) / _TAPS_MULTIPLE)
    taps = min(taps, axis.size)
    first = np.floor(axis.positions_px).astype(np.int64) + 1 - taps // 2
    starts = np.clip(first, 0, axis.size - taps)
    position_px = axis.positions_px - starts - (taps - 1) / 2
    tap_px = np.arange(taps) - (taps - 1) / 2
    distance_px = position_px[:, None] - tap_px

    covariance = _covariance(seen * near, np.arange(taps), period_px)
    variance = covariance[0]
    covariance[0] += ridge * variance
    # The drifts: a constant and, where there are pixels for it, a ramp of unit half-length.
    half_px = taps / 2
    orders = min(2, taps)
    drift = (tap_px[:, None] / half_px) ** np.arange(orders)
    system = np.zeros((taps + orders, taps + orders))
    system[:taps, :taps] = toeplitz(covariance) / variance
    system[:taps, taps:], system[taps:, :taps] = drift, drift.T
    factors = lu_factor(system)

    matrices = []
    for target in _targets(axis, freq, terms):
        wanted = np.empty((taps + orders, len(starts)))
        cross = _covariance(seen * target.transfer, distance_px, period_px, target.is_odd)
        wanted[:taps] = cross.T / variance
        ramp = (target.gain * position_px + target.shift_px) / half_px
        wanted[taps:] = np.stack([np.full(len(starts), target.gain), ramp])[:orders]
        weights = lu_solve(factors, wanted)[:taps].T
        matrices.append(BandedMatrix(starts, _summing_to(target.gain, weights), axis.size))
    return matrices


def _summing_to(gain: float, weights: FloatArray) -> FloatArray:
    """Correct the row sums for rounding of the solution, on the largest weight of each row."""
    exact = np.ascontiguousarray(weights)
    largest = np.argmax(np.abs(exact), axis=1)
    exact[np.arange(len(exact)), largest] += gain - exact.sum(axis=1)
    return exact


def _covariance(
    spectrum: FloatArray,
    distance_px: NDArray[np.floating] | NDArray[np.integer],
    period_px: int,
    is_odd: bool = False,
) -> FloatArray:
    """Integral of ``spectrum`` times ``cos(2 pi f d)``, or ``-sin(2 pi f d)`` if it is odd."""
    size = 2 * (len(spectrum) - 1)
    values = np.fft.irfft(1j * spectrum if is_odd else spectrum, size) * (size / period_px)
    farthest = int((np.max(np.abs(distance_px)) + 1) * _STEPS_PER_PX)
    steps = np.arange(-farthest, farthest + 1)
    table = CubicSpline(steps / _STEPS_PER_PX, values[steps % size])
    return np.asarray(table(distance_px))


def _reach_px(axis: _Axis) -> float:
    """Radius in reference pixels that holds the far line spread function."""
    period_px = _PERIOD_MIN_PX
    freq: FloatArray = np.arange(_STEPS_PER_PX * period_px // 2 + 1) / period_px
    half = np.fft.irfft(axis.transfer(freq))[: len(freq)] ** 2
    beyond = 1 - np.cumsum(half) / half.sum()
    reach_px = float(np.argmax(beyond <= _REACH_ENERGY)) / _STEPS_PER_PX
    return min(reach_px, _REACH_MAX_PX) * axis.zoom


def _targets(axis: _Axis, freq: FloatArray, terms: list[_Term]) -> list[_Target]:
    """What the far pixel sees along one axis, for each term of the expansion."""
    far_freq = axis.zoom * freq
    if len(terms) == 1 or not isinstance(axis.transfer, GaussianTransfer):
        return [_Target(axis.transfer(far_freq), is_odd=False, gain=1.0, shift_px=0.0)]
    per_freq = sqrt(2) * np.pi * axis.transfer.sigma_px * axis.zoom
    pixel = np.sinc(far_freq) if axis.transfer.over_pixel else 1.0
    scale = terms[0].scale
    functions = _hermite_functions(scale * per_freq * freq, len(terms) + 1)
    at_zero = _hermite_functions(np.zeros(1), len(terms) + 1)[:, 0]
    targets = []
    for k, term in enumerate(terms):
        slope = sqrt(k / 2) * at_zero[k - 1] - sqrt((k + 1) / 2) * at_zero[k + 1]
        targets.append(
            _Target(
                term.factor * functions[k] * pixel,
                is_odd=k % 2 == 1,
                gain=float(term.factor * at_zero[k]),
                shift_px=float(term.factor * slope * scale * per_freq / (2 * np.pi)),
            )
        )
    return targets


def _expansion(correlation: float) -> list[_Term]:
    """Mehler's expansion of a correlated Gaussian into products of Hermite functions.

    ``exp(-a^2 - b^2 - 2 q a b)`` is the sum over k of ``t^k sqrt(pi (1 - t^2)) phi_k(s a)
    phi_k(s b)``, with ``2 t / (1 + t^2) = -q`` and ``s^2 = 2 (1 - t^2) / (1 + t^2)``.
    """
    if correlation == 0:
        return [_Term()]
    # This form avoids a difference of nearly equal numbers at a weak correlation.
    t = -correlation / (1 + sqrt(1 - correlation**2))
    count = max(ceil(log(_TERM_TOLERANCE) / log(abs(t))) + 1, 2)
    at_zero = _hermite_functions(np.zeros(1), count)[:, 0]
    powers = t ** np.arange(count)
    norm = float(np.sum(powers * at_zero**2))
    # Two odd factors include the square of the imaginary unit.
    powers[1::2] *= -1
    scale = sqrt(2 * (1 - t**2) / (1 + t**2))
    return [_Term(factor=float(power) / norm, scale=scale) for power in powers]


def _hermite_functions(x: FloatArray, count: int) -> FloatArray:
    """Return the first ``count`` orthonormal Hermite functions, shape ``(count, len(x))``."""
    functions = np.empty((max(count, 2), len(x)))
    functions[0] = np.pi**-0.25 * np.exp(-(x**2) / 2)
    functions[1] = sqrt(2) * x * functions[0]
    for k in range(2, count):
        functions[k] = sqrt(2 / k) * x * functions[k - 1] - sqrt((k - 1) / k) * functions[k - 2]
    return functions[:count]
