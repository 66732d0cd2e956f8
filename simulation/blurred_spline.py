"""A photograph at the sharpness it has from further away, to be read at any place.

Model ``matched`` for places that lie on no grid: behind a distorting lens, say.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from simulation.gaussian_kernel import MATCHED_TAIL_TOLERANCE, BlurCovariance, gaussian_terms
from simulation.psf import GaussianPsf
from simulation.resampling import blur
from simulation.zoom import SeparableSum

__all__ = ["BlurredSpline"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class BlurredSpline:
    """Coefficients of the quintic spline through a blurred image, shape ``(rows, cols)``."""

    coefficients: FloatArray

    @classmethod
    def of(cls, image: NDArray[np.generic], psf: GaussianPsf, zoom: float) -> Self:
        """Blur an image by what its PSF grows to from ``zoom`` times further away.

        Parameters
        ----------
        image
            Grey, shape ``(rows, cols)``.
        psf
            Total PSF; the blur is its covariance times ``zoom^2 - 1``.
        zoom
            Ratio of the distances; below 1 it blurs as 1 does: not at all.
        """
        excess = max(zoom, 1.0) ** 2 - 1
        (xx, xy), (_, yy) = (excess * psf.covariance_px2).tolist()
        rows, cols = image.shape
        kernels = gaussian_terms(
            BlurCovariance(yy_px2=yy, xx_px2=xx, xy_px2=xy),
            tail_tolerance=MATCHED_TAIL_TOLERANCE,
            spline_prefilter=True,
        )
        prefilter = SeparableSum(
            tuple((blur(k.along_y, rows), blur(k.along_x, cols)) for k in kernels)
        )
        return cls(np.asarray(prefilter.apply(np.asarray(image, dtype=np.float64))))

    def at(self, y_px: FloatArray, x_px: FloatArray) -> FloatArray:
        """Levels at places of the image, of the places' shape; mirrored beyond the border."""
        return np.asarray(
            map_coordinates(
                self.coefficients, [y_px, x_px], order=5, mode="reflect", prefilter=False
            )
        )
