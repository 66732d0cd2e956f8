"""Dark, flat and defect maps of a sensor, and the correction of captures with them."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.robust import robust_sigma
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatArray, FloatImage
from simulation.by_value import ByValue

DARK_DEFECT, RESPONSE_DEFECT, NOISE_DEFECT = 1, 2, 4
"""Bits of the defect map: wrong dark level, wrong response, too noisy."""

_SIGMAS = 6.0  # of 450 000 good pixels, 0.001 are beyond it
_LEAST_RESPONSE = 0.05
_NOISE_RATIO = 3.0
_MEDIAN_PX = 5
_SHADING_SIGMA_PX = 12.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CorrectionMaps(ByValue):
    """Maps of one sensor, shape ``(rows, cols)``.

    ``dark_dn`` is the level without light, ``response`` the sensitivity relative to the mean
    over the sensor (shading included), ``defects`` is 0 for good pixels, otherwise the bits
    `DARK_DEFECT`, `RESPONSE_DEFECT` and `NOISE_DEFECT`.
    """

    dark_dn: Float32Array
    response: Float32Array
    defects: NDArray[np.uint8]
    black_level_dn: float

    def __post_init__(self) -> None:
        if not self.dark_dn.shape == self.response.shape == self.defects.shape:
            raise ValueError(
                "the maps must have one shape, got "
                f"{self.dark_dn.shape}, {self.response.shape}, {self.defects.shape}"
            )

    @property
    def is_defect(self) -> BoolArray:
        """The pixels that must not be used."""
        return self.defects > 0

    def correct(self, image_dn: AnyArray) -> FloatArray:
        """Return the image without fixed pattern, shading and defects; the black level is kept.

        ``(image - dark) / response + black``; a defect becomes the mean of its good neighbours.

        Raises
        ------
        ValueError
            If the image does not have the maps' shape.
        """
        self._require_shape(image_dn)
        light = (image_dn.astype(np.float64) - self.dark_dn) / self._divisor()
        return _filled(light, self.is_defect) + self.black_level_dn

    def correct_variance(self, variance_dn2: FloatImage) -> FloatArray:
        """Return the temporal variance of an image after ``correct``.

        Raises
        ------
        ValueError
            If the image does not have the maps' shape.
        """
        self._require_shape(variance_dn2)
        return _filled(variance_dn2.astype(np.float64) / self._divisor() ** 2, self.is_defect)

    def _divisor(self) -> FloatArray:
        return np.where(self.is_defect, 1.0, self.response).astype(np.float64)

    def _require_shape(self, image: AnyArray) -> None:
        if image.shape != self.dark_dn.shape:
            raise ValueError(
                f"an image of {image.shape} (rows, cols) does not match maps of "
                f"{self.dark_dn.shape}; use those of the same camera and region"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Nonuniformity:
    """How much the pixels differ, without temporal noise.

    ``dsnu_dn`` and ``prnu`` are standard deviations between pixels after large-scale structure was
    removed; ``shading`` is the range of what was removed, relative to its mean.
    """

    dsnu_dn: float
    prnu: float
    shading: float
    defects: int


def correction_maps(
    dark_dn: FloatImage,
    response: FloatImage,
    *,
    dark_noise_dn: float,
    variance_ratio: FloatImage,
    black_level_dn: float,
) -> CorrectionMaps:
    """Make the maps, and find the defects on them.

    A pixel is a defect if it differs from the median of its surroundings by six robust standard
    deviations of all pixels and by one frame's read noise in the dark or 5 % in its response, or if
    its temporal variance is three times that expected at its level and six standard deviations of
    that ratio above it.

    Parameters
    ----------
    dark_dn, response
        See `CorrectionMaps`.
    dark_noise_dn
        Standard deviation of one dark frame.
    variance_ratio
        Temporal variance of each pixel over that expected at its level, averaged over captures.
    """
    defects = np.zeros(dark_dn.shape, dtype=np.uint8)
    defects[_stands_out(dark_dn, dark_noise_dn)] |= DARK_DEFECT
    defects[_stands_out(response, _LEAST_RESPONSE) | (response <= 0)] |= RESPONSE_DEFECT
    spread = robust_sigma(variance_ratio - np.median(variance_ratio))
    noisy = variance_ratio > max(_NOISE_RATIO, 1.0 + _SIGMAS * spread)
    defects[noisy] |= NOISE_DEFECT
    return CorrectionMaps(
        dark_dn=dark_dn.astype(np.float32),
        response=response.astype(np.float32),
        defects=defects,
        black_level_dn=black_level_dn,
    )


def nonuniformity(
    maps: CorrectionMaps, *, dark_variance_dn2: float, response_variance: float
) -> Nonuniformity:
    """Measure DSNU, PRNU and shading on the maps.

    Parameters
    ----------
    maps
        Defects are left out.
    dark_variance_dn2, response_variance
        Temporal noise left in the maps; it is subtracted.

    References
    ----------
    EMVA Standard 1288, release 4.0 linear, 2021, section 8: variances after high-pass filtering.
    """
    sound = ~maps.is_defect
    from scipy.ndimage import gaussian_filter  # a quarter of a second, where maps are measured

    smooth = gaussian_filter(_filled(maps.response.astype(np.float64), maps.is_defect),
                             _SHADING_SIGMA_PX, mode="nearest")  # fmt: skip
    level = gaussian_filter(_filled(maps.dark_dn.astype(np.float64), maps.is_defect),
                            _SHADING_SIGMA_PX, mode="nearest")  # fmt: skip
    dark = float(np.var((maps.dark_dn - level)[sound])) - dark_variance_dn2
    response = float(np.var((maps.response / smooth)[sound])) - response_variance
    return Nonuniformity(
        dsnu_dn=float(np.sqrt(max(dark, 0.0))),
        prnu=float(np.sqrt(max(response, 0.0))),
        shading=float(np.ptp(smooth) / smooth.mean()),
        defects=int(np.count_nonzero(maps.defects)),
    )


def _stands_out(image: FloatImage, least: float) -> BoolArray:
    plane = np.ascontiguousarray(image, dtype=np.float32)
    left = plane - cv2.medianBlur(plane, _MEDIAN_PX)
    # The median absolute difference from a median of few values is a little too small.
    limit = max(_SIGMAS * robust_sigma(left), least)
    return np.asarray(np.abs(left) > limit)


def _filled(image: FloatArray, hole: BoolArray) -> FloatArray:
    """The image with holes filled from their rims inwards with the mean of known neighbours."""
    if not hole.any() or hole.all():
        return image
    filled = np.where(hole, 0.0, image)
    known = (~hole).astype(np.float64)
    while not known.all():
        total = cv2.boxFilter(filled * known, -1, (3, 3), normalize=False)
        count = cv2.boxFilter(known, -1, (3, 3), normalize=False)
        rim = (known == 0) & (count > 0.5)
        filled[rim] = total[rim] / count[rim]
        known[rim] = 1.0
    return filled
