"""Training crops of KernelGAN, drawn where the gradient of the image is strong."""

from dataclasses import dataclass, field
from math import floor
from typing import Literal, Self

import numpy as np

from simulation.arrays import FloatArray, IntArray

_KernelGanReason = Literal[
    "torch_missing", "flat", "too_small", "not_finite", "wrong_sum", "discriminator_won"
]
"""``discriminator_won``: the discriminator distinguishes the patches with ease."""


class KernelGanError(Exception):
    """No kernel could be trained on this image; the message says what to do."""

    def __init__(self, message: str, *, reason: _KernelGanReason = "too_small") -> None:
        super().__init__(message)
        self.reason = reason


class TorchMissingError(KernelGanError, ImportError):
    """PyTorch is not installed."""


OUTPUT_SIDE_PX = 26
"""Side of the generator's output: that of a 64 px crop (as in the publication) at zoom 2 after a
kernel of 13 px, and the same at other zooms."""


_REMEDY = "use a larger image or a smaller zoom"


def _nearest_positions(count: int, zoom: float) -> IntArray:
    """Return the pixels ``floor((i + 0.5) zoom)`` that nearest-neighbour sampling takes."""
    return np.array([floor((i + 0.5) * zoom) for i in range(count)], dtype=np.int64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CropPicker:
    """Draws the crops of one image of levels from 0 to 1, by where the kernel's taps fall."""

    image: FloatArray = field(repr=False)
    side_px: int
    taps: IntArray = field(repr=False)
    cumulative: FloatArray = field(repr=False)

    @classmethod
    def of_image(cls, image: FloatArray, zoom: float, kernel_size: int) -> Self:
        """Weight every position by the mean gradient magnitude of the crop that starts there."""
        taps = _nearest_positions(OUTPUT_SIDE_PX, zoom)
        taps -= taps[0]
        side_px = int(taps[-1]) + kernel_size
        if min(image.shape) < side_px:
            raise KernelGanError(
                f"an image of {image.shape[1]} x {image.shape[0]} px is too small for the crops of "
                f"{side_px} px that zoom {zoom:g} needs; {_REMEDY}",
                reason="too_small",
            )
        gradient_y, gradient_x = np.gradient(image)
        magnitude = np.hypot(gradient_y, gradient_x)
        total = np.pad(magnitude, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
        weight = (
            total[side_px:, side_px:]
            - total[:-side_px, side_px:]
            - total[side_px:, :-side_px]
            + total[:-side_px, :-side_px]
        )
        cumulative = np.maximum(weight, 0.0).ravel().cumsum()
        if not cumulative[-1] > 0:
            raise KernelGanError(f"the image has no gradient to train on; {_REMEDY}", reason="flat")
        return cls(image=image, side_px=side_px, taps=taps, cumulative=cumulative)

    def generator_crop(self, rng: np.random.Generator) -> FloatArray:
        """Return a crop for the generator, shape ``(side_px, side_px)``."""
        drawn = rng.uniform(0.0, self.cumulative[-1])
        index = int(np.searchsorted(self.cumulative, drawn, side="right"))
        columns = self.image.shape[1] - self.side_px + 1
        top, left = divmod(min(index, len(self.cumulative) - 1), columns)
        return self.image[top : top + self.side_px, left : left + self.side_px]

    def real_crop(self, rng: np.random.Generator) -> FloatArray:
        """Return a crop of the generator's size from a window drawn like its own."""
        window = self.generator_crop(rng)
        top, left = rng.integers(0, self.side_px - OUTPUT_SIDE_PX + 1, size=2)
        return window[top : top + OUTPUT_SIDE_PX, left : left + OUTPUT_SIDE_PX]
