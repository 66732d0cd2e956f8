"""Scenes whose photographs have a closed form: rectangles and Gaussian blobs.

A camera with an optical Gaussian PSF and square pixels sees each of them as a product of two
one-dimensional profiles, whatever its distance. Nothing here is shared with ``simulation``.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from simulation.arrays import FloatArray


@dataclass(frozen=True)
class Item:
    """A rectangle (sides in px of the reference) or a blob (sigmas)."""

    is_rectangle: bool
    y_px: float
    x_px: float
    height_px: float
    width_px: float
    level_dn: float


@dataclass(frozen=True, kw_only=True)
class GaussianTransfer:
    """A Gaussian line spread function, with ``over_pixel`` integrated over square pixels."""

    sigma_px: float
    over_pixel: bool = False

    def __call__(self, freq_cy_per_px: FloatArray) -> FloatArray:
        gauss = np.exp(-2 * np.pi**2 * self.sigma_px**2 * freq_cy_per_px**2)
        return np.asarray(gauss * np.sinc(freq_cy_per_px) if self.over_pixel else gauss)


def random_scene(seed: int, extent_px: float, count: int = 60) -> list[Item]:
    """Rectangles with sides of 1.5-40 px and blobs with sigmas of 0.7-10 px, centre at (0, 0)."""
    rng = np.random.default_rng(seed)
    scene = []
    for index in range(count):
        y, x = rng.uniform(-extent_px / 2, extent_px / 2, 2)
        level = rng.uniform(-60, 60)
        if index % 2:
            height, width = np.exp(rng.uniform(np.log(1.5), np.log(40), 2))
            scene.append(Item(True, y, x, height, width, level))
        else:
            sigma = np.exp(rng.uniform(np.log(0.7), np.log(10)))
            scene.append(Item(False, y, x, sigma, sigma, level))
    return scene


def photograph(
    scene: list[Item],
    shape: tuple[int, int],
    zoom: float,
    optical_sigma_px: float,
    origin_px: tuple[float, float] | None = None,
) -> FloatArray:
    """Exact image, in DN around 128; pixel (0, 0) at scene coordinates ``origin_px`` (y, x).

    Without ``origin_px`` the image centre looks at (0, 0).
    """
    axes: list[FloatArray] = []
    for axis in (0, 1):
        if origin_px is None:
            axes.append(np.arange(shape[axis], dtype=np.float64) - (shape[axis] - 1) / 2)
        else:
            axes.append(np.arange(shape[axis], dtype=np.float64) + origin_px[axis] / zoom)
    image = np.full(shape, 128.0)
    for item in scene:
        profiles = [
            _profile(item.is_rectangle, axis, place / zoom, size / zoom, optical_sigma_px)
            for axis, place, size in (
                (axes[0], item.y_px, item.height_px),
                (axes[1], item.x_px, item.width_px),
            )
        ]
        image += item.level_dn * np.outer(*profiles)
    return image


def _profile(
    is_rectangle: bool, axis: FloatArray, place: float, size: float, sigma: float
) -> FloatArray:
    if is_rectangle:
        return _edge(axis - place + size / 2, sigma) - _edge(axis - place - size / 2, sigma)
    total = np.hypot(size, sigma)
    pixel = ndtr((axis - place + 0.5) / total) - ndtr((axis - place - 0.5) / total)
    return np.asarray(pixel * size * np.sqrt(2 * np.pi))


def _edge(x: FloatArray, sigma: float) -> FloatArray:
    """A step, blurred by a Gaussian and integrated over unit pixels."""

    def integral_of_phi(x: FloatArray) -> FloatArray:
        gauss = np.exp(-0.5 * (x / sigma) ** 2) / np.sqrt(2 * np.pi)
        return np.asarray(x * ndtr(x / sigma) + sigma * gauss)

    return integral_of_phi(x + 0.5) - integral_of_phi(x - 0.5)


def gaussian_blob(y_px: FloatArray, x_px: FloatArray, covariance_yx_px2: FloatArray) -> FloatArray:
    """Unit-volume Gaussian about (0, 0) at the given coordinates; covariance order (y, x)."""
    inverse = np.linalg.inv(covariance_yx_px2)
    y, x = y_px[:, None], x_px[None, :]
    quadratic = inverse[0, 0] * y**2 + 2 * inverse[0, 1] * x * y + inverse[1, 1] * x**2
    norm = 2 * np.pi * np.sqrt(np.linalg.det(covariance_yx_px2))
    return np.asarray(np.exp(-quadratic / 2) / norm)
