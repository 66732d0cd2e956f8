"""From light on pixels to levels in files: exposure, noise, clipping, sRGB and JPEG."""

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from hil_mocks.scene import ADC_MAX_DN, Sensor

FloatArray = NDArray[np.float64]

BLACK_LEVEL_DN = 64.0
WHITE_DN = 3400.0
"""Levels above black of white at an exposure of 1."""

STEPS_PER_DN = 16
"""Of the noise-free levels in truth files."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition:
    """How a photograph is exposed and stored.

    Parameters
    ----------
    name
        As the truth names it.
    gain_e_per_dn, read_noise_e
        Of the sensor; a gain of None stands for no noise but that of rounding.
    exposure
        1 brings white to `WHITE_DN` above black; much more fills the wells of bright pixels.
    jpeg_quality
        8-bit JPEG, sRGB encoded; None for linear TIFF of 12 bits.
    """

    name: str
    gain_e_per_dn: float | None = 4.0
    read_noise_e: float = 12.0
    exposure: float = 1.0
    jpeg_quality: int | None = None

    @property
    def suffix(self) -> str:
        """Of the photographs' files."""
        return ".tif" if self.jpeg_quality is None else ".jpg"

    def facts(self) -> dict[str, Any]:
        """Return what a task says of levels and noise."""
        gain = self.gain_e_per_dn
        noise = {
            "variance_at_black_dn2": 1 / 12 + (0 if gain is None else (self.read_noise_e / gain) ** 2),
            "variance_per_dn": 0.0 if gain is None else 1 / gain,
        }
        if self.jpeg_quality is None:
            levels = {"encoding": "linear", "max_level": ADC_MAX_DN, "black_level": BLACK_LEVEL_DN}
        else:
            levels = {
                "encoding": "srgb",
                "max_level": 255,
                "black_level": 0.0,
                "jpeg_quality": self.jpeg_quality,
            }
        return {**levels, "noise": noise}

    def variance_dn2(self, level_dn: float) -> float:
        """Variance of a level of the linear scale."""
        noise = self.facts()["noise"]
        above = level_dn - BLACK_LEVEL_DN
        return float(noise["variance_at_black_dn2"] + noise["variance_per_dn"] * above)

    def expected_dn(self, light: FloatArray) -> FloatArray:
        """Noise-free level of the linear scale, clipped as by the sensor."""
        level = BLACK_LEVEL_DN + np.maximum(light, 0.0) * (WHITE_DN * self.exposure)
        return np.minimum(level, float(ADC_MAX_DN))

    def levels(self, light: FloatArray, rng: np.random.Generator) -> NDArray[np.uint16]:
        """Levels of 12 bits, with noise."""
        if self.gain_e_per_dn is None:
            return np.rint(self.expected_dn(light)).astype(np.uint16)
        sensor = Sensor(
            white_e_per_us=1.0,
            gain_e_per_dn=self.gain_e_per_dn,
            read_noise_e=self.read_noise_e,
            full_well_e=self.gain_e_per_dn * ADC_MAX_DN,
            black_level_dn=BLACK_LEVEL_DN,
        )
        electrons = np.maximum(light, 0.0) * (WHITE_DN * self.exposure * self.gain_e_per_dn)
        return sensor.expose(electrons, 0.0, "Mono12", rng).astype(np.uint16)

    def stored(self, light: FloatArray, rng: np.random.Generator) -> bytes:
        """Photograph as a file."""
        levels = self.levels(light, rng)
        if self.jpeg_quality is None:
            return tiff_bytes(levels)
        file = BytesIO()
        Image.fromarray(srgb_levels(levels)).save(file, "JPEG", quality=self.jpeg_quality)
        return file.getvalue()


def srgb_levels(levels_dn: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """8-bit levels of linear ones: black to 0, the largest level to 255.

    References
    ----------
    IEC 61966-2-1:1999, section 5.2.
    """
    scale = np.arange(ADC_MAX_DN + 1.0)
    linear = np.clip((scale - BLACK_LEVEL_DN) / (ADC_MAX_DN - BLACK_LEVEL_DN), 0.0, 1.0)
    curve = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * curve).astype(np.uint8)[levels_dn])


def truth_tiff(levels_dn: FloatArray, dtype: type[np.uint16] | type[np.int16]) -> bytes:
    """Noise-free levels, or their differences, in steps of 1/16 DN."""
    return tiff_bytes(np.rint(levels_dn * STEPS_PER_DN).astype(dtype))


def tiff_bytes(levels: NDArray[Any]) -> bytes:
    """Uncompressed grey TIFF that holds nothing but the levels."""
    file = BytesIO()
    tifffile.imwrite(file, levels, photometric="minisblack", metadata=None, software=False)
    return file.getvalue()
