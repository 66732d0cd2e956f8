"""The transfer function of a lens: a circular pupil out of focus, stretched, and a Gaussian."""

from dataclasses import dataclass
from functools import lru_cache
from math import isfinite, pi, sqrt
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from simulation.arrays import FloatArray
from simulation.psf.correction import OtfCorrection

DEFOCUS_MAX_WAVES = 8.0
"""Beyond, the quadrature of the pupil is too coarse, and no measured PSF is so soft."""

_PUPIL_NODES = 96
_TABLE_STEPS = 1024
# Coarser tables, quick to make for each step of a fit: steps and nodes that are right to 3e-5 up to
# a squared defocus.
_SLOPE_TABLES = ((1.0, 128, 24), (4.0, 256, 24), (16.0, 512, 40))
_NO_WAVES = 1e-4  # below, the sine is its argument

SymmetricMatrix = tuple[float, float, float]
"""Elements xx, xy and yy."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LensOtf:
    """Optical transfer function of a lens without the pixel: real, signed, 1 at frequency 0.

    ``OTF(|B f|, w) exp(-2 pi^2 f^T S f) + C(f)``: a circular pupil with the defocus w, its cut-off
    stretched to an ellipse, a Gaussian for all else that blurs, and what edges show beyond.

    Parameters
    ----------
    cut_off_period_px
        The symmetric matrix B in px: the pupil passes nothing where ``|B f|`` is 1 or more. With
        zeros there is no pupil, and no diffraction.
    defocus_waves
        Optical path difference at the pupil's rim, in wavelengths.
    gaussian_px2
        Covariance S of the Gaussian.
    correction
        The part C that is added; None for none.

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
    correction: OtfCorrection | None = None

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
        if not xx == xy == yy == 0:
            relative = np.hypot(xx * fx + xy * fy, xy * fx + yy * fy)
            transfer = transfer * pupil_otf(relative, self.defocus_waves)
        return np.asarray(
            transfer if self.correction is None else transfer + self.correction(fx, fy)
        )


def pupil_otf(relative_freq: FloatArray, defocus_waves: float) -> FloatArray:
    """Transfer of a circular pupil out of focus, at frequencies over the cut-off frequency.

    From a table over ``acos``, in which the curve is smooth up to its end; right to 1e-9.
    """
    relative = np.asarray(relative_freq, dtype=np.float64)
    table = _pupil_table(abs(defocus_waves))
    return np.where(relative < 1, table(np.arccos(np.minimum(relative, 1.0))), 0.0)


class PupilSlopes(NamedTuple):
    """Transfer of a pupil, its slope by relative frequency and by the square of the defocus."""

    otf: FloatArray
    by_freq: FloatArray
    by_defocus_waves2: FloatArray


def pupil_slopes(relative_freq: FloatArray, defocus_waves2: float) -> PupilSlopes:
    """Return ``pupil_otf`` with its derivatives, for whoever fits it; right to 3e-5.

    The transfer depends on the square of the defocus, in which it is smooth at 0.
    """
    relative = np.asarray(relative_freq, dtype=np.float64)
    inside = relative < 1
    angle = np.arccos(np.minimum(relative, 1.0))
    table = _slope_table(defocus_waves2)
    values, by_angle = table(angle), table(angle, 1)
    # d(angle)/d(nu) = -1 / sin(angle); at the cut-off the transfer falls with the angle's cube.
    by_freq = -by_angle[..., 0] / np.maximum(np.sin(angle), 1e-9)
    return PupilSlopes(
        np.where(inside, values[..., 0], 0.0),
        np.where(inside, by_freq, 0.0),
        np.where(inside, values[..., 1], 0.0),
    )


@lru_cache(maxsize=8)
def _slope_table(defocus_waves2: float) -> CubicSpline:
    """Spline over the angle ``acos(nu)``: the transfer, and its slope by the squared defocus."""
    for most, steps, nodes in _SLOPE_TABLES:
        if defocus_waves2 <= most:
            return CubicSpline(*_pupil_values(defocus_waves2, steps, nodes))
    return CubicSpline(*_pupil_values(defocus_waves2, _TABLE_STEPS, _PUPIL_NODES))


@lru_cache(maxsize=64)
def _pupil_table(defocus_waves: float) -> CubicSpline:
    """Spline over the angle ``acos(nu)``."""
    angle, values = _pupil_values(defocus_waves**2, _TABLE_STEPS, _PUPIL_NODES)
    return CubicSpline(angle, values[:, 0])


def _pupil_values(defocus_waves2: float, steps: int, nodes: int) -> tuple[FloatArray, FloatArray]:
    """Angles ``acos(nu)``, and the transfer there with its slope by the squared defocus."""
    angle, area, turn = _pupil_slices(steps, nodes)
    waves = sqrt(defocus_waves2)
    otf = np.sum(area * np.cos(turn * waves), axis=1)
    by_square = turn**2 if waves < _NO_WAVES else turn * np.sin(turn * waves) / waves
    slope = -0.5 * np.sum(area * by_square, axis=1)
    return angle, np.column_stack([otf, slope])


@lru_cache(maxsize=4)
def _pupil_slices(steps: int, nodes: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angles; per angle, the areas of slices of the common part of the pupil and its shifted copy.

    Also the phase between the two in each slice, in radians per wave of defocus.
    """
    angle = np.linspace(0.0, pi / 2, steps + 1)
    nu = np.cos(angle)[:, None]
    node, weight = np.polynomial.legendre.leggauss(nodes)
    theta = angle[:, None] * (node + 1) / 2
    area = 2 / pi * angle[:, None] * np.sin(theta) ** 2 * weight
    return angle, area, 8 * pi * nu * (np.cos(theta) - nu)
