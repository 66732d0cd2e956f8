"""A smooth displacement of a photograph's pixels, for scenes that are not quite planar."""

from dataclasses import dataclass, field
from typing import Literal, Self

import numpy as np
from scipy.ndimage import map_coordinates

from simulation.arrays import FloatArray

_INVERSE_ROUNDS = 30
_INVERSE_TOLERANCE_PX = 1e-9


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SmoothDisplacement:
    """A uniform cubic B-spline over one of two photographs.

    Parameters
    ----------
    knots_px
        Shape (2, n, m), at least 4 x 4: coefficients of the displacement along y and x.
    shape
        ``(rows, cols)`` of the photograph.
    photograph
        Whose pixels are displaced.
    """

    knots_px: FloatArray = field(repr=False)
    shape: tuple[int, int]
    photograph: Literal["reference", "followup"]

    def displaced(self, y_px: FloatArray, x_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where pixels at ``(y, x)`` would lie if the scene were planar, in the same shape."""
        moved_y, moved_x = self._at(y_px, x_px)
        return y_px + moved_y, x_px + moved_x

    def restored(self, y_px: FloatArray, x_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Inverse of ``displaced``, by fixed-point iteration: the displacement varies slowly."""
        y, x = y_px, x_px
        for _ in range(_INVERSE_ROUNDS):
            moved_y, moved_x = self._at(y, x)
            last_y, last_x = y, x
            y, x = y_px - moved_y, x_px - moved_x
            if max(_largest(y - last_y), _largest(x - last_x)) < _INVERSE_TOLERANCE_PX:
                break
        return y, x

    def swapped(self) -> Self:
        """Return the same displacement where the two photographs have changed roles."""
        return type(self)(
            knots_px=self.knots_px,
            shape=self.shape,
            photograph="followup" if self.photograph == "reference" else "reference",
        )

    def mirrored(self) -> Self:
        """Return the displacement of the photograph with its columns reversed."""
        signs = np.array([1.0, -1.0])[:, None, None]
        return type(self)(
            knots_px=self.knots_px[..., ::-1] * signs, shape=self.shape, photograph=self.photograph
        )

    def _at(self, y_px: FloatArray, x_px: FloatArray) -> FloatArray:
        """Displacement along y and x; constant beyond the frame."""
        places = [
            1 + np.clip((along + 0.5) / size, 0.0, 1.0) * (count - 3)
            for along, size, count in zip(
                (y_px, x_px), self.shape, self.knots_px.shape[1:], strict=True
            )
        ]
        return np.stack(
            [
                map_coordinates(knots, places, order=3, mode="nearest", prefilter=False)
                for knots in self.knots_px
            ]
        )


def _largest(values: FloatArray) -> float:
    return float(np.abs(values).max(initial=0.0))
