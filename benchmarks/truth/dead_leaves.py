"""Dead leaves whose photographs are known: a target of square pixels behind a Gaussian.

The target is a picture, as a chart's maker hands it over, printed as squares of its pixels. Behind
a Gaussian and square sensor pixels, turned by nothing, the level of a photograph's pixel is a sum
over the squares of products of second integrals of a Gaussian, which is exact: no grid is sampled.
A turned target is sampled eight times a pixel along both axes. Shares nothing with
``calibration``.
"""

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.special import ndtr

from simulation.arrays import FloatArray

_RADII = (4.0, 150.0)
_SAMPLES = 8


def dead_leaves(
    rng: np.random.Generator, size_px: int, radii_px: tuple[float, float] = _RADII
) -> FloatArray:
    """A square target of discs that hide one another: levels 0.2 to 0.8, radii as r**-3.

    References
    ----------
    Lee, Mumford and Huang, "Occlusion models for natural images", Int. J. Computer Vision 41, 2001.
    """
    least, most = radii_px
    target = np.full((size_px, size_px), np.nan)
    empty = size_px**2
    while empty:
        # The inverse of the distribution of radii; discs are laid from the top down.
        share = rng.uniform()
        radius = 1 / sqrt(least**-2 - share * (least**-2 - most**-2))
        x, y = rng.uniform(-radius, size_px + radius, 2)
        level = rng.uniform(0.2, 0.8)
        left, right = max(int(x - radius), 0), min(int(x + radius) + 2, size_px)
        top, bottom = max(int(y - radius), 0), min(int(y + radius) + 2, size_px)
        part = target[top:bottom, left:right]
        rows, cols = np.ogrid[top:bottom, left:right]
        hit = ((cols - x) ** 2 + (rows - y) ** 2 <= radius**2) & np.isnan(part)
        part[hit] = level
        empty -= int(hit.sum())
    return target


@dataclass(frozen=True, slots=True, kw_only=True)
class Print:
    """Where a target lies in a photograph: its first corner, its size, and its turn about it.

    ``scale`` is the side of a pixel of the target in px of the photograph.
    """

    x_px: float
    y_px: float
    scale: float
    turn_deg: float = 0.0


def photograph(
    target: FloatArray, printed: Print, shape: tuple[int, int], sigma_px: tuple[float, float]
) -> FloatArray:
    """Photograph of a target on a ground of level 0.5, behind a Gaussian wide along x and y."""
    if printed.turn_deg:
        return _turned(target, printed, shape, sigma_px)
    across = _shares(shape[1], printed.x_px, printed.scale, target.shape[1], sigma_px[0])
    down = _shares(shape[0], printed.y_px, printed.scale, target.shape[0], sigma_px[1])
    return np.asarray(0.5 + down @ (target - 0.5) @ across.T)


def _shares(pixels: int, start_px: float, scale: float, squares: int, sigma: float) -> FloatArray:
    """Share of each square in each pixel, along one axis."""
    edges = start_px + scale * np.arange(squares + 1)
    middles = np.arange(pixels, dtype=np.float64)[:, None]

    def step(place: FloatArray) -> FloatArray:
        """Integral of the Gaussian's own integral."""
        away = place / sigma
        density = np.exp(-0.5 * away**2) / sqrt(2 * pi)
        return np.asarray(sigma * (away * ndtr(away) + density))

    seen = step(middles + 0.5 - edges) - step(middles - 0.5 - edges)
    return np.asarray(seen[:, :-1] - seen[:, 1:])


def _turned(
    target: FloatArray, printed: Print, shape: tuple[int, int], sigma_px: tuple[float, float]
) -> FloatArray:
    turn = np.deg2rad(printed.turn_deg)
    rows, cols = (np.arange(size * _SAMPLES) + 0.5 for size in shape)
    right = (cols / _SAMPLES - 0.5 - printed.x_px)[None, :]
    down = (rows / _SAMPLES - 0.5 - printed.y_px)[:, None]
    x = np.floor((np.cos(turn) * right + np.sin(turn) * down) / printed.scale).astype(np.int64)
    y = np.floor((np.cos(turn) * down - np.sin(turn) * right) / printed.scale).astype(np.int64)
    inside = (x >= 0) & (y >= 0) & (x < target.shape[1]) & (y < target.shape[0])
    light = np.full(inside.shape, 0.5, np.float32)
    light[inside] = target[y[inside], x[inside]]
    for axis, sigma in ((1, sigma_px[0]), (0, sigma_px[1])):
        light = gaussian_filter1d(light, sigma * _SAMPLES, axis=axis, mode="nearest")
    blocks = light.reshape(shape[0], _SAMPLES, shape[1], _SAMPLES)
    return np.asarray(blocks.mean(axis=(1, 3)), np.float64)
