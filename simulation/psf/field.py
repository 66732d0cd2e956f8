"""A PSF that varies over the frame."""

from dataclasses import dataclass
from math import hypot, isqrt, sqrt

import numpy as np

from simulation.arrays import FloatArray
from simulation.by_value import ByValue
from simulation.choices import PsfForm
from simulation.psf.gaussian import GaussianPsf
from simulation.psf.measured import MeasuredPsf, Psf

_CHECKED_POINTS = 33
"""Positions per axis at which a field is checked, corners included."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PsfField(ByValue):
    """The covariance of a PSF as a polynomial over the frame of one camera.

    With ``u = (x - (width - 1) / 2) / r`` and ``v = (y - (height - 1) / 2) / r``, where ``r`` is
    the distance of the corner pixels' centres from the frame's centre, every element of the
    covariance is ``sum_k c_k m_k(u, v)`` over the monomials by increasing degree, then by
    increasing power of v: ``1, u, v, u^2, u v, v^2, u^3, u^2 v, u v^2, v^3, ...``

    Parameters
    ----------
    width_px, height_px
        The frame that the field belongs to.
    coefficients_px2
        Shape ``(3, n)``: rows for the elements xx, xy, yy; n is 1, 3, 6, 10, ... for degree
        0, 1, 2, 3, ...
    shape
        The measured PSF that is stretched to these covariances; None for Gaussians.

    Raises
    ------
    ValueError
        If the frame or the shape is invalid, a coefficient is not finite, or the covariance is not
        positive definite somewhere in the frame.
    """

    width_px: int
    height_px: int
    coefficients_px2: FloatArray
    shape: MeasuredPsf | None = None

    def __post_init__(self) -> None:
        if self.width_px < 2 or self.height_px < 2:
            raise ValueError(
                f"a field needs at least 2 x 2 pixels, got {self.width_px} x {self.height_px}"
            )
        coefficients = np.array(self.coefficients_px2, dtype=np.float64)
        if coefficients.ndim != 2 or coefficients.shape[0] != 3:
            raise ValueError(f"coefficients must have shape (3, n), got {coefficients.shape}")
        count = coefficients.shape[1]
        degree = _degree(count)
        if count == 0 or (degree + 1) * (degree + 2) // 2 != count:
            raise ValueError(f"a polynomial of two variables has 1, 3, 6, ... terms, got {count}")
        if not np.isfinite(coefficients).all():
            raise ValueError("the field has NaN or infinite coefficients")
        coefficients.setflags(write=False)
        object.__setattr__(self, "coefficients_px2", coefficients)
        self._check_positive()

    def _check_positive(self) -> None:
        x_px = np.linspace(0, self.width_px - 1, _CHECKED_POINTS)[None, :]
        y_px = np.linspace(0, self.height_px - 1, _CHECKED_POINTS)[:, None]
        least = np.linalg.eigvalsh(self.covariance_px2(x_px, y_px))[..., 0]
        row, col = np.unravel_index(np.argmin(least), least.shape)
        if not least[row, col] > 0:
            raise ValueError(
                f"the covariance is not positive definite at ({x_px[0, col]:.0f}, "
                f"{y_px[row, 0]:.0f}) px: least eigenvalue {least[row, col]:.3g} px^2"
            )

    def __repr__(self) -> str:
        (xx, _), (_, yy) = self.covariance_px2(*self.centre_px).tolist()
        return (
            f"PsfField({self.width_px} x {self.height_px} px, degree {self.degree}, "
            f"in the centre sigma_x_px={sqrt(xx):.4g}, sigma_y_px={sqrt(yy):.4g})"
        )

    @property
    def gaussian(self) -> GaussianPsf:
        """The Gaussian nearest to the PSF in the centre of the frame."""
        return GaussianPsf.from_covariance(self.covariance_px2(*self.centre_px))

    @property
    def form(self) -> PsfForm:
        """What is known about the shape."""
        return "gaussian" if self.shape is None else self.shape.form

    @property
    def degree(self) -> int:
        """Degree of the polynomials."""
        return _degree(self.coefficients_px2.shape[1])

    @property
    def centre_px(self) -> tuple[float, float]:
        """Centre of the frame (x, y): u = v = 0."""
        return (self.width_px - 1) / 2, (self.height_px - 1) / 2

    @property
    def corner_radius_px(self) -> float:
        """Distance of the corner pixels' centres from the centre: u^2 + v^2 = 1."""
        return hypot(*self.centre_px)

    def at(self, x_px: float, y_px: float) -> Psf:
        """Return the PSF at a position in the frame."""
        gaussian = GaussianPsf.from_covariance(self.covariance_px2(x_px, y_px))
        return gaussian if self.shape is None else self.shape.stretched_to(gaussian)

    def covariance_px2(self, x_px: FloatArray | float, y_px: FloatArray | float) -> FloatArray:
        """Covariance at positions in the frame (pixel centres at integers).

        Returns
        -------
        ndarray of float64, shape (..., 2, 2)
            Order (x, y); the leading axes are those of ``x_px`` and ``y_px`` together.
        """
        monomials = field_monomials(self.width_px, self.height_px, self.degree, x_px, y_px)
        xx, xy, yy = (monomials @ row for row in self.coefficients_px2)
        return np.stack([np.stack([xx, xy], axis=-1), np.stack([xy, yy], axis=-1)], axis=-2)


def field_monomials(
    width_px: int,
    height_px: int,
    degree: int,
    x_px: FloatArray | float,
    y_px: FloatArray | float,
) -> FloatArray:
    """Monomials of a ``PsfField`` at positions in its frame, in the order of its coefficients.

    Returns
    -------
    ndarray of float64, shape (..., n)
        The leading axes are those of ``x_px`` and ``y_px`` together.
    """
    centre_x, centre_y = (width_px - 1) / 2, (height_px - 1) / 2
    radius = hypot(centre_x, centre_y)
    u = (np.asarray(x_px, dtype=np.float64) - centre_x) / radius
    v = (np.asarray(y_px, dtype=np.float64) - centre_y) / radius
    terms = [
        u ** (total - power) * v**power for total in range(degree + 1) for power in range(total + 1)
    ]
    return np.stack(terms, axis=-1)


def _degree(count: int) -> int:
    """Degree of the polynomial with ``count`` terms, if there is one."""
    return (isqrt(8 * count + 1) - 3) // 2
