"""The exact light on each pixel: scene, perspective, lens blur and pixel square.

The scene is sampled ``K`` times per pixel after a Gaussian blur that it computes in closed form,
so nothing aliases there; the rest of the lens's blur and the pixel's square are products with
their exact transfers in the Fourier domain; the result is read at the pixel centres. The
decision record ``docs/decisions/0001-how-the-bench-renders.md`` gives the reasons, and
``benchmarks/speed/render.py`` the speed.
"""

from dataclasses import dataclass
from math import atan, ceil, degrees, e, factorial, sqrt

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from hil_mocks.scene.folded_spectrum import FoldedSpectrum
from hil_mocks.scene.optics import Lens
from hil_mocks.scene.pinhole import CameraPose, PinholeCamera
from hil_mocks.scene.scenes import Scene

ALIAS_EXPONENT = 0.6
"""``s0^2 (1 - s0^2 / sigma^2) K^2``: folded frequencies are below exp(-2 pi^2 0.6) = 7e-6."""

PAD_SIGMAS = 5.0
TILE_PX = 64

GROWTH_NODE_ERROR = 1e-4
"""Bound on the error of the interpolation over the width of the PSF, relative to full scale."""

CORRECTION_NODE_ERROR = 1e-2
"""The same for the correction of the sampling blur, itself a few per cent at most."""

STEEPEST_VIEW_DEG = 75.0
"""Angle from the plane's normal up to which perspective is uniform enough over one pixel."""

DEPARTURE_PX2 = 0.04
"""Largest local departure of the sampling blur from its mean that is corrected for."""

FIRST_ORDER_PX2 = 0.008
"""Up to this departure a first-order correction is enough."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sampling:
    """Sampling density of the scene, and the blur that it is sampled with."""

    per_px: int
    sigma_px: float
    sigma_mm: float
    departure_px2: NDArray[np.float32] | None
    """Blur on the sensor minus ``sigma_px^2 I``: (xx, xy, yy), each (rows, cols)."""


class Renderer:
    """Renders a scene as seen by a pinhole camera with a blurring lens and square pixels.

    Parameters
    ----------
    camera
        The geometry.
    lens
        The optical PSF. It is taken as constant within the blur of one pixel.
    """

    def __init__(self, camera: PinholeCamera, lens: Lens) -> None:
        self.camera = camera
        self.lens = lens
        x_px = np.arange(camera.width_px, dtype=np.float64)[None, :]
        y_px = np.arange(camera.height_px, dtype=np.float64)[:, None]
        self._growth = lens.growth(camera.relative_radius(x_px, y_px)).astype(np.float32)

    def irradiance(self, scene: Scene, pose: CameraPose) -> NDArray[np.float32]:
        """Mean light on each pixel, shape (rows, cols); 1 is white paper.

        Raises
        ------
        ValueError
            If the camera is tilted so far that it nearly sees the plane's horizon.
        """
        half_view_deg = degrees(atan(self.camera.corner_radius_px / self.camera.focal_length_px))
        if pose.tilt_deg + half_view_deg > STEEPEST_VIEW_DEG:
            raise ValueError(
                f"a tilt of {pose.tilt_deg:.1f} degrees is too much: the corners of the frame look "
                f"{half_view_deg:.1f} degrees further, and the limit is {STEEPEST_VIEW_DEG:g}"
            )
        distance_mm = self.camera.distance_mm(pose.height_mm)
        defocus_px2 = self.lens.defocus_variance_px2(distance_mm)
        lens_px2 = self.lens.in_focus_covariance_px2
        smallest_px2 = float(np.linalg.eigvalsh(lens_px2)[0]) + defocus_px2
        largest_px2 = (
            float(np.linalg.eigvalsh(lens_px2)[1]) * float(self._growth.max()) + defocus_px2
        )
        sampling = self._sampling(pose, smallest_px2)
        pad = ceil(PAD_SIGMAS * sqrt(largest_px2) + 1)
        rows, cols = (
            scipy.fft.next_fast_len(n + 2 * pad, real=True)
            for n in (self.camera.height_px, self.camera.width_px)
        )
        samples = self._sample(scene, pose, sampling, (rows, cols), pad)
        spectrum = FoldedSpectrum(samples, sampling.per_px)
        window = (
            slice(pad, pad + self.camera.height_px),
            slice(pad, pad + self.camera.width_px),
        )
        remainder_px2 = (defocus_px2 - sampling.sigma_px**2) * np.eye(2)

        def over_growth(error: float, orders: tuple[int, int]) -> NDArray[np.float32]:
            nodes = _growth_nodes(float(self._growth.max()), error)
            total = np.zeros(self._growth.shape, dtype=np.float32)
            for index, growth in enumerate(nodes):
                part = spectrum.image(growth * lens_px2 + remainder_px2, orders)
                total += _lagrange(nodes, index, self._growth) * part[window]
            return total

        image = over_growth(GROWTH_NODE_ERROR, (0, 0))
        if sampling.departure_px2 is not None:
            for orders, share in _unblurring(sampling.departure_px2).items():
                image += share * over_growth(CORRECTION_NODE_ERROR, orders)
        return image

    def _sampling(self, pose: CameraPose, smallest_px2: float) -> _Sampling:
        """Choose the sampling blur, so that what is left for the Fourier domain is positive."""
        scale_px_per_mm = self.camera.scale_px_per_mm(pose.height_mm)
        if not (self.camera.k1 or pose.tilt_deg):
            blur_px2 = smallest_px2 / 2
            return _Sampling(
                per_px=_samples_per_px(blur_px2, smallest_px2),
                sigma_px=sqrt(blur_px2),
                sigma_mm=sqrt(blur_px2) / scale_px_per_mm,
                departure_px2=None,
            )
        xx, xy, yy = self._unit_blur(pose)
        unit = float(np.min([xx, yy]) + np.max([xx, yy])) / 2
        least = float(((xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)).min()) / unit
        departure = np.stack([xx / unit - 1, xy / unit, yy / unit - 1])
        blur_px2 = min(smallest_px2 / 2, DEPARTURE_PX2 / float(np.abs(departure).max()))
        return _Sampling(
            per_px=_samples_per_px(blur_px2 * least, smallest_px2),
            sigma_px=sqrt(blur_px2),
            sigma_mm=sqrt(blur_px2 / unit),
            departure_px2=(departure * blur_px2).astype(np.float32),
        )

    def _unit_blur(self, pose: CameraPose) -> NDArray[np.float64]:
        """Covariance on the sensor of a unit blur on the plane: px^2/mm^2, (3, rows, cols)."""
        x_px = np.arange(self.camera.width_px, dtype=np.float64)[None, :]
        y_px = np.arange(self.camera.height_px, dtype=np.float64)[:, None]
        right, left = (self.camera.to_plane_mm(x_px + step, y_px, pose) for step in (0.5, -0.5))
        below, above = (self.camera.to_plane_mm(x_px, y_px + step, pose) for step in (0.5, -0.5))
        # Columns of d plane / d pixel, and from them inverse(J) inverse(J)^T.
        (a, c), (b, d) = np.subtract(right, left), np.subtract(below, above)
        determinant2 = (a * d - b * c) ** 2
        return np.asarray(np.stack([b * b + d * d, -(a * b + c * d), a * a + c * c]) / determinant2)

    def _sample(
        self,
        scene: Scene,
        pose: CameraPose,
        sampling: _Sampling,
        shape: tuple[int, int],
        pad: int,
    ) -> NDArray[np.float32]:
        """Scene samples, ``per_px`` per pixel; sample 0 is at pixel ``-pad``."""
        rows, cols = shape[0] * sampling.per_px, shape[1] * sampling.per_px
        samples = np.empty((rows, cols), dtype=np.float32)
        x_px = np.arange(cols) / sampling.per_px - pad
        y_px = np.arange(rows) / sampling.per_px - pad
        tile = TILE_PX * sampling.per_px
        for top in range(0, rows, tile):
            for left in range(0, cols, tile):
                here = np.s_[top : top + tile, left : left + tile]
                x_mm, y_mm = self.camera.to_plane_mm(x_px[None, here[1]], y_px[here[0], None], pose)
                samples[here] = scene.reflectance(x_mm, y_mm, sampling.sigma_mm)
        return samples


def _unblurring(departure_px2: NDArray[np.float32]) -> dict[tuple[int, int], NDArray[np.float32]]:
    """Weights of the derivatives in the series of a deconvolution with a narrow Gaussian.

    ``exp(-D / 2)`` of ``D = xx d^2/dx^2 + 2 xy d^2/dxdy + yy d^2/dy^2``, keyed by the orders
    along x and y.
    """
    xx, xy, yy = departure_px2
    weights = {(2, 0): -xx / 2, (1, 1): -xy, (0, 2): -yy / 2}
    if np.abs(departure_px2).max() > FIRST_ORDER_PX2:
        weights |= {
            (4, 0): xx**2 / 8,
            (3, 1): xx * xy / 2,
            (2, 2): xy**2 / 2 + xx * yy / 4,
            (1, 3): xy * yy / 2,
            (0, 4): yy**2 / 8,
        }
    return weights


def _samples_per_px(blur_px2: float, smallest_px2: float) -> int:
    """Samples per pixel that keep folded frequencies below the limit of `ALIAS_EXPONENT`."""
    return ceil(sqrt(ALIAS_EXPONENT / (blur_px2 * (1 - blur_px2 / smallest_px2))))


def _growth_nodes(largest: float, error: float) -> NDArray[np.float64]:
    """Chebyshev nodes in [1, largest] for the factor on the in-focus covariance.

    A transfer ``exp(-a w)`` is interpolated in ``w`` with an error below
    ``2 (h / 2)^n (n / e)^n / n!`` for any ``a``, with ``h`` half the interval.
    """
    half = (largest - 1) / 2
    count = 1
    while half > 0 and 2 * (half / 2 * count / e) ** count / factorial(count) > error:
        count += 1
    angle = np.pi * (np.arange(count) + 0.5) / count
    return 1 + half * (1 - np.cos(angle))


def _lagrange(
    nodes: NDArray[np.float64], index: int, at: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Lagrange polynomial that is 1 at ``nodes[index]`` and 0 at the others."""
    share = np.ones_like(at)
    for other in np.delete(nodes, index):
        share *= (at - np.float32(other)) / np.float32(nodes[index] - other)
    return share
