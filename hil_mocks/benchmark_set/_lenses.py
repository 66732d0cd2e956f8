"""Lenses of the benchmark: optical transfer functions in cycles per pixel, in closed form.

The system's transfer function is the lens's times that of the square pixel, which has unit fill.
"""

from dataclasses import asdict, dataclass
from functools import lru_cache
from math import cos, inf, pi, radians, sin, sqrt
from typing import Any, Protocol

import numpy as np
import scipy.fft
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import brentq

ZERNIKE_TERMS = ("defocus", "astig1", "astig2", "coma1", "coma2", "spher")
"""Noll's Z4 to Z8 and Z11: Z5 and Z7 are the sine terms."""

_RADII = 161
_BEARINGS = 64
"""Measured over half a turn: a real pupil's other half is the conjugate."""

_FINER = 8
_NODES = 40

PupilTable = NDArray[np.complex128]
"""Mean phasor, shape (radii, bearings): equal steps of sqrt(1 - relative frequency), and of a
whole turn."""


def _diffraction_mtf(relative_freq: NDArray[np.float64]) -> NDArray[np.float64]:
    """MTF of a perfect circular pupil at frequencies over the cut-off.

    J. W. Goodman, Introduction to Fourier Optics, 4th ed. 2017, section 7.2.2.
    """
    v = np.minimum(relative_freq, 1.0)
    return np.asarray(2 / pi * (np.arccos(v) - v * np.sqrt(1 - v * v)))


def _pupil_table(zernike_waves: tuple[float, ...]) -> PupilTable:
    """Tabulate the mean phasor of a pupil with these coefficients of `ZERNIKE_TERMS`.

    R. J. Noll, "Zernike polynomials and atmospheric turbulence", J. Opt. Soc. Am. 66 (1976),
    207-211, table I.
    """
    nodes, weights = (of.astype(np.float64) for of in np.polynomial.legendre.leggauss(_NODES))
    # Common parts of pupils narrow to points at the cut-off, where nothing is left to average.
    frequency = 1 - np.linspace(0.0, 1.0, _RADII) ** 2
    bearing = np.arange(_BEARINGS, dtype=np.float64) * (pi / _BEARINGS)
    half = _mean_phasors(np.array(zernike_waves), frequency, bearing, nodes, weights)
    series = scipy.fft.fft(np.hstack([half, half.conj()]), axis=1)
    wide = np.zeros((_RADII, 2 * _BEARINGS * _FINER), dtype=np.complex128)
    wide[:, :_BEARINGS] = series[:, :_BEARINGS]
    wide[:, -_BEARINGS:] = series[:, -_BEARINGS:]
    return np.ascontiguousarray(scipy.fft.ifft(wide, axis=1) * _FINER)


def _read_pupil_table(
    table: PupilTable, relative_freq: NDArray[np.float64], bearing_rad: NDArray[np.float64]
) -> PupilTable:
    """Mean phasor at frequencies over the cut-off and bearings; beyond it, that at the cut-off."""
    flat = _read(table, relative_freq.ravel(), bearing_rad.ravel())
    return np.asarray(flat.reshape(relative_freq.shape))


@njit(cache=True)
def _path_waves(waves: NDArray[np.float64], x: float, y: float) -> float:
    r2 = x * x + y * y
    coma = sqrt(8.0) * (3 * r2 - 2)
    path: float = (
        waves[0] * sqrt(3.0) * (2 * r2 - 1)
        + waves[1] * sqrt(6.0) * 2 * x * y
        + waves[2] * sqrt(6.0) * (x * x - y * y)
        + waves[3] * coma * y
        + waves[4] * coma * x
        + waves[5] * sqrt(5.0) * (6 * r2 * r2 - 6 * r2 + 1)
    )
    return path


@njit(cache=True)
def _mean_phasors(
    waves: NDArray[np.float64],
    frequency: NDArray[np.float64],
    bearing: NDArray[np.float64],
    nodes: NDArray[np.float64],
    weights: NDArray[np.float64],
) -> NDArray[np.complex128]:
    """Means over the common part of two unit pupils ``2 frequency`` apart, shape (f, bearing)."""
    made = np.empty((len(frequency), len(bearing)), dtype=np.complex128)
    for i in range(len(frequency)):
        s = min(frequency[i], 1 - 1e-9)
        for j in range(len(bearing)):
            c, d = np.cos(bearing[j]), np.sin(bearing[j])
            real, imaginary, area = 0.0, 0.0, 0.0
            for k in range(len(nodes)):
                v = sqrt(1 - s * s) * np.sin(pi / 2 * nodes[k])
                wide = sqrt(1 - v * v) - s
                row_weight = weights[k] * np.cos(pi / 2 * nodes[k]) * wide
                for m in range(len(nodes)):
                    u = wide * nodes[m]
                    ahead, behind = u + s, u - s
                    phase = (
                        2
                        * pi
                        * (
                            _path_waves(waves, ahead * c - v * d, ahead * d + v * c)
                            - _path_waves(waves, behind * c - v * d, behind * d + v * c)
                        )
                    )
                    weight = row_weight * weights[m]
                    real += weight * np.cos(phase)
                    imaginary += weight * np.sin(phase)
                    area += weight
            made[i, j] = complex(real / area, imaginary / area)
    return made


@njit(cache=True)
def _cubic(t: float, weight: NDArray[np.float64]) -> None:
    """Lagrange's weights of the points -1, 0, 1, 2 at ``t``."""
    weight[0] = -t * (t - 1) * (t - 2) / 6
    weight[1] = (t + 1) * (t - 1) * (t - 2) / 2
    weight[2] = -(t + 1) * t * (t - 2) / 2
    weight[3] = (t + 1) * t * (t - 1) / 6


@njit(cache=True)
def _read(
    table: PupilTable, relative_freq: NDArray[np.float64], bearing_rad: NDArray[np.float64]
) -> PupilTable:
    radii, bearings = table.shape
    made = np.empty(len(relative_freq), dtype=np.complex128)
    down, across = np.empty(4), np.empty(4)
    for i in range(len(relative_freq)):
        row = sqrt(max(1 - relative_freq[i], 0.0)) * (radii - 1)
        top = min(max(int(row), 1), radii - 3)
        _cubic(row - top, down)
        col = bearing_rad[i] / (2 * pi) * bearings
        left = int(np.floor(col))
        _cubic(col - left, across)
        total = 0j
        for j in range(4):
            for k in range(4):
                total += down[j] * across[k] * table[top - 1 + j, (left - 1 + k) % bearings]
        made[i] = total
    return made


PIXEL_PITCH_UM = 8.3
WAVELENGTH_UM = 0.55

LARGEST_FREQ_CY_PER_PX = 4.0
"""No lens of the benchmark passes more: f/4 ends at 3.77 cycles per pixel."""

NEGLIGIBLE_MTF = 1e-10
_SCAN_STEPS = 2000

FloatArray = NDArray[np.float64]


class Lens(Protocol):
    """An optical PSF that is the same all over the frame."""

    def __hash__(self) -> int:
        """Tables are kept by the lens."""
        ...

    def otf(
        self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray
    ) -> FloatArray | NDArray[np.complex128]:
        """Transfer function of the optics alone; the frequencies broadcast."""
        ...

    @property
    def band_cy_per_px(self) -> float:
        """Frequency beyond which the lens passes nothing that counts."""
        ...

    def facts(self) -> dict[str, Any]:
        """Return what the truth files say of the lens."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class GaussianLens:
    """A Gaussian PSF; ``angle_deg`` is that of the major axis, from +x towards +y."""

    sigma_major_px: float
    sigma_minor_px: float
    angle_deg: float = 0.0

    def otf(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """See `Lens.otf`."""
        c, s = cos(radians(self.angle_deg)), sin(radians(self.angle_deg))
        along = (c * fx_cy_per_px + s * fy_cy_per_px) * self.sigma_major_px
        across = (c * fy_cy_per_px - s * fx_cy_per_px) * self.sigma_minor_px
        return np.asarray(np.exp(-2 * pi**2 * (along * along + across * across)))

    @property
    def band_cy_per_px(self) -> float:
        """See `Lens.band_cy_per_px`."""
        end = sqrt(-np.log(NEGLIGIBLE_MTF) / (2 * pi**2)) / self.sigma_minor_px
        return float(min(end, LARGEST_FREQ_CY_PER_PX))

    def facts(self) -> dict[str, Any]:
        """See `Lens.facts`."""
        return {"kind": "gaussian", **asdict(self)}


@dataclass(frozen=True, slots=True, kw_only=True)
class CircularPupil:
    """A circular pupil, perfect or aberrated, at `WAVELENGTH_UM` on pixels of `PIXEL_PITCH_UM`."""

    f_number: float
    zernike_waves: tuple[float, ...] = (0.0,) * len(ZERNIKE_TERMS)  # rms, of `ZERNIKE_TERMS`

    @property
    def cut_off_cy_per_px(self) -> float:
        """Frequency at which the transfer function ends."""
        return PIXEL_PITCH_UM / (WAVELENGTH_UM * self.f_number)

    @property
    def band_cy_per_px(self) -> float:
        """See `Lens.band_cy_per_px`."""
        return self.cut_off_cy_per_px

    def otf(
        self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray
    ) -> FloatArray | NDArray[np.complex128]:
        """See `Lens.otf`."""
        radius = np.hypot(fx_cy_per_px, fy_cy_per_px) / self.cut_off_cy_per_px
        perfect = _diffraction_mtf(radius)
        if not any(self.zernike_waves):
            return perfect
        bearing = np.broadcast_to(np.arctan2(fy_cy_per_px, fx_cy_per_px), radius.shape)
        return np.asarray(perfect * _read_pupil_table(_table(self.zernike_waves), radius, bearing))

    def facts(self) -> dict[str, Any]:
        """See `Lens.facts`."""
        known = {
            "f_number": self.f_number,
            "wavelength_um": WAVELENGTH_UM,
            "pixel_pitch_um": PIXEL_PITCH_UM,
            "cut_off_cy_per_px": self.cut_off_cy_per_px,
        }
        if not any(self.zernike_waves):
            return {"kind": "diffraction", **known}
        waves = dict(zip(ZERNIKE_TERMS, self.zernike_waves, strict=True))
        return {"kind": "aberrated", **known, "zernike_waves_rms": waves}


@lru_cache(maxsize=8)
def _table(zernike_waves: tuple[float, ...]) -> PupilTable:
    return _pupil_table(zernike_waves)


def system_otf(
    lens: Lens, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray
) -> FloatArray | NDArray[np.complex128]:
    """Transfer function of lens and pixel; the frequencies broadcast."""
    pixel = np.sinc(fx_cy_per_px) * np.sinc(fy_cy_per_px)
    optics = lens.otf(fx_cy_per_px, fy_cy_per_px)
    optics *= pixel
    return optics


def contrast(lens: Lens, freq_cy_per_px: float, normal_deg: float) -> float:
    """MTF of the system along a direction, from +x towards +y."""
    c, s = cos(radians(normal_deg)), sin(radians(normal_deg))
    f = np.array([freq_cy_per_px])
    return float(np.abs(system_otf(lens, f * c, f * s))[0])


def falls_to(lens: Lens, level: float, normal_deg: float) -> float:
    """Lowest frequency, in cycles per pixel, at which the MTF along a direction is ``level``."""
    c, s = cos(radians(normal_deg)), sin(radians(normal_deg))
    f = np.linspace(0.0, lens.band_cy_per_px, _SCAN_STEPS + 1)
    below = np.abs(system_otf(lens, f * c, f * s)) < level
    first = int(np.argmax(below))
    if not below[first]:
        return inf
    found = brentq(
        lambda at: contrast(lens, at, normal_deg) - level, f[first - 1], f[first], xtol=1e-13
    )
    return float(found)


def round_lens(sigma_px: float) -> GaussianLens:
    """Lens with a round Gaussian PSF."""
    return GaussianLens(sigma_major_px=sigma_px, sigma_minor_px=sigma_px)


def aberrated(f_number: float, **waves: float) -> CircularPupil:
    """Lens with Zernike coefficients in waves rms by the names of `ZERNIKE_TERMS`."""
    return CircularPupil(
        f_number=f_number, zernike_waves=tuple(waves.get(term, 0.0) for term in ZERNIKE_TERMS)
    )


LENSES: tuple[Lens, ...] = (
    round_lens(0.6),
    CircularPupil(f_number=5.6),
    aberrated(5.6, defocus=0.12),
    GaussianLens(sigma_major_px=0.85, sigma_minor_px=0.55, angle_deg=30.0),
    CircularPupil(f_number=8.0),
    aberrated(4.0, spher=0.10, defocus=0.05),
    round_lens(0.8),
    CircularPupil(f_number=4.0),
    aberrated(5.6, coma1=0.07, coma2=0.06),
    GaussianLens(sigma_major_px=0.70, sigma_minor_px=0.50, angle_deg=120.0),
    CircularPupil(f_number=11.0),
    aberrated(4.0, astig1=0.08, astig2=0.10),
    round_lens(1.0),
    aberrated(8.0, defocus=0.15, astig2=0.07),
    GaussianLens(sigma_major_px=1.10, sigma_minor_px=0.75, angle_deg=75.0),
    aberrated(5.6, spher=0.08, coma1=0.05, astig1=0.05, defocus=-0.08),
)
"""Those of every track; each task takes one."""
