"""Focus value of an image, normalised so that neither exposure nor noise enters."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.focus_measures import FOCUS_MEASURES, FocusMeasure

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
    measure: FocusMeasure = "squared-gradient",
) -> float:
    """Focus value, dimensionless; larger is sharper, 0 is flat or dark.

    With R the responses of the measure to the image I, b the black level, v the noise variance
    of a pixel and g the measure's noise gain (``FOCUS_MEASURES``)::

        F = (mean R^2 - g v) / (mean (I - b)^2 - v)

    Scaling the light scales numerator and denominator alike, so that exposure, gain and lamp
    drift do not read as focus. Values compare only over the same scene, region and measure.

    Noise adds g v to the mean squared response; for the squared gradient g is 4. Left in
    (``noise_variance_dn2`` 0), it raises every value by about g v / mean (I - b)^2 and flattens
    the peak; where the light drifts, its share drifts too and moves the peak. Taken out, F is
    unbiased and may come out slightly negative on a flat scene. The mean of v over the region is
    enough, though shot noise varies with the level: the bias is linear in v.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``, at least 2 x 2; 3 x 3 for all but the squared gradient.
    black_level_dn
        Level without light.
    region
        Where to look; everywhere if None.
    noise_variance_dn2
        For the mean of N frames, the temporal variance of one frame divided by N.
    measure
        See ``FOCUS_MEASURES``.

    References
    ----------
    Subbarao, Choi, Nikzad: "Focusing techniques", Optical Engineering 32 (11), 1993: gradient
    magnitude maximisation. Pertuz, Puig, Garcia: "Analysis of focus measure operators for
    shape-from-focus", Pattern Recognition 46, 2013: the others. ``benchmarks/bench_focus.py``
    has their times.
    """
    view = image_dn if region is None else region.cut(image_dn)
    kernel = FOCUS_MEASURES[measure]
    least = kernel.reach_px + 1
    if view.ndim != 2 or min(view.shape) < least:
        raise ValueError(f"image must be at least {least} x {least} pixels, got shape {view.shape}")
    sums = kernel.sums(view)
    light_dn2 = (
        sums.square_dn2
        - 2.0 * black_level_dn * sums.mean_dn
        + black_level_dn**2
        - noise_variance_dn2
    )
    response_dn2 = sums.response_dn2 - kernel.noise_gain * noise_variance_dn2
    return response_dn2 / light_dn2 if light_dn2 > 0 else 0.0
