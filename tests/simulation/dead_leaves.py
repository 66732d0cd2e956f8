"""A scene that looks the same at every scale, photographed with a known Gaussian PSF."""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

SUBPIXELS = 4
RADIUS_MIN_SUBPX = 1.5


def dead_leaves(
    shape: tuple[int, int], sigma_px: float, seed: int, discs_per_px: float = 1.0
) -> NDArray[np.float64]:
    """Overlapping discs with radii of density ``r^-3``, levels 0.1 to 0.9, blurred and sampled.

    ``sigma_px`` is the total PSF: four points per pixel along each axis carry the scene, and the
    blur is made there. Discs reach a quarter of the shorter side.
    """
    rng = np.random.default_rng(seed)
    rows, cols = (size * SUBPIXELS for size in shape)
    largest = min(rows, cols) / 4
    count = int(discs_per_px * shape[0] * shape[1])
    # The inverse of the distribution function of r^-3 between its ends.
    between = rng.uniform(largest**-2, RADIUS_MIN_SUBPX**-2, count)
    radius = between**-0.5
    centre_x, centre_y = rng.uniform(0, cols, count), rng.uniform(0, rows, count)
    level = rng.uniform(0.1, 0.9, count)
    scene = np.full((rows, cols), 0.5, dtype=np.float32)
    for x, y, r, value in zip(centre_x, centre_y, radius, level, strict=True):
        place = (round(x * 256), round(y * 256))
        cv2.circle(scene, place, round(r * 256), float(value), thickness=-1, shift=8)
    blurred = ndimage.gaussian_filter(scene, sigma_px * SUBPIXELS, mode="reflect")
    middle = SUBPIXELS // 2
    return blurred[middle::SUBPIXELS, middle::SUBPIXELS].astype(np.float64)
