"""From light to digital numbers: shot noise, read noise, full well, gain and A/D converter."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PIXEL_FORMATS = ("Mono8", "Mono12", "Mono12Packed")
"""Formats that the simulated camera delivers, unpacked as by a driver."""

ADC_MAX_DN = 4095
"""Largest level of the 12-bit converter."""

MONO8_SHIFT = 4
"""Mono8 is the upper 8 of the 12 bits, truncated and not rounded, as in GigE cameras."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """A sensor by the linear model of EMVA 1288: electrons, then noise, then digital numbers.

    Parameters
    ----------
    white_e_per_us
        Electrons per pixel and microsecond from white paper, before vignetting.
    gain_e_per_dn
        Conversion at 0 dB, for DN at 12 bits.
    read_noise_e
        Standard deviation of the dark noise, excluding the rounding of the converter.
    full_well_e
        Electrons at which a pixel is full.
    black_level_dn
        Offset, in DN at 12 bits, the same at every gain.

    References
    ----------
    EMVA Standard 1288, release 4.0 linear, 2021, section 2.
    """

    white_e_per_us: float
    gain_e_per_dn: float
    read_noise_e: float
    full_well_e: float
    black_level_dn: float

    def gain_at_e_per_dn(self, gain_db: float) -> float:
        """Electrons per 12-bit DN at a gain: 20 dB make the signal ten times larger."""
        return float(self.gain_e_per_dn / 10 ** (gain_db / 20))

    def electrons(self, irradiance: NDArray[np.float32], exposure_us: float) -> NDArray[np.float32]:
        """Expected electrons for light relative to white paper; negative light counts as 0."""
        return np.maximum(irradiance, 0) * np.float32(self.white_e_per_us * exposure_us)

    def expected_dn(
        self, irradiance: NDArray[np.float32], exposure_us: float, gain_db: float, pixel_format: str
    ) -> NDArray[np.float64]:
        """Mean level without noise and rounding, clipped as by the converter.

        In Mono8 the mean loss by truncation, 7.5 / 16, is subtracted.
        """
        electrons = np.minimum(self.electrons(irradiance, exposure_us), self.full_well_e)
        gain = self.gain_at_e_per_dn(gain_db)
        level_dn = np.minimum(self.black_level_dn + electrons.astype(np.float64) / gain, ADC_MAX_DN)
        if pixel_format == "Mono8":
            step = 2**MONO8_SHIFT
            level_dn = (level_dn - (step - 1) / 2) / step
        return np.asarray(level_dn)

    def variance_dn2(self, level_dn: float, gain_db: float) -> float:
        """Temporal variance of a 12-bit level below saturation, rounding (1/12) included."""
        gain = self.gain_at_e_per_dn(gain_db)
        return (level_dn - self.black_level_dn) / gain + (self.read_noise_e / gain) ** 2 + 1 / 12

    def expose(
        self,
        electrons: NDArray[np.float32] | NDArray[np.float64],
        gain_db: float,
        pixel_format: str,
        rng: np.random.Generator,
    ) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """One frame in DN of the pixel format, for the expected electrons of each pixel."""
        collected = rng.poisson(electrons).astype(np.float32)
        np.minimum(collected, np.float32(self.full_well_e), out=collected)
        if self.read_noise_e > 0:
            dark = rng.standard_normal(electrons.shape, dtype=np.float32)
            dark *= np.float32(self.read_noise_e)
            collected += dark
        collected *= np.float32(1 / self.gain_at_e_per_dn(gain_db))
        collected += np.float32(self.black_level_dn)
        np.rint(collected, out=collected)
        np.clip(collected, 0, ADC_MAX_DN, out=collected)
        level_dn = collected.astype(np.uint16)
        if pixel_format == "Mono8":
            return (level_dn >> MONO8_SHIFT).astype(np.uint8)
        return level_dn
