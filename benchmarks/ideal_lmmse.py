"""The best linear follow-up that the true transfer function and unlimited support allow.

Generalised Wiener sampling in the Fourier domain, for a scene with an isotropic first-order
covariance ``v exp(-d / L)``: what the capture model is measured against. Shares nothing with
``simulation``.

References
----------
Y. C. Eldar and M. Unser, "Nonideal sampling and interpolation from noisy observations in
shift-invariant spaces", IEEE Trans. Signal Process. 54 (2006), 2636-2651.
"""

from dataclasses import dataclass, field
from math import pi
from typing import Self

import numpy as np

from benchmarks.lens_optics import Camera, Transfer
from benchmarks.lens_scenes import Scene, series_at
from simulation.arrays import FloatArray

CORRELATION_PX = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class Ideal:
    """Estimator of what a camera sees, from a reference that it took of such a scene.

    ``spectrum_share`` is ``H S / (sum_m |H(f + m)|^2 S(f + m) + N)`` at the scene's frequencies.
    """

    scene: Scene
    spectrum_share: FloatArray = field(repr=False)

    @classmethod
    def of(cls, scene: Scene, camera: Camera, noise_dn: float) -> Self:
        """Make the estimator for white noise of this standard deviation in the reference."""
        fx, fy = scene.frequencies
        density = 2 * pi * CORRELATION_PX**2 * scene.variance_dn2
        spectrum = density / (1 + (2 * pi * CORRELATION_PX) ** 2 * (fx * fx + fy * fy)) ** 1.5
        otf = camera.otf(fx, fy)
        aliased = _folded(otf * otf * spectrum, scene.side_px)
        return cls(scene, otf * spectrum / (aliased + noise_dn**2))

    def seen(
        self, reference: FloatArray, far: Transfer, x_px: FloatArray, y_px: FloatArray
    ) -> FloatArray:
        """Estimate what the camera sees from elsewhere, at positions in the reference.

        Parameters
        ----------
        reference
            One period, shape ``(side, side)``.
        far
            The camera's transfer function there, in cycles per reference pixel.
        x_px, y_px
            Reference positions of the far pixels; the two broadcast.
        """
        kernel = far(*self.scene.frequencies) * self.spectrum_share
        series = self.scene.from_reference(reference, kernel / kernel[0, 0])
        return series_at(self.scene, series, x_px, y_px)


def _folded(half_plane: FloatArray, side_px: int) -> FloatArray:
    """Sum a real, symmetric function of frequency over the pixels' lattice, in the same layout."""
    rows, half = half_plane.shape
    mirrored = half_plane[-np.arange(rows) % rows, half - 2 : 0 : -1]
    plane = np.concatenate([half_plane, mirrored], axis=1)
    copies = rows // side_px
    base = plane.reshape(copies, side_px, copies, side_px).sum(axis=(0, 2))
    return np.asarray(base[np.arange(rows) % side_px][:, np.arange(half) % side_px])
