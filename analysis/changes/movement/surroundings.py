"""A change among its surroundings, and how much it stands out from them."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.ndimage import distance_transform_edt

from analysis.changes.matching import Window
from simulation.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surroundings:
    """A part of the frame around a change.

    Parameters
    ----------
    crop
        The part; images of it have shape ``(rows, cols)``.
    inside, ring
        Pixels of the change, and of its surroundings.
    outside_px
        Distance of each pixel from the change.
    """

    crop: Window
    inside: BoolArray
    ring: BoolArray
    outside_px: FloatArray

    @classmethod
    def of(
        cls,
        rows: IntArray,
        cols: IntArray,
        valid: BoolArray,
        ring_px: tuple[float, float],
        margin_px: int,
    ) -> Self:
        """Cut a change out with a margin.

        Parameters
        ----------
        rows, cols
            Its pixels.
        valid
            Pixels of the frame that were compared.
        ring_px
            Distances from the change of its surroundings.
        margin_px
            How much is cut out around it.
        """
        top, left = max(int(rows.min()) - margin_px, 0), max(int(cols.min()) - margin_px, 0)
        bottom, right = int(rows.max()) + margin_px + 1, int(cols.max()) + margin_px + 1
        crop = slice(top, bottom), slice(left, right)
        inside = np.zeros(valid[crop].shape, dtype=np.bool_)
        inside[rows - top, cols - left] = True
        outside_px: FloatArray = distance_transform_edt(~inside)
        ring = (outside_px >= ring_px[0]) & (outside_px <= ring_px[1]) & valid[crop]
        return cls(crop=crop, inside=inside, ring=ring, outside_px=outside_px)

    @property
    def top(self) -> int:
        """First row of the part."""
        return int(self.crop[0].start)

    @property
    def left(self) -> int:
        """First column of the part."""
        return int(self.crop[1].start)

    def structure(self, side: FloatArray, least_dn2: float = 0.0) -> float:
        """Mean square in the change about the plane through its surroundings, over that of those.

        Parameters
        ----------
        side
            A photograph in this part.
        least_dn2
            What the surroundings have at least, by noise.
        """
        y, x = np.nonzero(self.ring)
        if len(y) < 3:
            return 0.0
        terms = np.stack([np.ones(len(y)), y, x], axis=1)
        plane, *_ = np.linalg.lstsq(terms, side[self.ring], rcond=None)
        around = float(np.mean((side[self.ring] - terms @ plane) ** 2))
        own_y, own_x = np.nonzero(self.inside)
        within = side[self.inside] - (plane[0] + plane[1] * own_y + plane[2] * own_x)
        least = max(around, least_dn2, float(np.finfo(np.float32).tiny))
        return float(np.mean(within**2)) / least
