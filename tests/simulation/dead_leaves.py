"""A scene that looks the same at every scale, photographed with a known Gaussian PSF."""

import cv2
import numpy as np
from scipy import ndimage

from simulation.arrays import FloatArray

SUBPIXELS = 4


def dead_leaves(
    shape: tuple[int, int],
    sigma_px: float,
    seed: int,
    discs_per_px: float = 1.0,
    zoom: int = 1,
    *,
    is_square: bool = False,
    radius_min_px: float = 0.375,
) -> FloatArray:
    """Overlapping discs with radii of density ``r^-3``, levels 0.1 to 0.9, blurred and sampled.

    ``sigma_px`` is the total PSF: four points per pixel along each axis carry the scene, and the
    blur is made there. Discs reach a quarter of the shorter side. With ``zoom`` the camera sees
    the scene of ``shape`` from that many times further away: pixel ``i`` of the smaller picture
    lies at ``zoom i + (zoom - 1) / 2`` of the one from nearby. ``is_square`` makes the discs
    squares at any angle, which have straight edges; none is smaller than ``radius_min_px``.
    """
    rng = np.random.default_rng(seed)
    rows, cols = (size * SUBPIXELS for size in shape)
    largest = min(rows, cols) / 4
    count = int(discs_per_px * shape[0] * shape[1])
    # The inverse of the distribution function of r^-3 between its ends.
    between = rng.uniform(largest**-2, (radius_min_px * SUBPIXELS) ** -2, count)
    radius = between**-0.5
    centre_x, centre_y = rng.uniform(0, cols, count), rng.uniform(0, rows, count)
    level = rng.uniform(0.1, 0.9, count)
    scene = np.full((rows, cols), 0.5, dtype=np.float32)
    turn = rng.uniform(0, np.pi / 2, count)
    for x, y, r, angle, value in zip(centre_x, centre_y, radius, turn, level, strict=True):
        if is_square:
            corner = angle + np.pi / 2 * np.arange(4)
            points = np.stack([x + r * np.cos(corner), y + r * np.sin(corner)], axis=1)
            place = np.rint(points * 256).astype(np.int32)
            cv2.fillConvexPoly(scene, place, float(value), shift=8)
        else:
            middle = (round(x * 256), round(y * 256))
            cv2.circle(scene, middle, round(r * 256), float(value), thickness=-1, shift=8)
    step = SUBPIXELS * zoom
    blurred = ndimage.gaussian_filter(scene, sigma_px * step, mode="reflect")
    return blurred[step // 2 :: step, step // 2 :: step].astype(np.float64)
