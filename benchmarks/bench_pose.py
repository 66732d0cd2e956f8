"""Speed of the general pose beside the axis-aligned zoom-out and OpenCV's warp without blur.

One thread, float32, tables and kernels cached. ``peer`` is ``cv2.warpPerspective`` with Lanczos
weights, which blurs nothing. The plane's tilt leads along the columns, or at 45 degrees to them.
"""

import platform
import time
from collections.abc import Callable
from functools import partial
from math import cos, inf, radians, sin

import cv2
import numba
import numpy as np
import scipy
from numpy.typing import NDArray

from simulation import GaussianPsf, SamplingGrid, simulate_pose, zoom_out

SIGMA_PX = 0.935
FOCAL_PX_PER_WIDTH = 964 / 780
SHAPES = ((580, 780), (3000, 4000))
POSES = ((0.0, 0.0, 1.5), (20.0, 0.0, 1.0), (20.0, 0.0, 1.5), (20.0, 45.0, 1.5), (20.0, 45.0, 2.0))
"""Tilt and its bearing in degrees, zoom on the axis."""


def best_s(call: Callable[[], object], seconds: float = 1.0) -> float:
    """Shortest of as many runs as fit, after one that warms up."""
    call()
    best, end = inf, time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - start)
    return best


def homography(
    shape: tuple[int, int], tilt_deg: float, bearing_deg: float, zoom: float
) -> NDArray[np.float64]:
    """Camera that looks at the reference's centre from ``zoom`` times its distance."""
    t, b = radians(tilt_deg), radians(bearing_deg)
    about = np.array([[cos(b), -sin(b), 0], [sin(b), cos(b), 0], [0, 0, 1]])
    rotation = about @ np.array([[cos(t), 0, sin(t)], [0, 1, 0], [-sin(t), 0, cos(t)]]) @ about.T
    pupil = np.array([0, 0, 1]) - zoom * rotation[:, 2]
    rays = (1 - pupil[2]) * rotation + np.outer(pupil, rotation[2])
    rays[2] = rotation[2]
    focal_px = FOCAL_PX_PER_WIDTH * shape[1]
    intrinsic = np.array(
        [[focal_px, 0, (shape[1] - 1) / 2], [0, focal_px, (shape[0] - 1) / 2], [0, 0, 1]]
    )
    return np.asarray(intrinsic @ rays @ np.linalg.inv(intrinsic))


def main() -> None:
    cv2.setNumThreads(1)
    print(
        f"{platform.processor() or platform.machine()}, numpy {np.__version__}, "
        f"numba {numba.__version__}, scipy {scipy.__version__}, OpenCV {cv2.__version__}; "
        f"one thread, float32, sigma {SIGMA_PX} px"
    )
    psf = GaussianPsf(sigma_x_px=SIGMA_PX, sigma_y_px=SIGMA_PX)
    for shape in SHAPES:
        image = np.random.default_rng(0).uniform(0, 255, shape).astype(np.float32)
        size = (shape[1], shape[0])
        print(f"\n{size[0]} x {size[1]}")
        print("  tilt  bearing  zoom        ms   peer ms  seen  ns per pixel seen")
        for tilt_deg, bearing_deg, zoom in POSES:
            matrix = homography(shape, tilt_deg, bearing_deg, zoom)
            own_s = best_s(partial(simulate_pose, image, matrix, size, psf))
            flags = cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP
            peer_s = best_s(partial(cv2.warpPerspective, image, matrix, size, flags=flags))
            seen = ~simulate_pose(image, matrix, size, psf).outside
            print(
                f"  {tilt_deg:4.0f} {bearing_deg:8.0f} {zoom:5.1f} {own_s * 1e3:9.0f}"
                f" {peer_s * 1e3:9.0f} {seen.mean():5.2f} {own_s / seen.sum() * 1e9:12.0f}"
            )
        grid = SamplingGrid.centred(shape, 1.5)
        one_by_one = best_s(partial(simulate_pose, image, grid.matrix, (grid.cols, grid.rows), psf))
        separable = best_s(partial(zoom_out, image, 1.5, psf))
        print(
            f"  the grid of zoom 1.5: {one_by_one * 1e3:.0f} ms, zoom_out {separable * 1e3:.0f} ms"
        )


if __name__ == "__main__":
    main()
