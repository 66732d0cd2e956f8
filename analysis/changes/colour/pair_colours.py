"""The colours of two photographs, and what is known of their channels."""

from dataclasses import dataclass, field

import numpy as np

from acquisition.photographs.encoding import REC601_LUMA
from simulation.arrays import AnyArray, Float32Array, FloatArray

Steps = tuple[Float32Array | None, Float32Array | None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairColours:
    """Reference and follow-up in colour, shape ``(rows, cols, 3)`` each, linear in light.

    Parameters
    ----------
    reference_dn, followup_dn
        Red, green and blue.
    step_variance_dn2
        Variance of each level by the steps of the files, shape ``(rows, cols, 3)``, where known.
    step_dn
        Steps of the levels of reference and follow-up, likewise.
    white_dn
        Level of white of both, for differences as they are seen; None where a file does not say it.
    """

    reference_dn: AnyArray = field(repr=False)
    followup_dn: AnyArray = field(repr=False)
    step_variance_dn2: Steps = field(default=(None, None), repr=False)
    step_dn: Steps = field(default=(None, None), repr=False)
    white_dn: tuple[float | None, float | None] = (None, None)


def to_rgb(luma_red_blue: FloatArray) -> FloatArray:
    """Red, green and blue, shape ``(3, ...)``, of luma, red and blue."""
    luma, red, blue = luma_red_blue
    of_red, of_green, of_blue = REC601_LUMA
    return np.stack([red, (luma - of_red * red - of_blue * blue) / of_green, blue])


def to_luma_red_blue(rgb: FloatArray) -> FloatArray:
    """Luma, red and blue, shape ``(3, ...)``, of red, green and blue."""
    red, _, blue = rgb
    return np.stack([np.tensordot(np.asarray(REC601_LUMA), rgb, axes=1), red, blue])
