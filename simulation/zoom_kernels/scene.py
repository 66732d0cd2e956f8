"""What two pixels of an average scene have in common: covariances seen through the PSFs.

The scene is isotropic and of first order: covariance ``exp(-|d| / L)``, power falling with the
third power of the frequency. A period of the scene stands for the plane; it is several times as
long as any window.
"""

from dataclasses import dataclass

import numpy as np

from simulation.arrays import FloatArray
from simulation.psf import Psf

SCENE_CORRELATION_PX = 30.0
"""Correlation length of the scene prior; from 3 to 100 px the errors differ by less than 1 %."""

_ALIASES = 3
"""Orders of aliasing on either side: beyond 3.5 cy/px the pixel and the scene leave 1e-4."""

_FAINT = 1e-11
"""Part of the cross spectrum's sum that may lie beyond the frequencies kept."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenScene:
    """The scene as the near camera sees it.

    Parameters
    ----------
    psf
        Total PSF of the camera.
    period_px
        Period of the scene, even.
    power, near
        Spectrum of the scene and transfer function, shape ``(rows, cols)``: at frequencies from 0
        up along y, of both signs along x.
    covariance
        Of two reference pixels, shape ``(period_px, period_px)``, by their distance; it wraps.
    """

    psf: Psf
    period_px: int
    power: FloatArray
    near: FloatArray
    covariance: FloatArray

    @classmethod
    def through(cls, psf: Psf, period_px: int, correlation_px: float) -> "SeenScene":
        """See a scene of variance 1, whose covariance falls to 1/e at ``correlation_px``."""
        fy, fx = _frequencies(period_px)
        angular = 2 * np.pi * correlation_px
        # Transform of exp(-|d| / L) in the plane, for a scene of variance 1.
        squared = fy[:, None] ** 2 + fx**2
        power = 2 * np.pi * (correlation_px / period_px) ** 2 / (1 + angular**2 * squared) ** 1.5
        near = psf.otf(fx[None, :], fy[:, None])
        upper = power * near**2
        both = np.concatenate([upper[:0:-1, ::-1], upper])
        orders = 2 * _ALIASES + 1
        # The lattice starts half a cycle below its lowest order; both ends of it are kept.
        folded = both[:-1, :-1].reshape(orders, period_px, orders, period_px).sum(axis=(0, 2))
        covariance = np.fft.fft2(np.fft.ifftshift(folded)).real
        return cls(psf, period_px, power, near, covariance)

    @property
    def is_mirrored(self) -> bool:
        """Whether the covariance is the same in the mirror of either axis."""
        mirrored = np.roll(self.covariance[::-1], 1, axis=0)
        return bool(np.allclose(mirrored, self.covariance, rtol=0, atol=1e-12 * self.variance))

    @property
    def is_diagonal(self) -> bool:
        """Whether the covariance is the same when rows and columns are exchanged."""
        tolerance = 1e-12 * self.variance
        return bool(np.allclose(self.covariance.T, self.covariance, rtol=0, atol=tolerance))

    @property
    def variance(self) -> float:
        """Variance of a reference pixel."""
        return float(self.covariance[0, 0])

    def across(self, zoom_y: float, zoom_x: float) -> "CrossCovariance":
        """Covariance of reference pixels with those of a camera further away."""
        fy, fx = _frequencies(self.period_px)
        far = self.psf.otf(zoom_x * fx[None, :], zoom_y * fy[:, None])
        # The lower half plane repeats the upper one.
        twice = np.where(fy > 0, 2.0, 1.0)[:, None]
        seen = twice * self.power * far
        values = seen * self.near
        variance = float(np.vdot(seen, far))
        middle = len(fx) // 2
        size = np.abs(values)
        by_column = size.sum(axis=0)
        by_column = by_column[middle:] + by_column[middle::-1]
        last = max(_reach(size.sum(axis=1)), _reach(by_column))
        kept = slice(middle - last, middle + last + 1)
        return CrossCovariance(fy[: last + 1], fx[kept], values[: last + 1, kept], variance)


@dataclass(frozen=True, slots=True, eq=False)
class CrossCovariance:
    """Covariance of reference and follow-up pixels, by frequency; ``variance`` of the latter."""

    freq_y: FloatArray
    freq_x: FloatArray
    values: FloatArray
    variance: float

    def at(self, distance_y_px: FloatArray, distance_x_px: FloatArray) -> FloatArray:
        """Covariances at all pairs of distances, shape ``(len(y), len(x))``."""
        y = 2 * np.pi * np.multiply.outer(distance_y_px, self.freq_y)
        x = 2 * np.pi * np.multiply.outer(distance_x_px, self.freq_x)
        even = (np.cos(y) @ self.values) @ np.cos(x).T
        return np.asarray(even - (np.sin(y) @ self.values) @ np.sin(x).T)


def _frequencies(period_px: int) -> tuple[FloatArray, FloatArray]:
    last = _ALIASES * period_px + period_px // 2
    steps = np.arange(-last, last + 1) / period_px
    return steps[last:], steps


def _reach(sums: FloatArray) -> int:
    """Index of the last frequency that matters."""
    beyond = 1 - np.cumsum(sums) / sums.sum()
    return int(np.argmax(beyond <= _FAINT))
