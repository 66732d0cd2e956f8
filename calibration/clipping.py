"""Where the pixels of a camera clip, from the variance that vanishes there."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.photon_transfer import Saturation

__all__ = ["VarianceByLevel"]

_BINS = 512
_FEWEST_IN_BIN = 30
_COLLAPSED = 0.3  # of the largest variance: read noise alone, or none


class VarianceByLevel:
    """Temporal variance of pixels by their mean level, summed over flats.

    Working by pixel and not by capture, uneven light does not smear the level at which pixels
    clip.

    Parameters
    ----------
    max_level_dn
        Largest level the pixel format holds.

    References
    ----------
    EMVA Standard 1288, release 4.0 linear, 2021, section 6.6: saturation is where the variance
    has its maximum. Pixels beyond it, whose variance has collapsed, show the level they clip at.
    """

    def __init__(self, max_level_dn: float) -> None:
        self._max_level_dn = max_level_dn
        self._count = np.zeros(_BINS)
        self._level = np.zeros(_BINS)
        self._square = np.zeros(_BINS)
        self._variance = np.zeros(_BINS)

    def add(
        self, mean_dn: NDArray[np.floating[Any]], variance_dn2: NDArray[np.floating[Any]]
    ) -> None:
        """Take the pixels of one flat in."""
        mean = np.asarray(mean_dn, dtype=np.float64).ravel()
        place = np.clip((mean * (_BINS / (self._max_level_dn + 1))).astype(np.intp), 0, _BINS - 1)
        self._count += np.bincount(place, minlength=_BINS)
        self._level += np.bincount(place, mean, minlength=_BINS)
        self._square += np.bincount(place, mean**2, minlength=_BINS)
        self._variance += np.bincount(
            place, np.asarray(variance_dn2, dtype=np.float64).ravel(), minlength=_BINS
        )

    def saturation(self) -> Saturation:
        """The level at which pixels clip: where most of those lie whose variance collapsed."""
        unseen = Saturation(level_dn=self._max_level_dn, err_dn=None)
        used = self._count >= _FEWEST_IN_BIN
        if not used.any():
            return unseen
        variance = np.where(used, self._variance / np.maximum(self._count, 1), 0.0)
        peak = int(np.argmax(variance))
        beyond = np.arange(_BINS) > peak
        collapsed = used & beyond & (variance < _COLLAPSED * variance[peak])
        if not collapsed.any():
            return unseen
        top = int(np.argmax(np.where(collapsed, self._count, 0.0)))
        count = self._count[top]
        level = self._level[top] / count
        spread = max(self._square[top] / count - level**2, 0.0)
        return Saturation(level_dn=float(level), err_dn=float(np.sqrt(1 / 12 + spread / count)))
