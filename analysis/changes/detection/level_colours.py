"""Luma and chroma behind one width, made independent of one another."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi
from typing import Self

import numpy as np

from analysis.changes.colour import to_channels, to_luma_red_blue, to_rgb
from analysis.changes.detection.joint_significance import PLANES, as_significance
from analysis.changes.matching import sampled
from simulation.arrays import BoolArray, Float32Array, FloatArray, FloatImage

_SAMPLE_PX = 50_000
_CLIP_SD = 3.0
_ROUNDS = 2
_PRIOR_VALUES = 100.0
"""Independent values that a correlation of none is worth: the planes were made so at first, and a
frame has few of a wide filter."""

Place = tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LevelColours:
    """Luma and the two planes of chroma at the places of a level, shape ``(3, rows, cols)`` each.

    Parameters
    ----------
    difference_dn, sd_dn
        Of the planes, each with its own scatter and with the width's allowance.
    whitening
        Takes the planes in standard deviations to independent ones, shape (3, 3).
    by_others
        Levels of red by one of the luma's, of blue by one of it, and of blue by one of the first
        plane's.
    """

    difference_dn: Float32Array
    sd_dn: Float32Array
    whitening: FloatArray
    by_others: Float32Array

    @classmethod
    def of(
        cls,
        planes: Sequence[tuple[FloatImage, FloatImage]],
        valid: BoolArray,
        width: float,
        by_others: Float32Array,
    ) -> Self:
        """Measure what correlation is left; ``width`` is that of the filter, in places."""
        difference = np.stack([np.asarray(plane[0], dtype=np.float32) for plane in planes])
        sd = np.stack([np.asarray(plane[1], dtype=np.float32) for plane in planes])
        rows, cols = sampled(valid, _SAMPLE_PX)
        scaled = (difference[:, rows, cols] / sd[:, rows, cols]).astype(np.float64)
        whitening = np.eye(PLANES)
        independent = max(np.count_nonzero(valid) / (4 * pi * width**2), 1.0)
        for _ in range(_ROUNDS):
            inside = np.linalg.norm(whitening @ scaled, axis=0) < _CLIP_SD * 1.3
            if np.count_nonzero(inside) <= PLANES:
                break
            moments = scaled[:, inside] @ scaled[:, inside].T / np.count_nonzero(inside)
            # Where the steps of the files are more than the scatter, nothing is to be made of that.
            spread = np.sqrt(np.maximum(np.diag(moments), 1.0))
            correlation = moments / spread / spread[:, None]
            correlation *= independent / (independent + _PRIOR_VALUES)
            np.fill_diagonal(correlation, 1.0)
            whitening = np.linalg.inv(np.linalg.cholesky(correlation))
        return cls(difference_dn=difference, sd_dn=sd, whitening=whitening, by_others=by_others)

    def strict_as(self, factor: float) -> Self:
        """The planes with another allowance."""
        return replace(self, sd_dn=self.sd_dn * np.float32(factor))

    def whitened(self, difference_dn: Float32Array) -> Float32Array:
        """Planes of a difference in independent standard deviations."""
        scaled = difference_dn / self.sd_dn
        return np.tensordot(self.whitening.astype(np.float32), scaled, axes=1)

    @property
    def vectors(self) -> Float32Array:
        """The level's own difference, likewise."""
        return self.whitened(self.difference_dn)

    def change_dn(self, direction: FloatArray, at: Place) -> FloatArray:
        """Red, green and blue of a change in a whitened direction, at a place."""
        scaled = np.linalg.solve(self.whitening, direction) * self.sd_dn[:, *at]
        by_others = self.by_others[:, *at].astype(np.float64)
        return to_rgb(to_channels(np.asarray(scaled, dtype=np.float64), by_others))

    def along(self, rgb: FloatArray) -> tuple[Float32Array, Float32Array]:
        """Matched amplitude of a change in this direction at every place, and its standard error.

        Parameters
        ----------
        rgb
            Red, green and blue of a change of amplitude 1.
        """
        weights = self.whitened(self._planes_of(rgb))
        power = np.einsum("kij,kij->ij", weights, weights)
        amplitude = np.einsum("kij,kij->ij", weights, self.vectors) / power
        return amplitude, 1 / np.sqrt(power)

    def error_along(self, rgb: FloatArray) -> Float32Array:
        """The standard error alone."""
        weights = self.whitened(self._planes_of(rgb))
        return np.asarray(1 / np.sqrt(np.einsum("kij,kij->ij", weights, weights)))

    def _planes_of(self, rgb: FloatArray) -> Float32Array:
        """A change of the channels in the planes, shape ``(3, rows, cols)``."""
        luma, red, blue = to_luma_red_blue(np.asarray(rgb, dtype=np.float64)).tolist()
        red_by_luma, blue_by_luma, blue_by_red = self.by_others
        first = np.float32(red) - red_by_luma * np.float32(luma)
        second = np.float32(blue) - blue_by_luma * np.float32(luma) - blue_by_red * first
        whole = np.broadcast_to(np.float32(luma), self.difference_dn.shape[1:])
        return np.stack([whole, *(np.broadcast_to(one, whole.shape) for one in (first, second))])

    def part(self, part: tuple[slice, slice]) -> Self:
        """Some places of it."""
        return replace(
            self,
            difference_dn=self.difference_dn[:, *part],
            sd_dn=self.sd_dn[:, *part],
            by_others=self.by_others[:, *part],
        )


def signed_significance(vectors: Float32Array, valid: BoolArray) -> Float32Array:
    """Significance of whitened vectors with the sign of the luma; 0 where it does not count."""
    norm = np.sqrt(np.einsum("kij,kij->ij", vectors, vectors))
    return np.where(valid, np.copysign(as_significance(norm), vectors[0]), np.float32(0))
