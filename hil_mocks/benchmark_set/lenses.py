"""Lenses of the benchmark: optical transfer functions in cycles per pixel, in closed form.

The system's transfer function is the lens's times that of the square pixel, which has unit fill.
"""

from dataclasses import asdict, dataclass
from functools import lru_cache
from math import cos, inf, pi, radians, sin, sqrt
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from hil_mocks.benchmark_set.pupil import (
    ZERNIKE_TERMS,
    PupilTable,
    diffraction_mtf,
    pupil_table,
    read_pupil_table,
)

PIXEL_PITCH_UM = 8.3
WAVELENGTH_UM = 0.55

LARGEST_FREQ_CY_PER_PX = 4.0
"""No lens of the benchmark passes more: f/4 ends at 3.77 cycles per pixel."""

NEGLIGIBLE_MTF = 1e-10
_SCAN_STEPS = 2000

FloatArray = NDArray[np.float64]


class Lens(Protocol):
    """An optical PSF that is the same all over the frame."""

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
    """A lens with a circular pupil, perfect or with Zernike aberrations, at one wavelength.

    Parameters
    ----------
    f_number
        At `WAVELENGTH_UM` and pixels of `PIXEL_PITCH_UM`.
    zernike_waves
        Coefficients of `ZERNIKE_TERMS` in waves rms, in their order; all 0 for a perfect lens.
    """

    f_number: float
    zernike_waves: tuple[float, ...] = (0.0,) * len(ZERNIKE_TERMS)

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
        perfect = diffraction_mtf(radius)
        if not any(self.zernike_waves):
            return perfect
        bearing = np.broadcast_to(np.arctan2(fy_cy_per_px, fx_cy_per_px), radius.shape)
        return np.asarray(
            perfect * read_pupil_table(_table(self.zernike_waves), radius, bearing)
        )

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
    return pupil_table(zernike_waves)


def system_otf(
    lens: Lens, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray
) -> FloatArray | NDArray[np.complex128]:
    """Transfer function of lens and pixel; the frequencies broadcast."""
    pixel = np.sinc(fx_cy_per_px) * np.sinc(fy_cy_per_px)
    return np.asarray(lens.otf(fx_cy_per_px, fy_cy_per_px) * pixel)


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
