"""Two photographs compared on the pixels of the coarser one."""

from dataclasses import dataclass

import numpy as np

from analysis.changes.document import KernelOrigin
from simulation.arrays import BoolArray, FloatImage


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """What is left between two photographs once pose, blur and light are explained.

    Images are on the grid of the coarser photograph, shape ``(rows, cols)`` each; 0 where not
    ``valid``.

    Parameters
    ----------
    is_on_followup
        Whether the grid is that of the follow-up's pixels; the reference's if not.
    difference_dn
        After minus before in the follow-up's levels, smoothed.
    plain_difference_dn
        The same with the nearer photograph merely resampled.
    sd_dn
        Standard deviation of the difference.
    valid
        Pixels that were compared.
    smoothing_px
        Width of the Gaussian that smoothed the follow-up, in pixels of the grid.
    kernel
        Where the blur between the photographs is known from.
    extra_blur_px2, extra_blur_err_px2
        Variance by which the follow-up is softer than the calibration says, or than the reference
        where there is none, in follow-up pixels; and its standard error, infinite without detail.
    gain
        Mean gain of light, follow-up over reference.
    noise_dn2
        Variance of the noise in a follow-up pixel if both photographs had the same.
    registration_err_px, width_err_px2
        Standard deviations of the registration along the gradient, and of the variance by which
        the fitted blur is wrong.
    warnings
        Sentences on what makes the comparison doubtful.
    """

    is_on_followup: bool
    difference_dn: FloatImage
    plain_difference_dn: FloatImage
    sd_dn: FloatImage
    valid: BoolArray
    smoothing_px: float
    kernel: KernelOrigin
    extra_blur_px2: float
    extra_blur_err_px2: float
    gain: float
    noise_dn2: float
    registration_err_px: float
    width_err_px2: float
    warnings: tuple[str, ...] = ()

    @property
    def significance(self) -> FloatImage:
        """Difference over its standard deviation."""
        return np.asarray(np.where(self.valid, self.difference_dn / self.sd_dn, 0))

    @property
    def extra_blur_significance(self) -> float:
        """Extra blur over its standard error."""
        return self.extra_blur_px2 / self.extra_blur_err_px2
