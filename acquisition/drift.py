"""How two captures of one pose differ: what lamp, camera and stage drifted by in between."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Drift", "drift_between"]

LEVEL_LIMIT = 0.01
SHIFT_LIMIT_PX = 0.1
RANK_LIMIT = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Drift:
    """Change of light, relative, and shift of the picture, in px (x to the right, y down)."""

    level: float
    shift_x_px: float
    shift_y_px: float

    @property
    def is_notable(self) -> bool:
        """Whether it is more than 1 % of light or a tenth of a pixel."""
        return abs(self.level) > LEVEL_LIMIT or self.shift_px > SHIFT_LIMIT_PX

    @property
    def shift_px(self) -> float:
        """Length of the shift."""
        return float(np.hypot(self.shift_x_px, self.shift_y_px))

    @property
    def text(self) -> str:
        """The drift in a sentence."""
        advice = "; let lamp and camera warm up and capture again" if self.is_notable else ""
        return (
            f"since the first capture the light changed by {100 * self.level:+.2f} %, the picture "
            f"moved by {self.shift_px:.2f} px{advice}"
        )


def drift_between(
    first_dn: NDArray[np.floating], last_dn: NDArray[np.floating], *, black_level_dn: float
) -> Drift:
    """Measure the drift from one mean image to another of the same pose.

    The shift is the least-squares solution of ``last = first - g . d`` after the change of light
    is taken out: right for shifts below a pixel, too small beyond. Along a straight edge nothing
    can be seen to move; there the shift is that across it.

    Raises
    ------
    ValueError
        If the shapes differ.
    """
    if first_dn.shape != last_dn.shape:
        raise ValueError(f"images of {first_dn.shape} and {last_dn.shape} are not of one pose")
    first = np.asarray(first_dn, dtype=np.float64) - black_level_dn
    last = np.asarray(last_dn, dtype=np.float64) - black_level_dn
    energy = float(np.vdot(first, first))
    ratio = float(np.vdot(first, last)) / energy if energy > 0 else 1.0
    down, across = np.gradient((first + last / ratio if ratio > 0 else 2 * first) / 2)
    change = (last / ratio if ratio > 0 else last) - first
    normal = np.array(
        [[np.vdot(across, across), np.vdot(across, down)], [0.0, np.vdot(down, down)]]
    )
    normal[1, 0] = normal[0, 1]
    right = -np.array([np.vdot(across, change), np.vdot(down, change)])
    shift = np.linalg.pinv(normal, rcond=RANK_LIMIT, hermitian=True) @ right
    return Drift(level=ratio - 1.0, shift_x_px=float(shift[0]), shift_y_px=float(shift[1]))
