"""How far apart two colours are as they are seen, and whether that is colour or lightness.

References
----------
IEC 61966-2-1:1999, section 5.2: from linear sRGB to XYZ. CIE 142-2001 and G. Sharma, W. Wu and
E. N. Dalal, "The CIEDE2000 color-difference formula", Color Res. Appl. 30 (2005), 21-30.
"""

from dataclasses import dataclass
from typing import Final

import lazy_loader as lazy
import numpy as np

from acquisition.photographs.encoding import REC601_LUMA
from simulation.arrays import FloatArray

_skimage = lazy.load("skimage")

_TO_XYZ: Final = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)
_LEAST_SHARE: Final = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenDifference:
    """Of two colours, before and after.

    Parameters
    ----------
    delta_e
        CIEDE2000.
    is_of_colour
        Whether it is more of colour, at one luma, than of lightness.
    """

    delta_e: float
    is_of_colour: bool

    @classmethod
    def of(cls, before_rgb: FloatArray, after_rgb: FloatArray, white_dn: float) -> "SeenDifference":
        """Compare linear levels of red, green and blue, shape ``(3,)`` each."""
        before, after = (
            np.clip(one / white_dn, _LEAST_SHARE, None) for one in (before_rgb, after_rgb)
        )
        light = [float(one @ np.asarray(REC601_LUMA)) for one in (before, after)]
        seen, lit, own = (_lab(one) for one in (before, before * light[1] / light[0], after))
        grey = [_lab(np.full(3, one)) for one in light]
        return cls(
            delta_e=_delta_e(seen, own),
            is_of_colour=_delta_e(lit, own) > _delta_e(grey[0], grey[1]),
        )


def _lab(rgb: FloatArray) -> FloatArray:
    return np.asarray(_skimage.color.xyz2lab(_TO_XYZ @ rgb))


def _delta_e(one: FloatArray, other: FloatArray) -> float:
    return float(_skimage.color.deltaE_ciede2000(one, other))
