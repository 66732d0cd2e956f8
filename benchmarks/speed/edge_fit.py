"""Speed of the edge fit and of the search for edges; accuracy is ``edge_accuracy``'s.

The fit beside ``scipy.optimize.least_squares`` on the same pixels, with the same edge and its
derivatives by differences (a single fit; ``fit_edge`` also fits the total width, tests for shading
and judges the residuals), the search beside ``cv2.Canny`` with ``cv2.findContours``. All
single-threaded but for OpenCV.
"""

from functools import partial

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr

from benchmarks.harness import Recorder, benchmark, best_s
from benchmarks.truth.edges import exact_edge
from calibration.edges import (
    EdgeSegment,
    band_half_width,
    band_pixels,
    find_edges,
    fit_edge,
    side_level,
)
from simulation.arrays import FloatArray

SIGMAS_PX = (0.5, 0.8, 1.5)
SIDE_PX = 100


def _naive_fit(image: FloatArray, segment: EdgeSegment) -> float:
    """Optical width by scipy, from the start that ``fit_edge`` has."""
    sigma_px = segment.sigma_px
    half_width = min(band_half_width(sigma_px), segment.clearance_px)
    x, y, values, across, _, _ = band_pixels(image, segment.line, half_width)
    low, high = side_level(values, -across, sigma_px), side_level(values, across, sigma_px)
    start = np.array([segment.normal_rad, 0.0, 0.0, np.log(sigma_px), low, high])
    scale = np.array([0.01, 0.1, 1e-4, 0.1, high - low, high - low])

    def residuals(parameters: FloatArray) -> FloatArray:
        return exact_edge(parameters, x, y) - values

    fit = least_squares(residuals, start, x_scale=scale)
    return float(np.exp(fit.x[3]))


def _fit_speed(record: Recorder) -> None:
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX] - (SIDE_PX - 1) / 2
    for sigma_px in SIGMAS_PX:
        for angle_deg in (5.0, 35.0):
            truth = np.array([np.deg2rad(angle_deg), 0.3, 0, np.log(sigma_px), 500.0, 3000.0])
            image = exact_edge(truth, x, y)
            image += np.random.default_rng(1).normal(0, 25.0, image.shape)
            segment = find_edges(image, cell_px=1000.0)[0]
            record.race(
                f"edge fit, sigma {sigma_px} px, {angle_deg:g} degrees",
                partial(fit_edge, image, segment),
                "scipy least_squares",
                partial(_naive_fit, image, segment),
                record.pick(2.0, 0.2),
            )


def _chart(rows: int = 1944, cols: int = 2592, pitch_px: float = 160.0) -> FloatArray:
    """Tilted dark squares on white: about 190 of them, 8-bit levels with noise of 1 DN."""
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    turn = np.deg2rad(5.0)
    image = np.ones((rows, cols))
    for u in (np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x):
        place = np.abs((u + pitch_px / 2) % pitch_px - pitch_px / 2)
        image *= ndtr((50.0 - place) / 0.8)
    return 220.0 - 190.0 * image + np.random.default_rng(2).normal(0, 1.0, image.shape)


@benchmark(
    "numpy",
    "numba",
    "scipy",
    "opencv-contrib-python-headless",
    note=f"OpenCV with {cv2.getNumThreads()} threads",
)
def main(record: Recorder) -> None:
    _fit_speed(record)
    image = _chart()
    codes = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    own_s = best_s(partial(find_edges, image), record.pick(4.0, 0.3))
    peer_s = best_s(
        lambda: cv2.findContours(
            cv2.Canny(codes, 50, 100, L2gradient=True), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE
        ),
        record.pick(2.0, 0.3),
    )
    size = f"{image.shape[1]} x {image.shape[0]}"
    record.time(f"search for edges, {size}", own_s, "OpenCV's Canny and contours", peer_s)
