"""The PSF without an edge target, on the simulated bench: two distances, and a single image.

Every printed photograph of the bench through a lens that distorts by 1 % and vignettes by 15 %, at
a signal-to-noise ratio of 50 of white paper in single frames. ``two-distance``: heights with the
ratio of distances 2. ``single-image``: from 640 mm, where the print's own samples are half a camera
pixel and its edges sharper than the PSF. Both are given as the found width over the bench's, which
the Gaussian optical width and the pixel make up: sqrt(sigma^2 + 1/12). Prints without the twelve
clear edges that a single image needs show a dash.

    python -m benchmarks.bench_blind_psf
"""

from pathlib import Path

import numpy as np

from acquisition.bench import load_bench
from benchmarks.harness import Recorder, bench_parser
from calibration.blind import (
    calibrate_from_distances,
    calibrate_from_scene,
    is_clear,
)
from calibration.edges import EdgeImage
from calibration.errors import CalibrationError
from calibration.noise import LevelNoise
from calibration.psf import PsfCalibration
from hil_mocks.scene import PHOTOGRAPHS, BenchTruth, CameraPose
from simulation.arrays import FloatArray

CONFIG = Path(__file__).parents[1] / "configs" / "simulated.toml"
WHITE_DN, BLACK_DN, SNR = 3000.0, 64.0, 50.0
NEAR_MM, SCENE_MM = 220.0, 640.0
LENSES_PX = ((0.55, 0.48), (1.0, 0.9))


def photograph(truth: BenchTruth, name: str, height_mm: float, seed: int) -> EdgeImage:
    """A single frame of a print."""
    light = truth.irradiance(name, 5.0, CameraPose(height_mm=height_mm)).astype(np.float64)
    noise_dn = WHITE_DN / SNR
    rng = np.random.default_rng([seed, round(height_mm)])
    image = BLACK_DN + WHITE_DN * light + rng.normal(0, noise_dn, light.shape)
    known = LevelNoise(offset_dn2=noise_dn**2, slope_dn=0.0, floor_dn2=noise_dn**2)
    return EdgeImage(name=name, image_dn=image, noise=known)


def ratios(found: PsfCalibration, truth_px: FloatArray) -> FloatArray:
    assert found.covariance_px2 is not None
    return np.asarray(np.sqrt(np.diag(found.covariance_px2)) / truth_px)


def main() -> None:
    with Recorder.of(
        bench_parser(__doc__).parse_args(), "blind_psf", packages=("numpy",)
    ) as record:
        for lens_px in record.pick(LENSES_PX, LENSES_PX[:1]):
            judge_lens(record, lens_px)


def judge_lens(record: Recorder, lens_px: tuple[float, float]) -> None:
    """Print the table of one lens."""
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
    columns: dict[str, list[float]] = {"two-distance": [], "single-image": []}
    for seed, name in enumerate(PHOTOGRAPHS):
        pair = [photograph(truth, name, h, seed) for h in (NEAR_MM, far_mm)]
        by_pair = ratios(calibrate_from_distances([pair]), truth_px)
        columns["two-distance"].extend(by_pair)
        line = f"  {name:12s} {by_pair[0]:7.3f} {by_pair[1]:7.3f}"
        try:
            alone = calibrate_from_scene([photograph(truth, name, SCENE_MM, seed)])
        except CalibrationError:
            record.say(f"{line}       -       -")
            continue
        by_edges = ratios(alone, truth_px)
        columns["single-image"].extend(by_edges)
        clear = sum(is_clear(edge) for edge in alone.edges)
        record.say(f"{line} {by_edges[0]:7.3f} {by_edges[1]:7.3f} {clear:6d}")
    for method, values in columns.items():
        error = 100 * float(np.median(np.abs(np.array(values) - 1)))
        record.figure(f"{method}: error of sigma, lens {lens_px[0]:g} px", error, "%")
        record.say(f"  {method}: median error {error:.1f} %, median ratio {np.median(values):.3f}")


if __name__ == "__main__":
    main()
