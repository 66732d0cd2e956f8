"""Where KernelGAN looks: crops of an image, drawn where its gradient is strong."""

from dataclasses import dataclass, field
from math import floor
from typing import Self

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.kernelgan.errors import KernelGanError

OUTPUT_SIDE_PX = 26
"""Side of the generator's output: what 64 px give at zoom 2 behind a kernel of 13 px
(the publication crops 64 px), and kept at other zooms."""


_REMEDY = "take a larger image or a smaller zoom"


def nearest_positions(count: int, zoom: float) -> IntArray:
    """Return the pixels ``floor((i + 0.5) zoom)`` that nearest-neighbour sampling takes."""
    return np.array([floor((i + 0.5) * zoom) for i in range(count)], dtype=np.int64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CropPicker:
    """Draws the crops of one image.

    ``image`` holds levels from 0 to 1, ``side_px`` is the side of the generator's crop, ``taps``
    the positions of the kernel's first tap in it, along either axis.
    """

    image: FloatArray = field(repr=False)
    side_px: int
    taps: IntArray = field(repr=False)
    cumulative: FloatArray = field(repr=False)

    @classmethod
    def of_image(cls, image: FloatArray, zoom: float, kernel_size: int) -> Self:
        """Weigh every place by the mean gradient magnitude of the crop that begins there.

        Raises
        ------
        KernelGanError
            If the image holds no crop, or no gradient.
        """
        taps = nearest_positions(OUTPUT_SIDE_PX, zoom)
        taps -= taps[0]
        side_px = int(taps[-1]) + kernel_size
        if min(image.shape) < side_px:
            raise KernelGanError(
                f"{image.shape[1]} x {image.shape[0]} px hold no crop of {side_px} px, "
                f"which zoom {zoom:g} needs; {_REMEDY}",
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
        return self._window(rng)

    def real_crop(self, rng: np.random.Generator) -> FloatArray:
        """Return a crop of the size of the generator's output.

        It lies anywhere in a window drawn as the generator's, so that both show equal content.
        """
        window = self._window(rng)
        top, left = rng.integers(0, self.side_px - OUTPUT_SIDE_PX + 1, size=2)
        return window[top : top + OUTPUT_SIDE_PX, left : left + OUTPUT_SIDE_PX]

    def _window(self, rng: np.random.Generator) -> FloatArray:
        drawn = rng.uniform(0.0, self.cumulative[-1])
        place = int(np.searchsorted(self.cumulative, drawn, side="right"))
        columns = self.image.shape[1] - self.side_px + 1
        top, left = divmod(min(place, len(self.cumulative) - 1), columns)
        return self.image[top : top + self.side_px, left : left + self.side_px]
