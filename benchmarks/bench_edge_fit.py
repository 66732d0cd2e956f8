"""Accuracy and speed of the edge fit, and speed of the search for edges.

Accuracy: optical widths of edges at random angles and places behind square pixels, as an RMS error
over the Cramer-Rao bound. The bound is computed here, from numerical derivatives of the exact edge
at every pixel within 6 sigma + 3 px, with angle, place, curvature and both levels unknown; nothing
unbiased is below 1. Speed: beside ``scipy.optimize.least_squares`` on the same pixels, with the
same edge and its derivatives by differences (a single fit; ``fit_edge`` also fits the total width,
tests for shading and judges the residuals), and beside ``cv2.Canny`` with ``cv2.findContours``.
All single-threaded but for OpenCV.
"""

import platform
import sys
import time
from collections.abc import Callable
from functools import partial

import cv2
import numba
import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr

from calibration.edge_detection import find_edges
from calibration.edge_fit import fit_edge
from calibration.edge_segments import EdgeSegment, edge_window

Array = NDArray[np.float64]

SIGMAS_PX = (0.5, 0.8, 1.5)
SNRS = (100.0, 30.0, 12.0)
EDGES = 400
SIDE_PX = 100
LOW_DN, CONTRAST_DN = 500.0, 2500.0


def best_s(call: Callable[[], object], seconds: float = 1.0) -> float:
    """Shortest of as many runs as fit, after one that warms up."""
    call()
    best, end = np.inf, time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - start)
    return float(best)


def exact_edge(parameters: Array, x: Array, y: Array) -> Array:
    """Level of pixels at (x, y); angle, offset, curvature, log sigma, low, high."""
    angle, offset, curvature, log_sigma, low, high = parameters
    c, s, sigma = np.cos(angle), np.sin(angle), np.exp(log_sigma)
    d = c * x + s * y - offset - curvature * (-s * x + c * y) ** 2
    a, b = max(abs(c), 1e-3), max(abs(s), 1e-3)
    unit = np.zeros_like(d)
    for sign, shift in ((1, a + b), (-1, a - b), (-1, b - a), (1, -a - b)):
        u = d + shift / 2
        gauss = np.exp(-0.5 * (u / sigma) ** 2) / np.sqrt(2 * np.pi)
        unit += sign * ((u**2 + sigma**2) * ndtr(u / sigma) + u * sigma * gauss) / 2
    return np.asarray(low + (high - low) * unit / (a * b))


def bound_px(truth: Array, x: Array, y: Array, noise_dn: float) -> float:
    """Cramer-Rao bound of sigma's standard deviation."""
    steps = np.array([1e-6, 1e-5, 1e-8, 1e-5, 1e-2, 1e-2])
    jacobian = np.column_stack(
        [
            (exact_edge(truth + shift, x, y) - exact_edge(truth - shift, x, y)) / (2 * step)
            for shift, step in zip(np.diag(steps), steps, strict=True)
        ]
    )
    scale = np.linalg.norm(jacobian, axis=0)
    inverse = np.linalg.inv((jacobian / scale).T @ (jacobian / scale))
    return float(np.exp(truth[3]) * np.sqrt(inverse[3, 3]) / scale[3] * noise_dn)


def accuracy(sigma_px: float, snr: float) -> None:
    rng = np.random.default_rng(round(sigma_px * 1000 + snr))
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX] - (SIDE_PX - 1) / 2
    noise_dn = CONTRAST_DN / snr
    errors, claimed, bounds, missed = [], [], [], 0
    for _ in range(EDGES):
        angle, offset = rng.uniform(0, 2 * np.pi), rng.uniform(-10, 10)
        truth = np.array([angle, offset, 0, np.log(sigma_px), LOW_DN, LOW_DN + CONTRAST_DN])
        image = exact_edge(truth, x, y) + rng.normal(0, noise_dn, x.shape)
        segments = find_edges(image, cell_px=1000.0)
        fit = fit_edge(image, segments[0]) if len(segments) == 1 else None
        if fit is None or fit.optical_sigma_px is None or fit.optical_sigma_err_px is None:
            missed += 1
            continue
        window = edge_window(image, segments[0], float(np.hypot(sigma_px, 12**-0.5)))
        centre = (SIDE_PX - 1) / 2
        place_x = window.x + window.centre_x_px - centre
        place_y = window.y + window.centre_y_px - centre
        errors.append(fit.optical_sigma_px - sigma_px)
        claimed.append(fit.optical_sigma_err_px)
        bounds.append(bound_px(truth, place_x, place_y, noise_dn))
    # Each error in units of its own bound: lengths differ from edge to edge.
    ratio = float(np.sqrt(np.mean((np.array(errors) / bounds) ** 2)))
    print(
        f"  {sigma_px:5.2f} {snr:5.0f} {np.mean(errors) / sigma_px * 100:8.3f}"
        f" {np.std(errors) / sigma_px * 100:8.3f} {ratio:10.3f}"
        f" {np.mean(np.array(claimed) / bounds):10.3f} {missed:8d}"
    )


def naive_fit(image: Array, segment: EdgeSegment) -> float:
    """Optical width by scipy, from the start that ``fit_edge`` has."""
    window = edge_window(image, segment, segment.sigma_px)
    low, high = window.side_levels
    start = np.array([window.normal_rad, 0.0, 0.0, np.log(segment.sigma_px), low, high])
    scale = np.array([0.01, 0.1, 1e-4, 0.1, high - low, high - low])

    def residuals(parameters: Array) -> Array:
        return exact_edge(parameters, window.x, window.y) - window.values

    fit = least_squares(residuals, start, x_scale=scale)
    return float(np.exp(fit.x[3]))


def fit_speed() -> None:
    print("\nfit of one edge of 100 px\n  sigma  angle   fit_edge ms   scipy ms  times faster")
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX] - (SIDE_PX - 1) / 2
    for sigma_px in SIGMAS_PX:
        for angle_deg in (5.0, 35.0):
            truth = np.array([np.deg2rad(angle_deg), 0.3, 0, np.log(sigma_px), 500.0, 3000.0])
            image = exact_edge(truth, x, y)
            image += np.random.default_rng(1).normal(0, 25.0, image.shape)
            segment = find_edges(image, cell_px=1000.0)[0]
            own_s = best_s(partial(fit_edge, image, segment))
            peer_s = best_s(partial(naive_fit, image, segment))
            print(
                f"  {sigma_px:5.2f} {angle_deg:6.0f} {own_s * 1e3:13.2f} {peer_s * 1e3:10.2f}"
                f" {peer_s / own_s:13.1f}"
            )


def chart(rows: int = 1944, cols: int = 2592, pitch_px: float = 160.0) -> Array:
    """Tilted dark squares on white: about 190 of them, 8-bit levels with noise of 1 DN."""
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    turn = np.deg2rad(5.0)
    image = np.ones((rows, cols))
    for u in (np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x):
        place = np.abs((u + pitch_px / 2) % pitch_px - pitch_px / 2)
        image *= ndtr((50.0 - place) / 0.8)
    return 220.0 - 190.0 * image + np.random.default_rng(2).normal(0, 1.0, image.shape)


def canny_and_contours(image: NDArray[np.uint8]) -> int:
    ridge = cv2.Canny(image, 50, 100, L2gradient=True)
    return len(cv2.findContours(ridge, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0])


def search_speed() -> None:
    image = chart()
    codes = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    own_s = best_s(partial(find_edges, image), 4.0)
    peer_s = best_s(partial(canny_and_contours, codes), 2.0)
    found = len(find_edges(image))
    print(
        f"\nsearch in {image.shape[1]} x {image.shape[0]} px: {found} edges in"
        f" {own_s * 1e3:.0f} ms; Canny and contours {peer_s * 1e3:.0f} ms,"
        f" {own_s / peer_s:.1f} times as long"
    )


def main() -> None:
    print(
        f"{platform.processor() or platform.machine()}, Python {sys.version.split()[0]}, "
        f"numpy {np.__version__}, numba {numba.__version__}, scipy {scipy.__version__}, "
        f"OpenCV {cv2.__version__} with {cv2.getNumThreads()} threads"
    )
    print(
        f"\noptical width of {EDGES} edges a line, found and fitted; missed: not found whole\n"
        "  sigma   SNR   bias %  scatter %  rms/bound  own err/bound  missed"
    )
    for sigma_px in SIGMAS_PX:
        for snr in SNRS:
            accuracy(sigma_px, snr)
    fit_speed()
    search_speed()


if __name__ == "__main__":
    main()
