"""PSFs that are not Gaussian: what the operators take, and the PSF that edges have measured."""

from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np

from simulation.arrays import FloatArray
from simulation.choices import PsfForm
from simulation.psf.gaussian import PIXEL_VARIANCE_PX2, GaussianPsf
from simulation.psf.lens import LensOtf
from simulation.psf.transfer import Transfer

_LEAST_VARIANCE_PX2 = 1e-3
"""Least variance of the optics where a PSF is hardly wider than its pixel."""


class Psf(Protocol):
    """A total PSF, optics and pixel, symmetric about its centre; hashable.

    Equal PSFs have equal hashes: operators are cached by them.
    """

    def otf(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """Return the transfer function, real and signed, 1 at frequency 0; the two broadcast."""
        ...

    @property
    def gaussian(self) -> GaussianPsf:
        """The Gaussian nearest to it."""
        ...

    @property
    def form(self) -> PsfForm:
        """What is known about its shape."""
        ...

    @property
    def covariance_px2(self) -> FloatArray:
        """Covariance of the nearest Gaussian, shape (2, 2), order (x, y)."""
        ...

    def __hash__(self) -> int: ...


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredPsf:
    """A lens over square pixels.

    Parameters
    ----------
    lens
        Transfer function of the optics.
    gaussian
        The Gaussian nearest to the total PSF, from the same edges: models that know only a
        Gaussian use it, and so does whoever needs a size.
    stretch
        Rows of the matrix T if the lens's PSF is that of ``lens`` stretched by T: its transfer
        function is then ``lens(T f)``. A PSF that varies over the frame is one shape stretched.
    """

    lens: LensOtf
    gaussian: GaussianPsf
    stretch: tuple[tuple[float, float], tuple[float, float]] = ((1.0, 0.0), (0.0, 1.0))

    def otf(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """Return the transfer function of optics and pixel at frequencies in cycles per pixel."""
        fx, fy = np.asarray(fx_cy_per_px), np.asarray(fy_cy_per_px)
        (xx, xy), (yx, yy) = self.stretch
        lens = self.lens(xx * fx + xy * fy, yx * fx + yy * fy)
        return np.asarray(np.sinc(fx) * np.sinc(fy) * lens)

    @property
    def form(self) -> PsfForm:
        """What is known about the lens's shape."""
        if self.lens.correction is not None:
            return "free"
        if self.lens.cut_off_period_px == (0.0, 0.0, 0.0):
            return "gaussian"
        is_round = all(
            xx == yy and xy == 0
            for xx, xy, yy in (
                self.lens.cut_off_period_px,
                self.lens.defocus_waves2,
                self.lens.gaussian_px2,
            )
        )
        return "round" if is_round else "elliptic"

    @property
    def covariance_px2(self) -> FloatArray:
        """Covariance of the nearest Gaussian, shape (2, 2), order (x, y)."""
        return self.gaussian.covariance_px2

    def stretched_to(self, gaussian: GaussianPsf) -> Self:
        """Return the PSF whose nearest Gaussian is another one, the lens's shape stretched."""
        own, wanted = (_without_pixel(psf.covariance_px2) for psf in (self.gaussian, gaussian))
        matrix = _root(wanted) @ np.linalg.inv(_root(own))
        # A transfer function takes the transpose of the matrix that stretches its PSF.
        (xx, xy), (yx, yy) = (np.array(self.stretch) @ matrix.T).tolist()
        return type(self)(lens=self.lens, gaussian=gaussian, stretch=((xx, xy), (yx, yy)))


@dataclass(frozen=True, slots=True, kw_only=True)
class SeparablePsf:
    """A PSF known along the two axes alone: the product of two transfer functions.

    ``along_y`` and ``along_x`` include the pixel; ``gaussian`` is the nearest Gaussian.
    """

    along_y: Transfer
    along_x: Transfer
    gaussian: GaussianPsf

    def otf(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """Return the transfer function at frequencies in cycles per pixel."""
        along_x = self.along_x(np.abs(np.asarray(fx_cy_per_px)))
        return np.asarray(along_x * self.along_y(np.abs(np.asarray(fy_cy_per_px))))

    @property
    def form(self) -> PsfForm:
        """A curve along either axis."""
        return "separable"

    @property
    def covariance_px2(self) -> FloatArray:
        """Covariance of the nearest Gaussian, shape (2, 2), order (x, y)."""
        return self.gaussian.covariance_px2


def _without_pixel(covariance_px2: FloatArray) -> FloatArray:
    """Subtract the pixel's variance, as far as that leaves something in every direction."""
    values, vectors = np.linalg.eigh(covariance_px2 - PIXEL_VARIANCE_PX2 * np.eye(2))
    return np.asarray((vectors * np.maximum(values, _LEAST_VARIANCE_PX2)) @ vectors.T)


def _root(covariance: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.sqrt(values)) @ vectors.T)
