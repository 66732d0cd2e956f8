"""Speed and accuracy of the simulated bench, beside the obvious ways to do the same.

One thread is used.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import itertools
from math import cos, radians, sin
from pathlib import Path
from time import perf_counter

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from acquisition.bench import BenchConfig, load_bench
from benchmarks.harness import Recorder, benchmark, best_s
from hil_mocks import BenchTruth, CameraPose
from hil_mocks.truth import Edge, PeriodicImage, Placed
from simulation.arrays import FloatArray

CONFIG = Path(__file__).parents[2] / "configs" / "simulated.toml"
SECONDS = 2.0
EDGE_DEG = 7.0
EVEN_FIELD = {"simulated.corner_sigma_gain": 0.0, "simulated.k1": 0.0}


def _rendering_seconds(config: BenchConfig, target: str, seconds: float) -> float:
    truth = BenchTruth(config)
    heights_mm = itertools.count(200.0)
    return best_s(
        lambda: truth.irradiance(target, EDGE_DEG, CameraPose(height_mm=next(heights_mm))), seconds
    )


def _supersampled_edge(truth: BenchTruth, samples_per_px: int) -> FloatArray:
    """Point-sample the sharp edge, blur the samples, average the blocks of each pixel."""
    rows, cols, pad = truth.camera.height_px, truth.camera.width_px, 4
    x_px = (np.arange((cols + 2 * pad) * samples_per_px) + 0.5) / samples_per_px - 0.5 - pad
    y_px = (np.arange((rows + 2 * pad) * samples_per_px) + 0.5) / samples_per_px - 0.5 - pad
    x_mm, y_mm = truth.camera.to_plane_mm(x_px[None, :], y_px[:, None], CameraPose(height_mm=200.0))
    bright = cos(radians(EDGE_DEG)) * y_mm - sin(radians(EDGE_DEG)) * x_mm > 0
    sigma_y, sigma_x = np.sqrt(np.diag(truth.optical_covariance_px2(200.0)))[::-1]
    blurred = gaussian_filter(
        bright.astype(np.float64), (sigma_y * samples_per_px, sigma_x * samples_per_px), truncate=6
    )
    blocks = blurred.reshape(rows + 2 * pad, samples_per_px, cols + 2 * pad, samples_per_px)
    return np.asarray(blocks.mean(axis=(1, 3))[pad:-pad, pad:-pad])


def _compare_with_supersampling(record: Recorder) -> None:
    truth = BenchTruth(load_bench(CONFIG, EVEN_FIELD | {"simulated.optical_rho": 0.0}))
    scene = Placed(scene=Edge(low=0.0, high=1.0), angle_deg=EDGE_DEG)
    pose = CameraPose(height_mm=200.0)
    exact_s = best_s(lambda: truth.renderer.irradiance(scene, pose), record.pick(SECONDS, 0.2))
    exact = truth.renderer.irradiance(scene, pose)
    for samples_per_px in (4, 8, 16):
        start = perf_counter()
        plain = _supersampled_edge(truth, samples_per_px)
        plain_s = perf_counter() - start
        peer = f"{samples_per_px} x {samples_per_px} samples, blurred and averaged"
        record.time("render an edge exactly", exact_s, peer, plain_s)
        record.say(f"differs by up to {np.abs(plain - exact).max():.1e}")


def _compare_spline(record: Recorder) -> None:
    image = PeriodicImage(np.random.default_rng(0).random((1024, 1024), dtype=np.float32))
    cols, rows = np.meshgrid(np.arange(2340) * 0.6, np.arange(1740) * 0.6)
    seconds = record.pick(SECONDS, 0.2)
    ours_s = best_s(lambda: image.blurred(cols, rows, 1.0), seconds)
    coefficients = np.ones((2048, 2048), dtype=np.float32)
    theirs_s = best_s(
        lambda: map_coordinates(
            coefficients, [rows, cols], order=3, mode="grid-wrap", prefilter=False
        ),
        seconds,
    )
    millions = cols.size / 1e6
    record.time(
        "cubic spline, a million points",
        ours_s / millions,
        "scipy's map_coordinates",
        theirs_s / millions,
    )


@benchmark("numpy", "scipy", "numba")
def main(record: Recorder) -> None:
    seconds = record.pick(SECONDS, 0.2)
    even, full = load_bench(CONFIG, EVEN_FIELD), load_bench(CONFIG)
    for target in ("edge", "brick", "lesion", "chart", "board"):
        even_s, full_s = (_rendering_seconds(one, target, seconds) for one in (even, full))
        record.time(f"render {target}", full_s)
        record.say(f"without distortion and growth to the corner {1e3 * even_s:.0f} ms")
    truth = BenchTruth(full)
    light = truth.irradiance("brick", 0.0, CameraPose(height_mm=200.0))
    rng = np.random.default_rng(0)
    electrons = truth.sensor.electrons(light, 9000.0)
    frame_s = best_s(lambda: truth.sensor.expose(electrons, 0.0, "Mono12", rng), seconds)
    record.time("noise of a frame of the simulated sensor", frame_s)
    _compare_with_supersampling(record)
    _compare_spline(record)
