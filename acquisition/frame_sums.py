"""Exact sums over frames, from which their mean and variance come."""

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from acquisition.devices import FrameImage

_AT_ONCE = 4
"""Frames that are added at once."""


class FrameSums:
    """Exact integer sums over frames ``(rows, cols)``, so that their order cannot matter.

    For speed (``benchmarks/speed/aravis.py``) frames are added by fours, and squares summed in 32
    bits as long as they cannot overflow, then carried over into 64.
    """

    def __init__(self, shape: tuple[int, int], max_level_dn: int) -> None:
        self.shape = shape
        self._max_level_dn = max_level_dn
        self._sum_dn = np.zeros(shape, np.uint32).reshape(-1)
        self._sum_dn2 = np.zeros(shape, np.uint32).reshape(-1)
        self._carried_dn2 = np.zeros(shape, np.uint64).reshape(-1)
        self._frames_since_carry = 0
        self.is_saturated: NDArray[np.bool_] | None = None
        self.min_dn = 2**16 - 1
        self.max_dn = 0
        self._waiting: list[FrameImage] = []
        # Compiled before the stream runs: the first time takes a second, and no frame waits.
        pixel: FrameImage = np.zeros(1, np.uint8) if max_level_dn < 2**8 else np.zeros(1, np.uint16)
        one, none_dn = _read_only(pixel), np.zeros(1, np.uint32)
        _accumulate(one, none_dn, none_dn.copy())
        _accumulate_four(one, one, one, one, none_dn, none_dn.copy())

    def add(self, image_dn: FrameImage) -> None:
        """Add one frame of the right shape; it must not change any more."""
        self._waiting.append(_read_only(image_dn))
        if len(self._waiting) == _AT_ONCE:
            self._add_waiting()

    def mean_and_variance(self, count: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Mean and unbiased variance of the ``count`` frames that were added."""
        self._add_waiting()
        mean_dn = np.empty(self.shape, np.float32)
        variance_dn2 = np.empty(self.shape, np.float32)
        _mean_and_variance(
            count,
            self._sum_dn,
            self._sum_dn2,
            self._carried_dn2,
            mean_dn.reshape(-1),
            variance_dn2.reshape(-1),
        )
        return mean_dn, variance_dn2

    def _add_waiting(self) -> None:
        frames, self._waiting = self._waiting, []
        if len(frames) == _AT_ONCE and _AT_ONCE * self._max_level_dn**2 < 2**32:
            self._make_room(_AT_ONCE)
            one, two, three, four = frames
            extremes = _accumulate_four(one, two, three, four, self._sum_dn, self._sum_dn2)
            self._note(frames, *extremes)
            return
        for flat_dn in frames:
            self._make_room(1)
            self._note([flat_dn], *_accumulate(flat_dn, self._sum_dn, self._sum_dn2))

    def _note(self, frames: Sequence[FrameImage], low_dn: np.uint16, high_dn: np.uint16) -> None:
        """Take the smallest and largest level of frames that were added into account."""
        self.min_dn = min(self.min_dn, int(low_dn))
        self.max_dn = max(self.max_dn, int(high_dn))
        if high_dn < self._max_level_dn:
            return
        for flat_dn in frames:
            if high_dn > self._max_level_dn:
                # Beyond the pixel format: the 32 bits may have wrapped. Subtracting wraps back.
                square_dn2 = np.multiply(flat_dn, flat_dn, dtype=np.uint32)
                self._sum_dn2 -= square_dn2
                self._carried_dn2 += square_dn2
            is_saturated = flat_dn.reshape(self.shape) >= self._max_level_dn
            if self.is_saturated is not None:
                is_saturated |= self.is_saturated
            self.is_saturated = is_saturated

    def _make_room(self, frames: int) -> None:
        """Carry the squares over if those of some more frames might overflow them."""
        self._frames_since_carry += frames
        if self._frames_since_carry * self._max_level_dn**2 >= 2**32:
            self._carried_dn2 += self._sum_dn2
            self._sum_dn2.fill(0)
            self._frames_since_carry = frames


def _read_only(image_dn: FrameImage) -> FrameImage:
    """Return the flat image as read-only: the sums are then compiled for one kind of array."""
    flat = image_dn.reshape(-1)
    flat.flags.writeable = False
    return flat


@njit(cache=True)
def _accumulate(
    image_dn: FrameImage, sum_dn: NDArray[np.uint32], sum_dn2: NDArray[np.uint32]
) -> tuple[np.uint16, np.uint16]:
    """Add levels and squares to the sums; return the smallest and largest level."""
    low_dn = high_dn = image_dn[0]
    for i in range(image_dn.size):
        level_dn = np.uint32(image_dn[i])
        sum_dn[i] += level_dn
        sum_dn2[i] += level_dn * level_dn
        low_dn = min(low_dn, image_dn[i])
        high_dn = max(high_dn, image_dn[i])
    return low_dn, high_dn


@njit(cache=True)
def _accumulate_four(
    image0_dn: FrameImage,
    image1_dn: FrameImage,
    image2_dn: FrameImage,
    image3_dn: FrameImage,
    sum_dn: NDArray[np.uint32],
    sum_dn2: NDArray[np.uint32],
) -> tuple[np.uint16, np.uint16]:
    low_dn = high_dn = image0_dn[0]
    for i in range(sum_dn.size):
        level0_dn, level1_dn = np.uint32(image0_dn[i]), np.uint32(image1_dn[i])
        level2_dn, level3_dn = np.uint32(image2_dn[i]), np.uint32(image3_dn[i])
        sum_dn[i] += level0_dn + level1_dn + level2_dn + level3_dn
        sum_dn2[i] += (
            level0_dn * level0_dn
            + level1_dn * level1_dn
            + level2_dn * level2_dn
            + level3_dn * level3_dn
        )
        low_dn = min(low_dn, image0_dn[i], image1_dn[i], image2_dn[i], image3_dn[i])
        high_dn = max(high_dn, image0_dn[i], image1_dn[i], image2_dn[i], image3_dn[i])
    return low_dn, high_dn


@njit(cache=True)
def _mean_and_variance(
    count: int,
    sum_dn: NDArray[np.uint32],
    sum_dn2: NDArray[np.uint32],
    carried_dn2: NDArray[np.uint64],
    mean_dn: NDArray[np.float32],
    variance_dn2: NDArray[np.float32],
) -> None:
    divisor = np.float64(count * (count - 1))
    for i in range(sum_dn.size):
        total_dn = np.uint64(sum_dn[i])
        total_dn2 = carried_dn2[i] + np.uint64(sum_dn2[i])
        mean_dn[i] = np.float64(total_dn) / count
        # N sum(x^2) - (sum x)^2 is a difference of exact integers: no cancellation, never < 0.
        variance_dn2[i] = np.float64(np.uint64(count) * total_dn2 - total_dn * total_dn) / divisor
