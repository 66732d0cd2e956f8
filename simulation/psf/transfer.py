"""Transfer functions of a camera along one image axis."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from simulation.arguments import ArgumentError
from simulation.arrays import FloatArray

_LOWEST_END_CY_PER_PX = 0.5
"""A measured curve must reach the Nyquist frequency."""

_ZERO_TOLERANCE = 0.02
"""How far from 1 a measured curve may start; it is divided by its first value."""


class Transfer(Protocol):
    """Amplitude by frequency of a symmetric line spread function; hashable, 1 at frequency 0."""

    def __call__(self, freq_cy_per_px: FloatArray) -> FloatArray:
        """Return the transfer at frequencies of at least 0, in cycles per pixel."""
        ...

    def __hash__(self) -> int:
        """Equal transfers have equal hashes: operators are cached by them."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class GaussianTransfer:
    """A Gaussian line spread function, alone or integrated over square pixels.

    Parameters
    ----------
    sigma_px
        Width of the Gaussian; 0 for no Gaussian.
    over_pixel
        Whether to multiply by the pixel's own ``sin(pi f) / (pi f)``; without it, ``sigma_px`` is
        the total width.

    Raises
    ------
    ArgumentError
        If the width is negative or not finite, or is 0 without a pixel.
    """

    sigma_px: float
    over_pixel: bool = False

    def __post_init__(self) -> None:
        if not (self.sigma_px >= 0 and np.isfinite(self.sigma_px)):
            raise ArgumentError(f"sigma_px must not be negative, got {self.sigma_px}")
        if self.sigma_px == 0 and not self.over_pixel:
            raise ArgumentError("a line spread function needs a positive width, but sigma_px is 0")

    def __call__(self, freq_cy_per_px: FloatArray) -> FloatArray:
        """Return the transfer at frequencies in cycles per pixel."""
        gauss = np.exp(-2 * np.pi**2 * self.sigma_px**2 * freq_cy_per_px**2)
        return np.asarray(gauss * np.sinc(freq_cy_per_px) if self.over_pixel else gauss)


@dataclass(frozen=True, slots=True, init=False)
class SampledTransfer:
    """A measured transfer function, as from an edge; the pixel is included.

    Monotone cubic between the samples (PCHIP), 0 beyond the last.

    Parameters
    ----------
    freq_cy_per_px
        Frequencies, increasing from 0 to at least 0.5.
    values
        Amplitudes there; they are divided by the first, which must be near 1.

    Raises
    ------
    ArgumentError
        If the numbers of samples differ, or the samples are not finite, not increasing, or end too
        early.
    """

    freq_cy_per_px: tuple[float, ...]
    values: tuple[float, ...]

    def __init__(
        self, freq_cy_per_px: Sequence[float] | FloatArray, values: Sequence[float] | FloatArray
    ) -> None:
        freq = np.asarray(freq_cy_per_px, dtype=np.float64)
        value = np.asarray(values, dtype=np.float64)
        if freq.ndim != 1 or freq.shape != value.shape or len(freq) < 2:
            raise ArgumentError(
                "a curve needs as many frequencies as values, at least 2, "
                f"got shapes {freq.shape} and {value.shape}"
            )
        if not (np.all(np.isfinite(freq)) and np.all(np.isfinite(value))):
            raise ArgumentError("a transfer function must be finite")
        if freq[0] != 0 or np.any(np.diff(freq) <= 0) or freq[-1] < _LOWEST_END_CY_PER_PX:
            raise ArgumentError(
                f"frequencies must increase from 0 to at least {_LOWEST_END_CY_PER_PX} cy/px, "
                f"got {freq[0]:g} to {freq[-1]:g}"
            )
        if abs(value[0] - 1) > _ZERO_TOLERANCE:
            raise ArgumentError(f"a transfer function must start at 1, got {value[0]:g}")
        object.__setattr__(self, "freq_cy_per_px", tuple(freq.tolist()))
        object.__setattr__(self, "values", tuple((value / value[0]).tolist()))

    def __repr__(self) -> str:
        return f"SampledTransfer({len(self.values)} values to {self.freq_cy_per_px[-1]:g} cy/px)"

    def __call__(self, freq_cy_per_px: FloatArray) -> FloatArray:
        """Return the transfer at frequencies in cycles per pixel."""
        from scipy.interpolate import PchipInterpolator  # .2 s, where a transfer has no formula

        curve = PchipInterpolator(self.freq_cy_per_px, self.values, extrapolate=False)
        return np.asarray(np.nan_to_num(curve(freq_cy_per_px), nan=0.0))
