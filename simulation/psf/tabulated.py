"""A PSF that the user supplies: by a kernel, an OTF, a pupil or its Zernike coefficients."""

from collections.abc import Callable, Mapping
from dataclasses import InitVar, dataclass, field
from functools import lru_cache
from hashlib import sha256
from math import ceil, factorial, isfinite, log, pi, sqrt
from typing import Any, ClassVar, Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulation.arguments import (
    ArgumentError,
    ArgumentTypeError,
    accepted,
    checked,
    whole_array,
)
from simulation.arrays import FloatArray
from simulation.choices import PsfForm
from simulation.psf.shapes import GaussianPsf

OtfFunction = Callable[[FloatArray, FloatArray], Any]
"""Transfer at frequencies fx and fy in cycles per pixel; the two broadcast."""

_NYQUIST_CY_PER_PX = 0.5
_LAST_CY_PER_PX = 4.0  # what lies beyond, no zoom folds back
_FUNCTION_LAST_CY_PER_PX, _FUNCTION_STEPS = 2.0, 128
_STEPS_PER_EXTENT = 6  # of one over the kernel's extent: a cubic spline is then right to 1e-5
_ZERO_TOLERANCE = 0.02  # how far from 1 a transfer may be at frequency 0; it is divided by that
_PUPIL_SAMPLES: Final = 256
_RIM_SAMPLES = 4  # per sample of the pupil and axis: its rim is averaged
_FEWEST, _WIDEST_KERNEL = 3, 1024
_ANGLES_RAD = np.deg2rad([0.0, 45.0, 90.0, 135.0])
_HALF_STEPS = 400


@dataclass(frozen=True, kw_only=True)
class TabulatedPsf:
    """A PSF given by a table of its OTF; made by one of the ``from_`` methods.

    Its centre is the centroid. Operators need a PSF that is symmetric about its centre: the
    asymmetric part is left out, and ``asymmetry`` says how large it is.

    Parameters
    ----------
    table
        Real OTF at frequencies ``step_cy_per_px`` apart, shape ``(n + 1, 2 n + 1)``: rows from
        fy = 0 on, columns about fx = 0. The OTF is the same at opposite frequencies, and 0 beyond
        the table.
    step_cy_per_px
        Distance between neighbouring frequencies.
    has_pixel
        Whether the table includes the camera's pixel; if not, a square pixel is added.
    asymmetry
        Root mean square of the OTF's imaginary part, relative to that of the whole OTF, up to the
        Nyquist frequency.

    Attributes
    ----------
    gaussian
        The Gaussian whose contrast falls to a half at the same frequencies.
    table_sha256
        Hash of the table, by which two PSFs are distinguished.

    Examples
    --------
    >>> psf = standoff.TabulatedPsf.from_zernike({4: 0.1}, cut_off_period_px=0.37)
    >>> round(psf.gaussian.sigma_x_px, 2)
    0.44
    >>> far = standoff.simulate("before.tif", zoom=2, psf=psf)
    """

    _last: ClassVar[int]
    _spline: ClassVar[FloatArray]
    table: InitVar[FloatArray]
    step_cy_per_px: float
    has_pixel: bool
    asymmetry: float = 0.0
    gaussian: GaussianPsf = field(init=False)
    table_sha256: str = field(init=False, repr=False)

    def __post_init__(self, table: FloatArray) -> None:
        from scipy.ndimage import spline_filter  # .1 s, where a PSF is not of a calibration

        for name, hint in (("step_cy_per_px", float), ("has_pixel", bool), ("asymmetry", float)):
            object.__setattr__(self, name, accepted(name, getattr(self, name), hint))
        values = np.ascontiguousarray(_checked(table, "table", 2))
        if values.shape[1] != 2 * len(values) - 1:
            raise ArgumentError(
                f"expected the shape (n + 1, 2 n + 1), got {values.shape}", argument="table"
            )
        # About fx = 0 and fy = 0 the curve goes on as its opposite half.
        whole = np.concatenate([values[:0:-1, ::-1], values])
        # A frozen class takes values in this way alone; arrays are no fields, whose comparison
        # would be one of each value.
        object.__setattr__(self, "_last", len(values) - 1)
        object.__setattr__(self, "_spline", spline_filter(whole, mode="nearest"))
        object.__setattr__(self, "table_sha256", sha256(values.tobytes()).hexdigest())
        object.__setattr__(self, "gaussian", self._nearest_gaussian())

    @classmethod
    @checked
    def from_kernel(
        cls, kernel: ArrayLike, *, samples_per_px: float = 1.0, has_pixel: bool = True
    ) -> Self:
        """Return the PSF of a sampled kernel.

        Parameters
        ----------
        kernel
            Samples of the PSF, shape ``(rows, cols)``, in any unit; the rest of the plane is 0.
        samples_per_px
            Samples per camera pixel along either axis. Beyond half of that number, in cycles per
            pixel, the OTF is taken as 0.
        has_pixel
            Whether the kernel includes the camera's pixel, as a kernel measured in its pictures
            does; False for the PSF of the optics alone.

        Raises
        ------
        ArgumentError
            If the kernel is not a finite image with a positive sum, or ``samples_per_px`` is not
            positive.
        """
        values = _checked(kernel, "kernel", 2)
        total = float(values.sum())
        if not total > 1e-6 * float(np.abs(values).sum()):
            raise ArgumentError("its sum must be positive", argument="kernel")
        rows, cols = values.shape
        if max(rows, cols) > _WIDEST_KERNEL:
            raise ArgumentError(
                f"{cols} x {rows} samples are more than {_WIDEST_KERNEL} a side; crop it to the "
                "PSF",
                argument="kernel",
            )
        y, x = (_from_centroid(values.sum(axis=k)) / samples_per_px for k in (1, 0))
        step = samples_per_px / (_STEPS_PER_EXTENT * max(rows, cols))
        last = ceil(min(samples_per_px / 2, _LAST_CY_PER_PX) / step) - 1
        turn = -2j * pi * step
        by_row = np.exp(turn * np.outer(np.arange(last + 1), y))
        by_col = np.exp(turn * np.outer(x, np.arange(-last, last + 1)))
        return cls._of_half(by_row @ (values / total) @ by_col, step, has_pixel)

    @classmethod
    @checked
    def from_otf(cls, otf: OtfFunction, *, has_pixel: bool = True) -> Self:
        """Return the PSF with a given OTF.

        Parameters
        ----------
        otf
            Function of the frequencies fx and fy in cycles per pixel, which broadcast; it is called
            with frequencies up to 2. Its phase must be relative to the centre of the PSF: a shift
            would count as asymmetry.
        has_pixel
            Whether the OTF includes the camera's pixel.

        Raises
        ------
        ArgumentError
            If the values of ``otf`` are not finite, not of the frequencies' shape, or not 1 at
            frequency 0.
        """
        steps = np.arange(-_FUNCTION_STEPS, _FUNCTION_STEPS + 1)
        step = _FUNCTION_LAST_CY_PER_PX / _FUNCTION_STEPS
        fy, fx = np.meshgrid(steps * step, steps * step, indexing="ij")
        try:
            values = np.asarray(otf(fx, fy))
        except TypeError as error:
            raise ArgumentTypeError(
                f"expected a function of fx and fy, arrays: {error}", argument="otf"
            ) from error
        if values.shape != fx.shape or not np.all(np.isfinite(values)):
            raise ArgumentError("its values must be finite, one for each frequency", argument="otf")
        return cls._of_half(values[_FUNCTION_STEPS:], step, has_pixel)

    @classmethod
    @checked
    def from_mtf(cls, freq_cy_per_px: ArrayLike, mtf: ArrayLike, *, has_pixel: bool = True) -> Self:
        """Return the PSF of a lens that is the same in all directions, from a table of its MTF.

        Parameters
        ----------
        freq_cy_per_px
            Frequencies in cycles per pixel, increasing from 0, shape ``(n,)``.
        mtf
            MTF at these frequencies, 1 at frequency 0, shape ``(n,)``; it is 0 beyond the last.
        has_pixel
            Whether the MTF includes the camera's pixel.

        Raises
        ------
        ArgumentError
            If the table is not a valid MTF; see ``SampledTransfer``.
        """
        from simulation.psf.shapes import SampledTransfer

        curve = SampledTransfer(
            _checked(freq_cy_per_px, "freq_cy_per_px", 1), _checked(mtf, "mtf", 1)
        )
        return cls.from_otf(lambda fx, fy: curve(np.hypot(fx, fy)), has_pixel=has_pixel)

    @classmethod
    @checked
    def from_pupil(
        cls, pupil: ArrayLike, *, cut_off_period_px: float, diameter: float | None = None
    ) -> Self:
        """Return the PSF of a lens with a given exit pupil, in front of square pixels.

        Parameters
        ----------
        pupil
            Complex amplitude over the pupil, shape ``(n, n)``: ``A exp(2 pi i W)`` with the
            transmission A and the path difference W in wavelengths.
        cut_off_period_px
            Period of the finest grating that passes: wavelength times f-number over pixel pitch.
        diameter
            Diameter of the pupil in samples; n if None.

        Raises
        ------
        ArgumentError
            If the pupil is not a finite, square array that passes light, or if the period or the
            diameter is not positive.

        Notes
        -----
        The OTF is the autocorrelation of the pupil (J. W. Goodman, Introduction to Fourier Optics,
        section 6.3).
        """
        values = _checked(pupil, "pupil", 2, complex)
        if values.shape[0] != values.shape[1]:
            raise ArgumentError(
                f"expected a square array, got the shape {values.shape}", argument="pupil"
            )
        if not np.any(values):
            raise ArgumentError("its values must be finite, and not all 0", argument="pupil")
        across = float(len(values)) if diameter is None else diameter
        power = float(np.sum(np.abs(values) ** 2))
        return cls._of_pupil(values, 1 / (cut_off_period_px * across), power)

    @classmethod
    def _of_pupil(cls, values: NDArray[np.complex128], step: float, power: float) -> Self:
        """The PSF of a pupil that lets this power through, of the frequency step of a sample."""
        middle = len(values)
        spread = np.abs(np.fft.fft2(values, (2 * middle, 2 * middle))) ** 2
        spectrum = np.fft.fftshift(np.conj(np.fft.ifft2(spread))) / power
        spectrum[middle, middle] = 1.0
        half = spectrum[middle:, 1:]
        # The centroid is the slope of the phase at frequency 0.
        right, down = np.angle(half[0, middle]), np.angle(half[1, middle - 1])
        turn = np.arange(middle)[:, None] * down + np.arange(1 - middle, middle) * right
        return cls._of_half(half * np.exp(-1j * turn), step, has_pixel=False)

    @classmethod
    @checked
    def from_zernike(
        cls, waves: Mapping[int, float], *, cut_off_period_px: float, obscured: float = 0.0
    ) -> Self:
        """Return the PSF of a lens from the Zernike coefficients of its wavefront.

        The lens is in front of square pixels.

        Parameters
        ----------
        waves
            Coefficients in wavelengths, by Noll's index: 4 is defocus, 5 and 6 are astigmatism, 7
            and 8 coma, 11 is spherical aberration. Each is the root mean square of its term over
            the pupil.
        cut_off_period_px
            Period of the finest grating that passes: wavelength times f-number over pixel pitch.
        obscured
            Diameter of a central obstruction relative to that of the pupil, from 0 to below 1.

        Raises
        ------
        ArgumentError
            If an index is not a positive integer, a coefficient is not finite, or ``obscured`` is
            not in [0, 1).

        References
        ----------
        R. J. Noll, "Zernike polynomials and atmospheric turbulence", J. Opt. Soc. Am. 66 (1976),
        207-211.
        """
        if not 0 <= obscured < 1:
            raise ArgumentError(
                f"must be at least 0 and below 1, got {obscured}", argument="obscured"
            )
        place = (np.arange(_PUPIL_SAMPLES) + 0.5) / (_PUPIL_SAMPLES / 2) - 1
        y, x = np.meshgrid(place, place, indexing="ij")
        path = np.zeros_like(x)
        for number, coefficient in waves.items():
            if not isfinite(coefficient):
                raise ArgumentError(
                    f"coefficient {number} must be finite, got {coefficient}", argument="waves"
                )
            path += coefficient * _zernike(number, np.hypot(x, y), np.arctan2(y, x))
        covered = _ring(obscured)
        pupil = covered * np.exp(2j * pi * path)
        # Samples at the rim are parts of samples, not weaker light.
        step = 1 / (cut_off_period_px * _PUPIL_SAMPLES)
        return cls._of_pupil(pupil, step, float(covered.sum()))

    def otf(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """Return the transfer function of optics and pixel at frequencies in cycles per pixel."""
        from scipy.ndimage import map_coordinates

        fx, fy = np.broadcast_arrays(np.asarray(fx_cy_per_px), np.asarray(fy_cy_per_px))
        middle = self._last
        places = np.stack([fy.ravel(), fx.ravel()]) / self.step_cy_per_px
        inside = np.all(np.abs(places) <= middle, axis=0)
        values = map_coordinates(
            self._spline, np.where(inside, places, 0.0) + middle, prefilter=False, mode="nearest"
        )
        total = np.where(inside, values, 0.0).reshape(fx.shape)
        return np.asarray(total if self.has_pixel else total * np.sinc(fx) * np.sinc(fy))

    @property
    def form(self) -> PsfForm:
        """What is known about its shape."""
        return "own"

    @property
    def covariance_px2(self) -> FloatArray:
        """Covariance of the nearest Gaussian, shape (2, 2), order (x, y)."""
        return self.gaussian.covariance_px2

    @classmethod
    def _of_half(cls, half: NDArray[Any], step: float, has_pixel: bool) -> Self:
        """The PSF of its complex transfer from fy = 0 on, about its centroid."""
        at_zero = complex(half[0, half.shape[1] // 2])
        if abs(at_zero - 1) > _ZERO_TOLERANCE:
            raise ArgumentError(f"a transfer function must be 1 at frequency 0, got {at_zero:.3g}")
        half = half / at_zero
        last = len(half) - 1
        fy, fx = np.mgrid[: last + 1, -last : last + 1] * step
        seen = half[np.hypot(fx, fy) <= _NYQUIST_CY_PER_PX]
        return cls(
            table=np.ascontiguousarray(half.real),
            step_cy_per_px=step,
            has_pixel=has_pixel,
            asymmetry=float(np.sqrt(np.sum(seen.imag**2) / np.sum(np.abs(seen) ** 2))),
        )

    def _nearest_gaussian(self) -> GaussianPsf:
        """The Gaussian whose contrast falls to a half where this one's does, in four directions."""
        last = self.step_cy_per_px * self._last
        freq = np.linspace(0.0, last, _HALF_STEPS)
        variances = []
        for angle in _ANGLES_RAD.tolist():
            values = self.otf(freq * np.cos(angle), freq * np.sin(angle))
            below = np.flatnonzero(values < 0.5)
            if below.size == 0:
                raise ArgumentError("its contrast does not fall to a half up to the last frequency")
            pair = slice(below[0] - 1, below[0] + 1)
            half = float(np.interp(-0.5, -values[pair], freq[pair]))
            variances.append(log(2) / (2 * pi**2 * half**2))
        c, s = np.cos(_ANGLES_RAD), np.sin(_ANGLES_RAD)
        design = np.column_stack([c * c, 2 * c * s, s * s])
        xx, xy, yy = np.linalg.lstsq(design, np.array(variances), rcond=None)[0].tolist()
        return GaussianPsf.from_covariance(np.array([[xx, xy], [xy, yy]]))


def _checked(
    values: ArrayLike, name: str, dimensions: int, kind: type[float] | type[complex] = float
) -> NDArray[Any]:
    """The finite numbers of an array that has so many dimensions."""
    try:
        # Numbers of a pupil are complex, which no other array is.
        array = np.asarray(values if kind is complex else whole_array(values, name), dtype=kind)
    except (TypeError, ValueError, OverflowError) as error:
        if isinstance(error, ArgumentError):
            raise
        raise ArgumentError("expected an array of numbers", argument=name) from error
    if array.ndim != dimensions or min(array.shape, default=0) < _FEWEST:
        raise ArgumentError(
            f"expected {dimensions} dimensions of at least {_FEWEST} values each, got the shape "
            f"{array.shape}",
            argument=name,
        )
    if not np.all(np.isfinite(array)):
        raise ArgumentError("its values must be finite", argument=name)
    return array


def _from_centroid(profile: FloatArray) -> FloatArray:
    """Places of samples from their centre of gravity."""
    place = np.arange(profile.size, dtype=np.float64)
    return np.asarray(place - (profile @ place) / profile.sum())


@lru_cache(maxsize=8)
def _ring(obscured: float) -> FloatArray:
    """How much of each sample of the pupil's square lies in the ring between the two circles."""
    fine = _PUPIL_SAMPLES * _RIM_SAMPLES
    place = (np.arange(fine) + 0.5) / (fine / 2) - 1
    square = place[:, None] ** 2 + place[None, :] ** 2
    is_open = (square <= 1) & (square >= obscured**2)
    blocks = is_open.reshape(_PUPIL_SAMPLES, _RIM_SAMPLES, _PUPIL_SAMPLES, _RIM_SAMPLES)
    return np.asarray(blocks.mean(axis=(1, 3)))


def _zernike(number: int, radius: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Zernike polynomial of Noll's number, of unit variance over the pupil."""
    if number < 1 or number != int(number):
        raise ArgumentError(f"Noll's numbers are 1, 2, 3 ..., got {number}", argument="waves")
    order = ceil((sqrt(8 * number + 1) - 3) / 2)
    left = number - order * (order + 1) // 2 - 1
    turns = 2 * ((left + (order + 1) % 2) // 2) + order % 2
    radial = np.zeros_like(radius)
    for k in range((order - turns) // 2 + 1):
        top, bottom = factorial(order - k), factorial(k)
        bottom *= factorial((order + turns) // 2 - k) * factorial((order - turns) // 2 - k)
        radial += (-1) ** k * top / bottom * radius ** (order - 2 * k)
    if turns == 0:
        return np.asarray(sqrt(order + 1) * radial)
    wave = np.cos if number % 2 == 0 else np.sin
    return np.asarray(sqrt(2 * (order + 1)) * radial * wave(turns * angle_rad))
