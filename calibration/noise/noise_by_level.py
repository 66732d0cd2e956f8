"""Noise of a pixel at a given level, from which the edge fit takes its weights."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulation.arrays import FloatArray
from simulation.capture_noise import CaptureNoise

_BINS = 64
_ROUNDS = 4
_QUANTISATION_DN2 = 1.0 / 12.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelNoise:
    """Variance of one pixel value: read noise plus shot noise growing with the level.

    ``variance = offset_dn2 + slope_dn * level``, never below ``floor_dn2``
    (EMVA 1288 release 4.0, section 2.4: the photon transfer line).
    """

    offset_dn2: float
    slope_dn: float
    floor_dn2: float

    def __post_init__(self) -> None:
        if not self.floor_dn2 > 0:
            raise ValueError(f"floor_dn2 must be positive, got {self.floor_dn2}")

    def variance_dn2(self, level_dn: FloatArray) -> FloatArray:
        """Variance at each level, in DN^2."""
        return np.maximum(self.offset_dn2 + self.slope_dn * level_dn, self.floor_dn2)

    def averaged(self, frames: int) -> "LevelNoise":
        """The noise of a mean over ``frames`` frames."""
        return LevelNoise(
            offset_dn2=self.offset_dn2 / frames,
            slope_dn=self.slope_dn / frames,
            floor_dn2=self.floor_dn2 / frames,
        )


def level_noise(noise: CaptureNoise) -> LevelNoise:
    """Return the noise of a single frame, including rounding, from a camera's noise.json.

    Parameters
    ----------
    noise
        As ``read_noise`` gives it; its number of frames does not matter here.
    """
    dark_dn2 = (noise.read_noise_e / noise.gain_e_per_dn) ** 2 + _QUANTISATION_DN2
    slope_dn = 1.0 / noise.gain_e_per_dn
    return LevelNoise(
        offset_dn2=dark_dn2 - slope_dn * noise.black_level_dn,
        slope_dn=slope_dn,
        floor_dn2=dark_dn2,
    )


def fit_level_noise(
    mean_dn: NDArray[np.floating], variance_dn2: NDArray[np.floating], saturation_dn: float
) -> LevelNoise:
    """Fit the photon transfer line to the temporal variance of single frames.

    Parameters
    ----------
    mean_dn, variance_dn2
        Mean and unbiased temporal variance of each pixel; any shape, the same for both.
    saturation_dn
        Pixels whose mean is above 98 % of this level are left out: their variance is clipped.

    Raises
    ------
    ValueError
        If fewer than 100 pixels are left.
    """
    mean = np.asarray(mean_dn, dtype=np.float64).ravel()
    variance = np.asarray(variance_dn2, dtype=np.float64).ravel()
    kept = mean < 0.98 * saturation_dn
    mean, variance = mean[kept], variance[kept]
    if mean.size < 100:
        raise ValueError(f"the noise line needs 100 unsaturated pixels, got {mean.size}")
    edges = np.linspace(mean.min(), mean.max() * (1 + 1e-12) + 1e-12, _BINS + 1)
    index = np.clip(np.searchsorted(edges, mean, side="right") - 1, 0, _BINS - 1)
    count = np.bincount(index, minlength=_BINS)
    used = count > 0
    level = np.bincount(index, mean, minlength=_BINS)[used] / count[used]
    spread = np.bincount(index, variance, minlength=_BINS)[used] / count[used]
    count = count[used]
    # The scatter of a mean variance is proportional to it: weight by the fitted line.
    floor = max(1e-3 * float(np.mean(variance)), 1e-12)
    fitted = np.full(level.size, max(float(np.mean(variance)), floor))
    offset, slope = float(np.mean(variance)), 0.0
    for _ in range(_ROUNDS):
        weight = count / fitted**2
        centre = np.average(level, weights=weight)
        moment = np.sum(weight * (level - centre) ** 2)
        if moment > 0:
            slope = float(np.sum(weight * (level - centre) * spread) / moment)
        offset = float(np.average(spread, weights=weight) - slope * centre)
        fitted = np.maximum(offset + slope * level, floor)
    return LevelNoise(offset_dn2=offset, slope_dn=slope, floor_dn2=floor)
