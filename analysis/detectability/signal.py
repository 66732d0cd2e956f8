"""The change to detect: a Gaussian spot or a patch of an image, on the grid of c, contrast 1."""

from dataclasses import dataclass
from math import ceil
from typing import Protocol

import numpy as np

from simulation.arguments import check_fields
from simulation.arrays import FloatArray
from simulation.by_value import ByValue

_REACH_SIGMAS = 6.0
_PLASTIC = 1.324717957244746
"""Root of x^3 = x + 1, for the points of M. Roberts' R2 sequence, 2018."""


class ChangeSignal(Protocol):
    """A change of the scene, known exactly."""

    @property
    def reach_px(self) -> float:
        """Distance from its centre beyond which it is negligible, in px of c."""
        ...

    @property
    def sigma_px(self) -> float | None:
        """Width in px of c, None where it has no such width."""
        ...

    @property
    def name(self) -> str:
        """What kind of signal it is."""
        ...

    def image(self, side_px: int, offset_px: tuple[int, int]) -> FloatArray:
        """Signal of contrast 1 in a square image, offset ``(y, x)`` from its middle pixel."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class GaussianSignal:
    """A Gaussian spot of peak 1: ``exp(-r^2 / (2 sigma^2))``.

    Raises
    ------
    ArgumentError
        If the width is not positive.
    """

    sigma_px: float = 2.0

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def reach_px(self) -> float:
        """Distance from its centre beyond which it is negligible, in px of c."""
        return float(_REACH_SIGMAS * self.sigma_px)

    @property
    def name(self) -> str:
        """What kind of signal it is."""
        return "gaussian"

    def image(self, side_px: int, offset_px: tuple[int, int]) -> FloatArray:
        """Signal of contrast 1 in a square image, offset ``(y, x)`` from its middle pixel."""
        position = np.arange(side_px) - side_px // 2
        along_y, along_x = (
            np.exp(-0.5 * ((position - offset) / self.sigma_px) ** 2) for offset in offset_px
        )
        return np.asarray(np.outer(along_y, along_x))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PatchSignal(ByValue):
    """A patch of an image: its levels above its border's median, largest deviation 1.

    Raises
    ------
    ValueError
        If the patch is not a grey image, not finite or constant.
    """

    levels_dn: FloatArray

    def __post_init__(self) -> None:
        levels = np.asarray(self.levels_dn, dtype=np.float64)
        if levels.ndim != 2 or min(levels.shape) < 3 or not np.all(np.isfinite(levels)):
            raise ValueError("a signal patch must be a grey image of at least 3 x 3 finite pixels")
        border = np.concatenate([levels[0], levels[-1], levels[1:-1, 0], levels[1:-1, -1]])
        levels = levels - np.median(border)
        peak = float(np.abs(levels).max())
        if peak == 0:
            raise ValueError("a constant patch contains no signal")
        object.__setattr__(self, "levels_dn", levels / peak)

    @property
    def reach_px(self) -> float:
        """Distance from its centre beyond which it is negligible, in px of c."""
        return float(ceil(max(self.levels_dn.shape) / 2) + 1)

    @property
    def sigma_px(self) -> float | None:
        """None: a patch has no such width."""
        return None

    @property
    def name(self) -> str:
        """What kind of signal it is."""
        return "patch"

    def image(self, side_px: int, offset_px: tuple[int, int]) -> FloatArray:
        """Signal of contrast 1 in a square image, offset ``(y, x)`` from its middle pixel."""
        rows, cols = self.levels_dn.shape
        top = side_px // 2 + offset_px[0] - rows // 2
        left = side_px // 2 + offset_px[1] - cols // 2
        scene = np.zeros((side_px, side_px))
        scene[top : top + rows, left : left + cols] = self.levels_dn
        return scene


def signal_offsets_px(count: int, period_px: float) -> tuple[tuple[int, int], ...]:
    """Positions of the signal on the pixel grids, ``(y, x)`` in whole px of c, evenly spread.

    Parameters
    ----------
    count
        How many, at least 1.
    period_px
        Spacing of the coarser grid; the positions cover several of its periods.
    """
    span = 8 * ceil(period_px)
    index = np.arange(1, count + 1)
    positions = np.stack([index / _PLASTIC, index / _PLASTIC**2], axis=1) % 1.0
    offsets = np.floor(positions * span).astype(np.int64) - span // 2
    return tuple((int(y), int(x)) for y, x in offsets)
