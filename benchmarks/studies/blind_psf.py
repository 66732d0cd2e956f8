"""The PSF without an edge target, on the simulated bench: two distances, and a single image.

Every printed photograph of the bench through a lens that distorts by 1 % and vignettes by 15 %, at
a signal-to-noise ratio of 50 of white paper in single frames. ``two-distance``: heights with the
ratio of distances 2. ``single-image``: from 640 mm, where the print's own samples are half a camera
pixel and its edges sharper than the PSF. Both are given as the found width over the bench's, which
the Gaussian optical width and the pixel make up: sqrt(sigma^2 + 1/12), with the share of truths in
the 95 % intervals. Prints without the twelve clear edges that a single image needs show a dash.

    python -m benchmarks.studies.blind_psf
"""

from pathlib import Path

import numpy as np

from acquisition.bench import load_bench
from benchmarks.harness import Recorder, benchmark
from benchmarks.truth.edges import white_noise
from calibration.blind import (
    calibrate_from_distances,
    calibrate_from_scene,
    is_clear,
)
from calibration.edges import EdgeImage
from calibration.errors import CalibrationError
from calibration.psf import PsfCalibration
from hil_mocks.truth import PHOTOGRAPHS, BenchTruth, CameraPose
from simulation.arrays import FloatArray

CONFIG = Path(__file__).parents[2] / "configs" / "simulated.toml"
WHITE_DN, BLACK_DN, SNR = 3000.0, 64.0, 50.0
NEAR_MM, SCENE_MM = 220.0, 640.0
LENSES_PX = ((0.4, 0.36), (0.55, 0.48), (0.75, 0.67), (1.0, 0.9), (1.3, 1.17))
METHODS = ("two-distance", "single-image")


def _photograph(truth: BenchTruth, name: str, height_mm: float, seed: int) -> EdgeImage:
    """A single frame of a print."""
    light = truth.irradiance(name, 5.0, CameraPose(height_mm=height_mm)).astype(np.float64)
    noise_dn = WHITE_DN / SNR
    rng = np.random.default_rng([seed, round(height_mm)])
    image = BLACK_DN + WHITE_DN * light + rng.normal(0, noise_dn, light.shape)
    known = white_noise(noise_dn)
    return EdgeImage(name=name, image_dn=image, noise=known)


def _ratios(found: PsfCalibration, truth_px: FloatArray) -> FloatArray:
    assert found.covariance_px2 is not None
    return np.asarray(np.sqrt(np.diag(found.covariance_px2)) / truth_px)


def _holds(found: PsfCalibration, truth_px: FloatArray) -> list[bool]:
    """Whether the 95 % intervals of the widths along x and y hold the truth."""
    intervals = (found.intervals_95["sigma_x_px"], found.intervals_95["sigma_y_px"])
    return [
        low <= truth <= high
        for (low, high), truth in zip(intervals, truth_px.tolist(), strict=True)
    ]


def _judge_lens(record: Recorder, lens_px: tuple[float, float]) -> dict[str, list[bool]]:
    """Print the table of one lens; return which intervals of each method hold the truth."""
    keys = {
        "simulated.corner_sigma_gain": 0.0,
        "simulated.optical_sigma_x_px": lens_px[0],
        "simulated.optical_sigma_y_px": lens_px[1],
    }
    truth = BenchTruth(load_bench(CONFIG, keys))
    truth_px = np.sqrt(np.square(lens_px) + 1 / 12)
    pupil_mm = truth.camera.distance_mm(0.0)
    far_mm = 2 * (NEAR_MM + pupil_mm) - pupil_mm
    record.say(f"\ntotal sigma {truth_px[0]:.3f}, {truth_px[1]:.3f} px: found / true, x and y")
    record.say("  print          two-distance    single-image  edges")
    columns: dict[str, list[float]] = {method: [] for method in METHODS}
    held: dict[str, list[bool]] = {method: [] for method in METHODS}
    for seed, name in enumerate(PHOTOGRAPHS):
        pair = [_photograph(truth, name, h, seed) for h in (NEAR_MM, far_mm)]
        both = calibrate_from_distances([pair])
        by_pair = _ratios(both, truth_px)
        columns["two-distance"].extend(by_pair)
        held["two-distance"].extend(_holds(both, truth_px))
        line = f"  {name:12s} {by_pair[0]:7.3f} {by_pair[1]:7.3f}"
        try:
            alone = calibrate_from_scene([_photograph(truth, name, SCENE_MM, seed)])
        except CalibrationError:
            record.say(f"{line}       -       -")
            continue
        by_edges = _ratios(alone, truth_px)
        columns["single-image"].extend(by_edges)
        held["single-image"].extend(_holds(alone, truth_px))
        clear = sum(is_clear(edge) for edge in alone.edges)
        record.say(f"{line} {by_edges[0]:7.3f} {by_edges[1]:7.3f} {clear:6d}")
    for method, values in columns.items():
        error = 100 * float(np.median(np.abs(np.array(values) - 1)))
        record.figure(f"{method}: error of sigma, lens {lens_px[0]:g} px", error, "%")
        record.say(f"  {method}: median error {error:.1f} %, median ratio {np.median(values):.3f}")
    return held


@benchmark("numpy")
def main(record: Recorder) -> None:
    held: dict[str, list[bool]] = {method: [] for method in METHODS}
    for lens_px in record.pick(LENSES_PX, LENSES_PX[:1]):
        for method, of_lens in _judge_lens(record, lens_px).items():
            held[method].extend(of_lens)
    for method, of_all in held.items():
        share = 100 * float(np.mean(of_all))
        record.figure(f"{method}: truths in the 95 % interval", share, "%")
        record.say(f"{method}: {share:.1f} % of {len(of_all)} intervals hold the truth")
