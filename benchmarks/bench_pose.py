"""Speed of the general pose beside the axis-aligned zoom-out and OpenCV's warp without blur.

One thread, float32, tables and kernels cached. ``peer`` is ``cv2.warpPerspective`` with Lanczos
weights, which blurs nothing. The plane's tilt leads along the columns, or at 45 degrees to them.
"""

from functools import partial
from math import cos, radians, sin

import cv2
import numpy as np

from benchmarks.harness import Recorder, bench_parser
from benchmarks.timing import best_s
from simulation import GaussianPsf, SamplingGrid, simulate_pose, zoom_out
from simulation.arrays import FloatArray

SIGMA_PX = 0.935
FOCAL_PX_PER_WIDTH = 964 / 780
SHAPES = ((580, 780), (3000, 4000))
POSES = ((0.0, 0.0, 1.5), (20.0, 0.0, 1.0), (20.0, 0.0, 1.5), (20.0, 45.0, 1.5), (20.0, 45.0, 2.0))
"""Tilt and its bearing in degrees, zoom on the axis."""


def homography(
    shape: tuple[int, int], tilt_deg: float, bearing_deg: float, zoom: float
) -> FloatArray:
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


def compare(record: Recorder, shape: tuple[int, int]) -> None:
    """Print a table of all poses for one size."""
    psf = GaussianPsf(sigma_x_px=SIGMA_PX, sigma_y_px=SIGMA_PX)
    image = np.random.default_rng(0).uniform(0, 255, shape).astype(np.float32)
    size, seconds = (shape[1], shape[0]), record.pick(1.0, 0.1)
    record.say(f"\n{size[0]} x {size[1]}")
    record.say("  tilt  bearing  zoom        ms   peer ms  seen  ns per pixel seen")
    for tilt_deg, bearing_deg, zoom in POSES:
        matrix = homography(shape, tilt_deg, bearing_deg, zoom)
        own_s = best_s(partial(simulate_pose, image, matrix, size, psf), seconds)
        flags = cv2.INTER_LANCZOS4 | cv2.WARP_INVERSE_MAP
        peer_s = best_s(partial(cv2.warpPerspective, image, matrix, size, flags=flags), seconds)
        seen = ~simulate_pose(image, matrix, size, psf).outside
        record.figure(
            f"pose, {size[0]} x {size[1]}, tilt {tilt_deg:g} at {bearing_deg:g}, zoom {zoom}",
            own_s * 1e3,
            "ms",
            peer="OpenCV's warp, which blurs nothing",
            peer_value=peer_s * 1e3,
        )
        record.say(
            f"  {tilt_deg:4.0f} {bearing_deg:8.0f} {zoom:5.1f} {own_s * 1e3:9.0f}"
            f" {peer_s * 1e3:9.0f} {seen.mean():5.2f} {own_s / seen.sum() * 1e9:12.0f}"
        )
    grid = SamplingGrid.centred(shape, 1.5)
    one_by_one = best_s(
        partial(simulate_pose, image, grid.matrix, (grid.cols, grid.rows), psf), seconds
    )
    separable = best_s(partial(zoom_out, image, 1.5, psf), seconds)
    record.figure(
        f"pose on the grid of zoom 1.5, {size[0]} x {size[1]}",
        one_by_one * 1e3,
        "ms",
        peer="zoom_out, which is separable",
        peer_value=separable * 1e3,
    )
    record.say(
        f"  the grid of zoom 1.5: {one_by_one * 1e3:.0f} ms, zoom_out {separable * 1e3:.0f} ms"
    )


def main() -> None:
    cv2.setNumThreads(1)
    with Recorder.of(
        bench_parser(__doc__).parse_args(),
        "pose",
        packages=("numpy", "numba", "scipy", "opencv-contrib-python-headless"),
        note=f"one thread, float32, sigma {SIGMA_PX} px",
    ) as record:
        for shape in record.pick(SHAPES, SHAPES[:1]):
            compare(record, shape)


if __name__ == "__main__":
    main()
