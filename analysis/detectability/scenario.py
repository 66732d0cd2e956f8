"""How the two images of a comparison are formed."""

from dataclasses import dataclass

import numpy as np

from analysis.choices import REFERENCE_ZOOM, WINDOW_PX
from simulation import Psf

POSITIONS = 6
"""Positions of the signal against the pixel grids; d' over them scatters by 2 % at most."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """How the two images are formed and the window in which they are compared.

    Parameters
    ----------
    psf
        Total PSF of c; ``bicubic`` needs none.
    reference_zoom
        From c to the reference c'.
    window_px
        Side of the observer's window on c', odd.
    positions
        Of the signal against the pixel grids, over which d' is averaged.

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    psf: Psf | None
    reference_zoom: float = REFERENCE_ZOOM
    window_px: int = WINDOW_PX
    positions: int = POSITIONS

    def __post_init__(self) -> None:
        if not (self.reference_zoom >= 1 and np.isfinite(self.reference_zoom)):
            raise ValueError(f"reference_zoom must be at least 1, got {self.reference_zoom}")
        if self.window_px % 2 == 0 or self.window_px < 5:
            raise ValueError(f"window_px must be odd and at least 5, got {self.window_px}")
        if self.positions < 1:
            raise ValueError(f"positions must be at least 1, got {self.positions}")
