"""A scene of Gaussian blobs, seen by a Gaussian PSF in closed form: no resampling anywhere."""

import numpy as np

from simulation.arrays import FloatArray


def blobs(seed: int, count: int, reach_px: float) -> FloatArray:
    """Rows of y, x, sigma (reference px around its centre) and amplitude (DN)."""
    rng = np.random.default_rng(seed)
    return np.column_stack(
        [
            *rng.uniform(-reach_px, reach_px, (2, count)),
            rng.uniform(0.5, 3.0, count),
            rng.normal(0.0, 25.0, count),
        ]
    )


def photograph(
    scene: FloatArray, shape: tuple[int, int], zoom: float, psf_px: float, shift_px: float = 0.0
) -> FloatArray:
    """Image of the blobs on 120 DN; pixel centres, the middle of the scene ``shift_px`` aside."""
    image = np.full(shape, 120.0)
    middle_y, middle_x = (shape[0] - 1) / 2, (shape[1] - 1) / 2
    for y, x, sigma, amplitude in scene:
        width = float(np.hypot(sigma / zoom, psf_px))
        peak = amplitude * (sigma / zoom / width) ** 2
        row, col = y / zoom + middle_y, (x + shift_px) / zoom + middle_x
        reach = 6 * width
        top, bottom = max(int(row - reach), 0), min(int(row + reach) + 2, shape[0])
        left, right = max(int(col - reach), 0), min(int(col + reach) + 2, shape[1])
        if top >= bottom or left >= right:
            continue
        along_y = np.exp(-0.5 * ((np.arange(top, bottom) - row) / width) ** 2)
        along_x = np.exp(-0.5 * ((np.arange(left, right) - col) / width) ** 2)
        image[top:bottom, left:right] += peak * np.outer(along_y, along_x)
    return image


def pose_matrix(
    near: tuple[int, int], far: tuple[int, int], zoom: float, shift_px: float = 0.0
) -> FloatArray:
    """Homography of that pose: follow-up pixel (x, y, 1) to reference pixel."""
    return np.array(
        [
            [zoom, 0.0, (near[1] - 1) / 2 - zoom * (far[1] - 1) / 2 - shift_px],
            [0.0, zoom, (near[0] - 1) / 2 - zoom * (far[0] - 1) / 2],
            [0.0, 0.0, 1.0],
        ]
    )
