"""How large a window must be: where more reference pixels would add little."""

from collections.abc import Callable
from math import ceil, log, pi, sqrt

import numpy as np

from simulation.arrays import FloatArray
from simulation.zoom_kernels.kernel_table import window_kernels
from simulation.zoom_kernels.scene import CrossCovariance, SeenScene
from simulation.zoom_kernels.window import FiniteWindow

_RADIUS_MAX_PX, _RADIUS_MAX_MIRRORED_PX = 36, 48
"""Largest half of a window's side, for any PSF and for one that is the same in the mirror of either
axis, whose systems are smaller; they take seconds."""

_ALLOWED_OF_IDEAL = 0.06
"""Part of the ideal error by which a window may exceed it ..."""

_ALLOWED_LEAST = 0.06 * 0.01 / 60**2
"""... and the same part of 0.01 DN^2 in scenes of 60 DN rms, relative to the scene's variance."""

_TOLERATED = 0.005 / 60**2
"""At most 0.005 DN^2 where the largest window is too small for the lens's tails; from there on
model ``matched``, which has no window, is the better one."""

_LEAST_PX, _LEAST_ZOOMS = 3, 2
"""Less saves no time, and this much costs a Gaussian lens nothing that could be measured."""

_LEAST_SIGMAS = 3.5
"""Standard deviations of the missing blur: cut off earlier, a Gaussian takes three products and
twice the noise instead of one product."""

_LOW_CY_PER_PX = 0.1

_TRIED_STEPS = 3
_STEP = 1.4
"""Ratio of the radii solved before the excess, which falls with a power, is extrapolated."""

_SHIFTS_PX = (0.0, 0.5)

_SLOWEST_DECAY, _FASTEST_DECAY = 2.0, 8.0

Windows = Callable[[int, int], FiniteWindow]
"""Gives the factorised window of ``taps_y`` and ``taps_x`` pixels."""


def window_radius_px(
    scene: SeenScene, zoom: float, windows: Windows, noise_variance: float
) -> int | None:
    """Half the side of the smallest window that loses little.

    None if even the largest window would lose too much.
    """
    far = scene.across(zoom, zoom)
    ideal = ideal_error(scene, far, noise_variance)
    allowed = _ALLOWED_OF_IDEAL * ideal + _ALLOWED_LEAST
    excesses: list[float] = []
    largest = _RADIUS_MAX_MIRRORED_PX if scene.is_mirrored else _RADIUS_MAX_PX
    blur_px = _width_px(scene) * sqrt(zoom**2 - 1)
    least = max(_LEAST_PX + ceil(_LEAST_ZOOMS * zoom), ceil(_LEAST_SIGMAS * blur_px))
    radii = [min(round(least * _STEP**step), largest) for step in range(_TRIED_STEPS)]
    for radius in radii:
        window = windows(2 * radius, 2 * radius)
        excesses.append(_window_error(scene, far, window, noise_variance) - ideal)
        if excesses[-1] <= allowed:
            return radius
    if radii[-2] == radii[-1]:
        return largest if excesses[-1] <= _TOLERATED else None
    decay = log(excesses[-2] / excesses[-1]) / log(radii[-1] / radii[-2])
    decay = min(max(decay, _SLOWEST_DECAY), _FASTEST_DECAY)
    at_most = excesses[-1] * (radii[-1] / largest) ** decay
    if at_most > max(allowed, _TOLERATED):
        return None
    growth = float((excesses[-1] / allowed) ** (1 / decay))
    return min(ceil(radii[-1] * growth), largest)


def _width_px(scene: SeenScene) -> float:
    """Standard deviation of the Gaussian with the PSF's transfer at a low frequency."""
    low, zero = np.array([_LOW_CY_PER_PX, 0.0]), np.array([0.0, _LOW_CY_PER_PX])
    seen = float(np.clip(scene.psf.otf(low, zero).min(), 1e-3, 1.0))
    return sqrt(-log(seen) / 2) / (pi * _LOW_CY_PER_PX)


def _window_error(
    scene: SeenScene, far: CrossCovariance, window: FiniteWindow, noise_variance: float
) -> float:
    """Expected squared error, of a scene of variance 1, mean of two subpixel positions."""
    size = (scene.period_px, scene.period_px)
    power = np.fft.fft2(scene.covariance).real / scene.period_px**2
    error = 0.0
    for shift_px in _SHIFTS_PX:
        at: FloatArray = np.array([shift_px])
        weights = window_kernels(window, far, at, at)[0, 0]
        y, x = (at[0] - _centred(taps) for taps in weights.shape)
        seen = np.sum(np.abs(np.fft.fft2(weights, size)) ** 2 * power)
        seen += noise_variance * np.sum(weights**2)
        error += far.variance - 2 * float(np.sum(weights * far.at(y, x))) + float(seen)
    return error / len(_SHIFTS_PX)


def _centred(count: int) -> FloatArray:
    return np.arange(count, dtype=np.float64) - (count - 1) / 2


def ideal_error(scene: SeenScene, far: CrossCovariance, noise_variance: float) -> float:
    """Return the error with all reference pixels, mean of the same positions."""
    period = scene.period_px
    seen = np.maximum(np.fft.fft2(scene.covariance).real + noise_variance, 1e-15)
    known = 0.0
    for shift_px in _SHIFTS_PX:
        lags = shift_px + _centred(period)
        known += float(np.sum(np.abs(np.fft.fft2(far.at(lags, lags))) ** 2 / seen)) / period**2
    return max(far.variance - known / len(_SHIFTS_PX), 0.0)
