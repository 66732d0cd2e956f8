"""The point spread function as a Gaussian: the value object that the capture model uses."""

from dataclasses import dataclass
from math import sqrt
from typing import Literal, Self, overload

import numpy as np

from simulation.arguments import ArgumentError, ArgumentTypeError, accepted
from simulation.arrays import FloatArray

PIXEL_VARIANCE_PX2 = 1.0 / 12.0
"""Variance of the unit pixel square along either axis."""


@dataclass(frozen=True, slots=True, init=False)
class GaussianPsf:
    """A Gaussian PSF, in pixels: widths along columns (x) and rows (y), and their correlation.

    Parameters
    ----------
    sigma_x_px, sigma_y_px, rho
        Of the whole PSF, optics and pixel.
    sigma_px
        Instead of them, the width of a round one.

    Raises
    ------
    ArgumentTypeError
        If a width is missing, or given twice.
    ArgumentError
        If a width is not positive or ``rho`` is not inside (-1, 1).

    Examples
    --------
    >>> standoff.GaussianPsf(0.8, 0.7)
    GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.7, rho=0.0)
    >>> standoff.GaussianPsf(sigma_px=0.8)
    GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.8, rho=0.0)
    """

    sigma_x_px: float
    sigma_y_px: float
    rho: float = 0.0

    @overload
    def __init__(self, sigma_x_px: float, sigma_y_px: float, rho: float = 0.0) -> None: ...
    @overload
    def __init__(self, *, sigma_px: float) -> None: ...
    def __init__(
        self,
        sigma_x_px: float | None = None,
        sigma_y_px: float | None = None,
        rho: float = 0.0,
        *,
        sigma_px: float | None = None,
    ) -> None:
        if sigma_px is not None:
            if sigma_x_px is not None or sigma_y_px is not None or rho != 0:
                raise ArgumentTypeError(
                    "it is the width of a round PSF; leave the others out", argument="sigma_px"
                )
            sigma_x_px = sigma_y_px = accepted("sigma_px", sigma_px, float)
        for name, value in (("sigma_x_px", sigma_x_px), ("sigma_y_px", sigma_y_px)):
            if value is None:
                raise ArgumentTypeError(
                    "it is missing; a round PSF is GaussianPsf(sigma_px=...)", argument=name
                )
            object.__setattr__(self, name, accepted(name, value, float))
        object.__setattr__(self, "rho", accepted("rho", rho, float))
        if abs(self.rho) == 1:
            raise ArgumentError(f"expected a number inside (-1, 1), got {rho}", argument="rho")

    @classmethod
    def from_covariance(cls, covariance_px2: FloatArray) -> Self:
        """Make a PSF from a covariance matrix, order (x, y), in px^2."""
        (xx, xy), (_, yy) = np.asarray(covariance_px2, dtype=np.float64).tolist()
        if not (xx > 0 and yy > 0 and xx * yy > xy * xy):
            raise ValueError(f"covariance must be positive definite, got {covariance_px2!r}")
        return cls(sigma_x_px=sqrt(xx), sigma_y_px=sqrt(yy), rho=xy / sqrt(xx * yy))

    @property
    def gaussian(self) -> Self:
        """The Gaussian nearest to it: itself."""
        return self

    @property
    def form(self) -> Literal["gaussian"]:
        """What is known about the shape."""
        return "gaussian"

    @property
    def covariance_px2(self) -> FloatArray:
        """Covariance matrix, shape (2, 2), order (x, y), in px^2."""
        xy = self.rho * self.sigma_x_px * self.sigma_y_px
        return np.array([[self.sigma_x_px**2, xy], [xy, self.sigma_y_px**2]])

    def otf(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """Return the transfer function at frequencies in cycles per pixel; the two broadcast."""
        fx, fy = np.asarray(fx_cy_per_px), np.asarray(fy_cy_per_px)
        (xx, xy), (_, yy) = self.covariance_px2.tolist()
        if xy == 0 and fx.shape != fy.shape:
            # Along each axis alone: of a grid, that takes fewer exponentials.
            along_x, along_y = (np.exp(-2 * np.pi**2 * v * f * f) for v, f in ((xx, fx), (yy, fy)))
            return np.asarray(along_x * along_y)
        return np.asarray(np.exp(-2 * np.pi**2 * (xx * fx * fx + 2 * xy * fx * fy + yy * fy * fy)))
