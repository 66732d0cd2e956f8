"""A scene of Gaussian blobs, photographed in closed form: widths add in squares."""

import numpy as np

from simulation.arrays import FloatArray


def blob_photograph(
    zoom: float,
    covariance_px2: FloatArray,
    *,
    shape: tuple[int, int] = (240, 320),
    blobs: int = 1500,
    seed: int = 1,
    bend: float = 0.0,
) -> FloatArray:
    """The scene from ``zoom`` times as far away, in DN, through a Gaussian PSF.

    The blobs lie in units of the nearest photograph's pixels about the image centre; ``bend`` is
    a radial distortion, relative, at the corner.
    """
    rng = np.random.default_rng(seed)
    rows, cols = shape
    reach = np.array([cols, rows]) * 1.1
    places = rng.uniform(-reach, reach, (blobs, 2)) / zoom
    variances = rng.uniform(0.3, 6.0, blobs)
    heights = rng.uniform(-400, 400, blobs)
    centre = np.array([(cols - 1) / 2, (rows - 1) / 2])
    radius2 = np.sum((places / centre) ** 2, axis=1, keepdims=True) / 2
    # Blobs are stretched as their places are.
    stretched = bend * places[:, :, None] * (places / centre**2)[:, None, :]
    stretched += (1 + bend * radius2)[:, :, None] * np.eye(2)
    places = places * (1 + bend * radius2) + centre
    image = np.full(shape, 1500.0)
    y, x = np.mgrid[:rows, :cols]
    for (u, v), turn, own, height in zip(places, stretched, variances, heights, strict=True):
        shape_px2 = own / zoom**2 * turn @ turn.T
        total = covariance_px2 + shape_px2
        reach_px = 6 * np.sqrt(np.max(np.diag(total)))
        top, bottom = max(int(v - reach_px), 0), min(int(v + reach_px) + 2, rows)
        left, right = max(int(u - reach_px), 0), min(int(u + reach_px) + 2, cols)
        if top >= bottom or left >= right:
            continue
        part = np.s_[top:bottom, left:right]
        dx, dy = x[part] - u, y[part] - v
        inverse = np.linalg.inv(total)
        form = inverse[0, 0] * dx**2 + 2 * inverse[0, 1] * dx * dy + inverse[1, 1] * dy**2
        # The light of a blob is the same from anywhere, per pixel of the scene's area.
        passed = np.sqrt(np.linalg.det(shape_px2) / np.linalg.det(total))
        image[part] += height * passed * np.exp(-form / 2)
    return image


def far_to_near(zoom: float, shape: tuple[int, int] = (240, 320)) -> FloatArray:
    """Homography from the far photograph's pixels to the near one's."""
    rows, cols = shape
    return np.array(
        [
            [zoom, 0.0, (1 - zoom) * (cols - 1) / 2],
            [0.0, zoom, (1 - zoom) * (rows - 1) / 2],
            [0.0, 0.0, 1.0],
        ]
    )
