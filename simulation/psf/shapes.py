"""The PSFs that operators take: a Gaussian, two curves, a lens with its pixels, and a field."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, isqrt, sqrt
from typing import Literal, Protocol, Self, overload

import numpy as np

from simulation.arguments import ArgumentError, ArgumentTypeError, accepted
from simulation.arrays import FloatArray
from simulation.by_value import ByValue
from simulation.choices import PsfForm
from simulation.psf.lens import LensOtf

_PIXEL_VARIANCE_PX2 = 1.0 / 12.0
"""Variance of the unit pixel square along either axis."""


@dataclass(frozen=True, slots=True, init=False)
class GaussianPsf:
    """A Gaussian PSF with the widths sigma along x and y, and their correlation.

    Parameters
    ----------
    sigma_x_px, sigma_y_px, rho
        Standard deviations along x and y, and correlation, of the total PSF: optics and pixel.
    sigma_px
        Instead of these, the standard deviation of a round PSF.

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
        """The nearest Gaussian: this PSF itself."""
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


@dataclass(frozen=True, slots=True, init=False)
class SampledTransfer:
    """A measured transfer function, as from an edge; the pixel is included.

    Monotone cubic between the samples (PCHIP), 0 beyond the last. The frequencies increase from 0
    to at least 0.5; the amplitudes are divided by the first, which must be near 1.
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


_LEAST_VARIANCE_PX2 = 1e-3
"""Least variance of the optics where a PSF is hardly wider than its pixel."""


class Psf(Protocol):
    """A total PSF, optics and pixel, symmetric about its centre.

    It must be hashable, and equal PSFs must have equal hashes: operators are cached by PSF.
    """

    def otf(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """Return the OTF, real and signed, 1 at frequency 0; fx and fy broadcast."""
        ...

    @property
    def gaussian(self) -> GaussianPsf:
        """The Gaussian nearest to this PSF."""
        ...

    @property
    def form(self) -> PsfForm:
        """The form in which this PSF is known."""
        ...

    @property
    def covariance_px2(self) -> FloatArray:
        """Covariance of the nearest Gaussian, shape (2, 2), order (x, y)."""
        ...

    def __hash__(self) -> int: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredPsf:
    """The PSF of a lens in front of square pixels.

    Parameters
    ----------
    lens
        OTF of the optics.
    gaussian
        The Gaussian nearest to the total PSF, from the same edges; used by models that only take a
        Gaussian, and wherever a size is needed.
    stretch
        Rows of a matrix T: the OTF of the optics is ``lens(T f)``, which stretches their PSF. A PSF
        that varies over the frame is one PSF, stretched differently at each place.
    """

    lens: LensOtf
    gaussian: GaussianPsf
    stretch: tuple[tuple[float, float], tuple[float, float]] = ((1.0, 0.0), (0.0, 1.0))

    def otf(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """Return the transfer function of optics and pixel at frequencies in cycles per pixel."""
        fx, fy = np.asarray(fx_cy_per_px), np.asarray(fy_cy_per_px)
        (xx, xy), (yx, yy) = self.stretch
        lens = self.lens(xx * fx + xy * fy, yx * fx + yy * fy)
        return np.asarray(np.sinc(fx) * np.sinc(fy) * lens)

    @property
    def form(self) -> PsfForm:
        """The form in which the PSF of the lens is known."""
        if self.lens.correction is not None:
            return "free"
        if self.lens.cut_off_period_px == (0.0, 0.0, 0.0):
            return "gaussian"
        is_round = all(
            xx == yy and xy == 0
            for xx, xy, yy in (
                self.lens.cut_off_period_px,
                self.lens.defocus_waves2,
                self.lens.gaussian_px2,
            )
        )
        return "round" if is_round else "elliptic"

    @property
    def covariance_px2(self) -> FloatArray:
        """Covariance of the nearest Gaussian, shape (2, 2), order (x, y)."""
        return self.gaussian.covariance_px2

    def stretched_to(self, gaussian: GaussianPsf) -> Self:
        """Return the PSF stretched so that ``gaussian`` is the Gaussian nearest to it."""
        own, wanted = (_without_pixel(psf.covariance_px2) for psf in (self.gaussian, gaussian))
        matrix = _root(wanted) @ np.linalg.inv(_root(own))
        # A transfer function takes the transpose of the matrix that stretches its PSF.
        (xx, xy), (yx, yy) = (np.array(self.stretch) @ matrix.T).tolist()
        return type(self)(lens=self.lens, gaussian=gaussian, stretch=((xx, xy), (yx, yy)))


@dataclass(frozen=True, slots=True, kw_only=True)
class SeparablePsf:
    """A PSF that is known along the two axes only: its OTF is the product of two curves.

    The curves ``along_y`` and ``along_x`` include the pixel; ``gaussian`` is the nearest Gaussian.
    """

    along_y: Transfer
    along_x: Transfer
    gaussian: GaussianPsf

    def otf(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """Return the transfer function at frequencies in cycles per pixel."""
        along_x = self.along_x(np.abs(np.asarray(fx_cy_per_px)))
        return np.asarray(along_x * self.along_y(np.abs(np.asarray(fy_cy_per_px))))

    @property
    def form(self) -> PsfForm:
        """``separable``: known as one curve along either axis."""
        return "separable"

    @property
    def covariance_px2(self) -> FloatArray:
        """Covariance of the nearest Gaussian, shape (2, 2), order (x, y)."""
        return self.gaussian.covariance_px2


def _without_pixel(covariance_px2: FloatArray) -> FloatArray:
    """Subtract the pixel's variance, as far as that leaves something in every direction."""
    values, vectors = np.linalg.eigh(covariance_px2 - _PIXEL_VARIANCE_PX2 * np.eye(2))
    return np.asarray((vectors * np.maximum(values, _LEAST_VARIANCE_PX2)) @ vectors.T)


def _root(covariance: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.sqrt(values)) @ vectors.T)


_CHECKED_POINTS = 33
"""Positions per axis at which a field is checked, corners included."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PsfField(ByValue):
    """The covariance of a PSF as a polynomial over the frame of one camera.

    With ``u = (x - (width - 1) / 2) / r`` and ``v = (y - (height - 1) / 2) / r``, where ``r`` is
    the distance of the corner pixels' centres from the frame's centre, every element of the
    covariance is ``sum_k c_k m_k(u, v)`` over the monomials by increasing degree, then by
    increasing power of v: ``1, u, v, u^2, u v, v^2, u^3, u^2 v, u v^2, v^3, ...``

    ``coefficients_px2``, shape ``(3, n)``, has rows for the elements xx, xy, yy; n is 1, 3, 6, 10,
    ... for degree 0, 1, 2, 3, ... They are refused where the covariance is not positive definite
    somewhere in the frame. ``shape`` is the measured PSF that is stretched to these covariances;
    None for Gaussians.
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
        """Covariance at positions that broadcast, shape (..., 2, 2), order (x, y)."""
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
    """Monomials in the order of a field's coefficients, shape (..., n); x and y broadcast."""
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
