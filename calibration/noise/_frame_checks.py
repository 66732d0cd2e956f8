"""Whether frames that another program saved are pictures of their own, and unprocessed.

The variance from frame to frame tells electrons per DN only where each pixel has a noise of its
own. Interpolating, scaling and smoothing make a pixel's noise smaller and hand it on to its
neighbours: the variance falls, and the gain that follows from it is too large by as much.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.errors import NoiseError

_PROCESSED = 0.1
_NOTED = 0.02
"""Neighbours' correlation. What photons and electronics of sensors do themselves stays below it:
a few thousandths, and up to a few hundredths in thick or very bright ones."""
_STANDARD_ERRORS = 4.0
_FEWEST_CHANGED_PX = 100


@dataclass(frozen=True, slots=True)
class NeighbourCorrelation:
    """Correlation of the temporal noise of pixels side by side, over so many ``pixels``."""

    value: float
    pixels: int

    @classmethod
    def of(cls, first: NDArray[Any], second: NDArray[Any]) -> "NeighbourCorrelation | None":
        """Compare two frames of one level; None where they do not tell.

        What rows and columns have in common is taken out: their noise is the electronics'.
        """
        change = second.astype(np.float32) - first.astype(np.float32)
        rows, cols = change.shape
        change -= change.mean(axis=1, keepdims=True)
        change -= change.mean(axis=0, keepdims=True)
        variance = float(np.mean(np.square(change)))
        if min(rows, cols) < 2 or variance <= 0:
            return None
        across = float(np.mean(change[:, 1:] * change[:, :-1])) / variance + 1 / cols
        down = float(np.mean(change[1:] * change[:-1])) / variance + 1 / rows
        return cls((across + down) / 2, change.size)


def correlation_note(found: Sequence[NeighbourCorrelation]) -> str:
    """Refuse flats whose noise was handed on to neighbours; say so where it is little."""
    pixels = sum(each.pixels for each in found)
    if not pixels:
        return ""
    value = sum(each.value * each.pixels for each in found) / pixels
    if value < max(_NOTED, _STANDARD_ERRORS / np.sqrt(2 * pixels)):
        return ""
    said = f"the noise of neighbouring pixels is correlated ({value:.2f})"
    if value >= _PROCESSED:
        raise NoiseError(
            f"{said}, as after demosaicing, scaling, smoothing or noise reduction: the gain would "
            "be too large; give frames as the sensor delivers them",
            reason="settings",
        )
    percent = 100 * (4 * value)
    return f"{said}: if the camera smooths, the gain is too large by {percent:.0f} % or more"


class FrameNames:
    """Remembers frames by their content, and finds the same one given twice."""

    def __init__(self) -> None:
        self._count = 0
        self._seen: dict[bytes, int] = {}
        self._twice: tuple[int, int] | None = None
        self._is_even = True

    def add(self, frame: NDArray[Any]) -> None:
        """Note a frame, shape ``(rows, cols)``, which is contiguous in memory."""
        self._count += 1
        first = self._seen.setdefault(blake2b(frame.data, digest_size=16).digest(), self._count)
        if first != self._count and self._twice is None:
            self._twice = (first, self._count)
        self._is_even = self._is_even and bool(np.ptp(frame) == 0)

    def refuse_repeats(self, name: str, kind: str, variance: NDArray[Any]) -> None:
        """Check that no frame is there twice, unless all pixels are clipped or without noise."""
        changed_px = np.count_nonzero(variance) / self._count
        is_still = changed_px < _FEWEST_CHANGED_PX
        if self._twice is None or (is_still and (kind == "dark" or self._is_even)):
            return
        one, other = self._twice
        raise NoiseError(
            f"{name}: frames {one} and {other} are identical, bit for bit, as when a program "
            "saves a frame twice; the noise would come out too small: give each frame once",
            reason="settings",
        )
