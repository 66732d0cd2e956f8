"""Edges as a sensor sees them, by quadrature: shares nothing with the code under test."""

import numpy as np
from scipy.special import ndtr

from simulation.arrays import FloatArray


def point_edge(distance_px: FloatArray, sigma_px: float) -> FloatArray:
    """A step blurred by a Gaussian, sampled at points."""
    return np.asarray(ndtr(distance_px / sigma_px))


def pixel_edge(
    distance_px: FloatArray, sigma_px: float, normal_rad: float, nodes: int = 24
) -> FloatArray:
    """The same step averaged over the unit pixel, by Gauss-Legendre quadrature."""
    x, weight = np.polynomial.legendre.leggauss(nodes)
    x, weight = x / 2, weight / 2
    out = np.zeros_like(distance_px)
    for xi, wi in zip(x, weight, strict=True):
        for xj, wj in zip(x, weight, strict=True):
            shifted = distance_px + xi * np.cos(normal_rad) + xj * np.sin(normal_rad)
            out += wi * wj * ndtr(shifted / sigma_px)
    return out


def edge_image(
    sigma_px: float,
    normal_deg: float,
    *,
    shape: tuple[int, int] = (90, 110),
    offset_px: float = 0.37,
    low_dn: float = 8_000.0,
    high_dn: float = 52_000.0,
    has_pixel: bool = False,
    sagitta_px: float = 0.0,
) -> FloatArray:
    """An edge through the middle of the image; the bright side lies along the normal."""
    rows, cols = shape
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    x -= (cols - 1) / 2
    y -= (rows - 1) / 2
    normal = np.deg2rad(normal_deg)
    along = -np.sin(normal) * x + np.cos(normal) * y
    distance = np.cos(normal) * x + np.sin(normal) * y - offset_px
    distance = distance - sagitta_px * (2 * along / min(shape)) ** 2
    unit = pixel_edge(distance, sigma_px, normal) if has_pixel else point_edge(distance, sigma_px)
    return low_dn + (high_dn - low_dn) * unit
