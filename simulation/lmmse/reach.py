"""How large a window must be: where more reference pixels would add little."""

from collections.abc import Callable
from math import ceil, log

import numpy as np

from simulation.arrays import FloatArray
from simulation.lmmse.kernel_table import window_kernels
from simulation.lmmse.scene import CrossCovariance, SeenScene
from simulation.lmmse.window import FiniteWindow

RADIUS_MAX_PX = 40
"""Largest half of a window's side; the system of an astigmatic lens then takes two seconds."""

_ALLOWED_OF_IDEAL = 0.15
"""Part of the ideal error by which a window may exceed it ..."""

_ALLOWED_LEAST = 0.15 * 0.01 / 60**2
"""... and the same part of 0.01 DN^2 in scenes of 60 DN rms, relative to the scene's variance."""

_TOLERATED_LEAST = 0.3 / 60**2
"""At most 0.3 DN^2 where the largest window is too small for the lens's tails."""

_TRIED_PX = (4, 6, 9, 13)
"""Radii solved before the excess, which falls with a power of the radius, is extrapolated."""

_SHIFTS_PX = (0.0, 0.5)

_SLOWEST_DECAY, _FASTEST_DECAY = 2.0, 8.0

Windows = Callable[[int, int], FiniteWindow]
"""Gives the factorised window of ``taps_y`` and ``taps_x`` pixels."""


def window_radius_px(
    scene: SeenScene, zoom: float, windows: Windows, noise_variance: float
) -> int | None:
    """Half the side of the smallest window that loses little.

    None if that is beyond ``RADIUS_MAX_PX``, and the largest window would lose too much.
    """
    far = scene.across(zoom, zoom)
    ideal = _ideal_error(scene, far, noise_variance)
    allowed = _ALLOWED_OF_IDEAL * ideal + _ALLOWED_LEAST
    excesses: list[float] = []
    for radius in _TRIED_PX:
        excesses.append(_window_error(scene, far, windows(2 * radius, 2 * radius)) - ideal)
        if excesses[-1] <= allowed:
            return radius
    decay = log(excesses[-2] / excesses[-1]) / log(_TRIED_PX[-1] / _TRIED_PX[-2])
    decay = min(max(decay, _SLOWEST_DECAY), _FASTEST_DECAY)
    radius = ceil(_TRIED_PX[-1] * float(excesses[-1] / allowed) ** (1 / decay))
    if radius <= RADIUS_MAX_PX:
        return radius
    largest = windows(2 * RADIUS_MAX_PX, 2 * RADIUS_MAX_PX)
    excess = _window_error(scene, far, largest) - ideal
    return RADIUS_MAX_PX if excess <= _TOLERATED_LEAST else None


def _window_error(scene: SeenScene, far: CrossCovariance, window: FiniteWindow) -> float:
    """Expected squared error, of a scene of variance 1, mean of two subpixel positions."""
    size = (scene.period_px, scene.period_px)
    power = np.fft.fft2(scene.covariance).real / scene.period_px**2
    error = 0.0
    for shift_px in _SHIFTS_PX:
        at: FloatArray = np.array([shift_px])
        weights = window_kernels(window, far, at, at)[0, 0]
        y, x = (at - np.arange(taps) + (taps - 1) / 2 for taps in weights.shape)
        seen = np.sum(np.abs(np.fft.fft2(weights, size)) ** 2 * power)
        error += far.variance - 2 * np.sum(weights * far.at(y, x)) + seen
    return float(error) / len(_SHIFTS_PX)


def _ideal_error(scene: SeenScene, far: CrossCovariance, noise_variance: float) -> float:
    """Return the error with all reference pixels, mean of the same positions."""
    period = scene.period_px
    seen = np.maximum(np.fft.fft2(scene.covariance).real + noise_variance, 1e-15)
    known = 0.0
    for shift_px in _SHIFTS_PX:
        lags = shift_px + np.arange(period) - (period - 1) / 2
        known += float(np.sum(np.abs(np.fft.fft2(far.at(lags, lags))) ** 2 / seen)) / period**2
    return max(far.variance - known / len(_SHIFTS_PX), 0.0)
