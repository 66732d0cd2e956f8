"""The transfer function of a lens: a circular pupil out of focus, stretched, and a Gaussian."""

from dataclasses import dataclass
from functools import lru_cache
from math import isfinite, pi

import numpy as np
from scipy.interpolate import CubicSpline

from simulation.arrays import FloatArray

DEFOCUS_MAX_WAVES = 8.0
"""Beyond, the quadrature of the pupil is too coarse, and no measured PSF is so soft."""

_PUPIL_NODES = 96
_TABLE_STEPS = 1024

SymmetricMatrix = tuple[float, float, float]
"""Elements xx, xy and yy."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LensOtf:
    """Optical transfer function of a lens without the pixel: real, signed, 1 at frequency 0.

    ``OTF(|B f|, w) exp(-2 pi^2 f^T S f)``: a circular pupil with the defocus w, its cut-off
    stretched to an ellipse, and a Gaussian for all else that blurs.

    Parameters
    ----------
    cut_off_period_px
        The symmetric matrix B in px: the pupil passes nothing where ``|B f|`` is 1 or more. With
        zeros there is no pupil, and no diffraction.
    defocus_waves
        Optical path difference at the pupil's rim, in wavelengths.
    gaussian_px2
        Covariance S of the Gaussian.

    Raises
    ------
    ValueError
        If a number is not finite, a matrix is not positive semidefinite or the defocus is beyond
        ``DEFOCUS_MAX_WAVES``.

    References
    ----------
    H. H. Hopkins, "The frequency response of a defocused optical system", Proc. R. Soc. A 231
    (1955), 91-103.
    """

    cut_off_period_px: SymmetricMatrix = (0.0, 0.0, 0.0)
    defocus_waves: float = 0.0
    gaussian_px2: SymmetricMatrix = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("cut_off_period_px", "gaussian_px2"):
            xx, xy, yy = values = getattr(self, name)
            if not all(isfinite(value) for value in values):
                raise ValueError(f"{name} must be finite, got {values}")
            # Rounding may leave a singular matrix a hair below 0.
            if min(xx, yy) < 0 or xx * yy - xy * xy < -1e-9 * (xx + yy) ** 2:
                raise ValueError(f"{name} must not be negative definite, got {values}")
        if not abs(self.defocus_waves) <= DEFOCUS_MAX_WAVES:
            raise ValueError(
                f"defocus_waves must be at most {DEFOCUS_MAX_WAVES:g}, got {self.defocus_waves}"
            )

    def __call__(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """Return the transfer at frequencies in cycles per pixel; the two are broadcast."""
        fx, fy = np.asarray(fx_cy_per_px), np.asarray(fy_cy_per_px)
        xx, xy, yy = self.gaussian_px2
        transfer = np.exp(-2 * pi**2 * (xx * fx * fx + 2 * xy * fx * fy + yy * fy * fy))
        xx, xy, yy = self.cut_off_period_px
        if xx == xy == yy == 0:
            return np.asarray(transfer)
        return np.asarray(
            transfer * pupil_otf(np.hypot(xx * fx + xy * fy, xy * fx + yy * fy), self.defocus_waves)
        )


def pupil_otf(relative_freq: FloatArray, defocus_waves: float) -> FloatArray:
    """Transfer of a circular pupil out of focus, at frequencies over the cut-off frequency.

    From a table over ``acos``, in which the curve is smooth up to its end; right to 1e-9.
    """
    relative = np.asarray(relative_freq, dtype=np.float64)
    table = _pupil_table(abs(defocus_waves))
    return np.where(relative < 1, table(np.arccos(np.minimum(relative, 1.0))), 0.0)


@lru_cache(maxsize=64)
def _pupil_table(defocus_waves: float) -> CubicSpline:
    """Spline over the angle ``acos(nu)``."""
    angle = np.linspace(0.0, pi / 2, _TABLE_STEPS + 1)
    nu = np.cos(angle)
    nodes, weights = np.polynomial.legendre.leggauss(_PUPIL_NODES)
    # Half the common part of the pupil and its shifted copy, as a sum over slices.
    theta = angle[:, None] * (nodes + 1) / 2
    slices = np.sin(theta) ** 2 * np.cos(
        8 * pi * defocus_waves * nu[:, None] * (np.cos(theta) - nu[:, None])
    )
    values = 4 / pi * (slices @ weights) * angle / 2
    return CubicSpline(angle, values)
