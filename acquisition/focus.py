"""Focus value of an image: squared gradient, normalised so that exposure does not enter."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["Region", "focus_value"]

Levels = NDArray[np.integer[Any] | np.floating[Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """A rectangle of whole pixels; ``x_px``, ``y_px`` is its first column and row."""

    x_px: int
    y_px: int
    width_px: int
    height_px: int

    def __post_init__(self) -> None:
        if self.x_px < 0 or self.y_px < 0 or self.width_px < 2 or self.height_px < 2:
            raise ValueError(f"region must lie at 0 or more and span 2 x 2 pixels, got {self}")

    def cut(self, image: Levels) -> Levels:
        """View of the region in an image of shape ``(rows, cols)``.

        Raises
        ------
        ValueError
            If the region reaches beyond the image.
        """
        bottom, right = self.y_px + self.height_px, self.x_px + self.width_px
        if bottom > image.shape[0] or right > image.shape[1]:
            raise ValueError(f"{self} reaches beyond the image of shape {image.shape}")
        return image[self.y_px : bottom, self.x_px : right]


def focus_value(
    image_dn: Levels,
    *,
    black_level_dn: float,
    region: Region | None = None,
    noise_variance_dn2: float = 0.0,
) -> float:
    """Squared-gradient focus value, dimensionless; larger is sharper, 0 is flat or dark.

    With I the image, b the black level and v the noise variance of one of its pixels::

        F = (mean (I[y, x+1] - I[y, x])^2 + mean (I[y+1, x] - I[y, x])^2 - 4 v)
            / (mean (I - b)^2 - v)

    Scaling the light scales numerator and denominator alike, so that exposure, gain and lamp
    drift do not read as focus. Values compare only over the same scene and region.

    Noise adds 2 v to each mean squared difference. Left in (``noise_variance_dn2`` 0), it
    raises every value by about 4 v / mean (I - b)^2 and flattens the peak, without moving it;
    taken out, F is unbiased and may come out slightly negative on a flat scene.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``, at least 2 x 2.
    black_level_dn
        Level without light.
    region
        Where to look; everywhere if None.
    noise_variance_dn2
        For the mean of N frames, the temporal variance of one frame divided by N.

    References
    ----------
    Subbarao, Choi, Nikzad: "Focusing techniques", Optical Engineering 32 (11), 1993: gradient
    magnitude maximisation. ``benchmarks/bench_capture_write.py`` has its time.
    """
    view = image_dn if region is None else region.cut(image_dn)
    if view.ndim != 2 or min(view.shape) < 2:
        raise ValueError(f"image must be at least 2 x 2 pixels, got shape {view.shape}")
    rows, cols = view.shape
    # cv2.norm sums the squares of integers and floats alike in double, without temporaries.
    gradient_dn2 = (
        cv2.norm(view[:, 1:], view[:, :-1], cv2.NORM_L2SQR) / (rows * (cols - 1))
        + cv2.norm(view[1:], view[:-1], cv2.NORM_L2SQR) / ((rows - 1) * cols)
        - 4.0 * noise_variance_dn2
    )
    mean_dn = cv2.mean(view)[0]
    light_dn2 = (
        cv2.norm(view, cv2.NORM_L2SQR) / view.size
        - 2.0 * black_level_dn * mean_dn
        + black_level_dn**2
        - noise_variance_dn2
    )
    return gradient_dn2 / light_dn2 if light_dn2 > 0 else 0.0
