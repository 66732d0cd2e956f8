"""Which edges were captured together, and what that makes them share."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from simulation.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SharedByCapture:
    """What is known of the edges' captures.

    ``group`` is the number of each edge's capture, ``normal_rad`` the direction of its normal.
    ``columns``, shape ``(edges, k)``, are what unknowns that the captures share do to the squared
    widths, beside their focus; ``precision`` is the inverse variance with which each of them is
    known beforehand, 0 for not.
    """

    group: IntArray
    normal_rad: FloatArray
    columns: FloatArray
    precision: FloatArray

    @classmethod
    def focus_alone(cls, group: IntArray, normal_rad: FloatArray) -> "SharedByCapture":
        """Return captures that share nothing but their focus."""
        none = np.empty((group.size, 0))
        return cls(group=group, normal_rad=normal_rad, columns=none, precision=np.empty(0))

    def some(self, chosen: IntArray) -> "SharedByCapture":
        """Return those of some edges."""
        return SharedByCapture(
            group=self.group[chosen],
            normal_rad=self.normal_rad[chosen],
            columns=self.columns[chosen],
            precision=self.precision,
        )

    @property
    def is_single(self) -> bool:
        """Whether each capture has one edge, so that edges are independent as they are."""
        return self.captures == self.group.size

    @property
    def fourfold(self) -> FloatArray:
        """What widths may change by direction beyond an ellipse: cos 4a and sin 4a."""
        return np.column_stack([np.cos(4 * self.normal_rad), np.sin(4 * self.normal_rad)])

    @property
    def captures(self) -> int:
        """Number of captures."""
        return int(np.unique(self.group).size)


def capture_numbers(keys: Sequence[Hashable]) -> IntArray:
    """Number equal keys alike, from 0 in the order of their first appearance."""
    numbers: dict[Hashable, int] = {}
    return np.array([numbers.setdefault(key, len(numbers)) for key in keys], dtype=np.int64)
