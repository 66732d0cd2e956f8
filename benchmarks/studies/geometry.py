"""Accuracy of the geometry calibration against the simulated bench's truth, beside plain OpenCV.

Every case is another camera: distortion, tilt, turn, place, heights and noise are drawn. ``peer``
takes the scale of each capture from ``cv2.findHomography`` on SIFT matches with the nearest one,
and the pupil from a straight line through distances and heights. ``covered`` is the share of cases
whose error is within 1.96 of its own standard errors; 24 cases tell this to 4 points.

    python -m benchmarks.studies.geometry [--cases 24] [--width-px 780]
"""

import time
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from benchmarks.harness import Recorder, benchmark
from calibration.errors import RegistrationError
from calibration.geometry import (
    GeometryCalibration,
    GeometryCapture,
    GeometryOptions,
    geometry_of_captures,
)
from calibration.registration import homography_pose, match_features, zoom_at_centre
from hil_mocks.truth import BenchTruth, CameraPose
from simulation.arrays import Float32Array, FloatArray
from tests.hil_mocks.benches import bench_config

FRAMES = 10
TARGETS = ("astronaut", "brick", "gravel", "board")
PITCH_UM, WIDTH_PX, HEIGHT_PX = 8.3, 780, 580
EXPOSURE_US = 9000.0


@dataclass(frozen=True)
class _Case:
    """A camera, its captures and what is true of it."""

    target: str
    truth: BenchTruth
    k1: float
    tilt_deg: tuple[float, float]
    heights_mm: FloatArray
    images: list[Float32Array]


def _draw_case(seed: int, width_px: int) -> _Case:
    """Draw a camera and photograph a target with it, 10 frames averaged."""
    rng = np.random.default_rng(seed)
    target = TARGETS[seed % len(TARGETS)]
    shrink = WIDTH_PX / width_px
    k1 = float(rng.uniform(-0.02, 0.01))
    config = bench_config(
        camera__exposure_us=EXPOSURE_US,
        camera__frame_rate_hz=60.0,
        stage={"driver": "simulated", "limits_mm": [120.0, 620.0]},
        optics__pixel_pitch_um=PITCH_UM * shrink,
        simulated={
            "width_px": width_px,
            "height_px": round(HEIGHT_PX / shrink),
            "optical_sigma_x_px": 0.55,
            "optical_sigma_y_px": 0.48,
            "optical_rho": 0.15,
            "corner_sigma_gain": 0.15,
            "pupil_offset_mm": float(rng.uniform(-10, 30)),
            "k1": k1,
            "vignetting": 0.15,
        },
    )
    truth = BenchTruth(config)
    tilt = rng.uniform(-2, 2, 2)
    mounting = {
        "tilt_x_deg": float(tilt[0]),
        "tilt_y_deg": float(tilt[1]),
        "offset_x_mm": float(rng.uniform(-3, 3)),
        "offset_y_mm": float(rng.uniform(-3, 3)),
    }
    orientation_deg = float(rng.uniform(-8, 8))
    near_mm = float(rng.uniform(170, 200))
    count = int(rng.integers(5, 8))
    zooms = np.sort(np.concatenate([[1.0], rng.uniform(1.1, 2.6, count - 2), [2.7]]))
    heights = np.round(zooms * (near_mm + 12.5) - 12.5, 3)
    sensor = truth.sensor
    images = []
    for height in heights:
        clean = truth.expected_image_dn(
            target,
            orientation_deg,
            CameraPose(height_mm=float(height), **mounting),
            exposure_us=EXPOSURE_US,
        )
        variance = (
            np.maximum(clean - sensor.black_level_dn, 0) / sensor.gain_e_per_dn
            + (sensor.read_noise_e / sensor.gain_e_per_dn) ** 2
            + 1 / 12
        )
        noisy = clean + rng.normal(size=clean.shape) * np.sqrt(variance / FRAMES)
        images.append(noisy.astype(np.float32))
    return _Case(target, truth, k1, (float(tilt[0]), float(tilt[1])), heights, images)


def _calibrated(case: _Case) -> GeometryCalibration:
    """Calibrate one case as the command does."""
    kind = "board" if case.target == "board" else "texture"
    captures = [
        GeometryCapture(
            name=f"{case.target} at {height:g} mm",
            kind=kind,
            target=case.target,
            orientation_deg=0.0,
            height_mm=float(height),
            image=image,
        )
        for height, image in zip(case.heights_mm, case.images, strict=True)
    ]
    nominal = GeometryOptions(nominal_focal_px=case.truth.camera.focal_length_px)
    return geometry_of_captures(captures, nominal)


def _peer_pupil_mm(case: _Case) -> tuple[float, float]:
    """Pupil offset and largest relative error of a zoom by pairwise homographies."""
    zooms = [1.0]
    for image in case.images[1:]:
        matrix, _ = homography_pose(match_features(case.images[0], image))
        zooms.append(zoom_at_centre(matrix, (image.shape[0], image.shape[1])))
    slope, level = np.polyfit(case.heights_mm, zooms, 1)
    true = np.array([case.truth.zoom(float(case.heights_mm[0]), float(h)) for h in case.heights_mm])
    return float(level / slope), float(np.abs(np.array(zooms) / true - 1).max())


def _compare(record: Recorder, cases: int, width_px: int) -> None:
    """Print a line for each case, and how the errors compare with what was claimed of them."""
    record.say(
        "target     n  pupil err +- se / mm     peer/mm  zoom err  peer zoom  scale err"
        "   k1 err/%  tilt err / deg      s   peer s"
    )
    sigmas: dict[str, list[float]] = {}
    own_zooms: list[float] = []
    peer_zooms: list[float] = []
    own_mm: list[float] = []
    off_mm: list[float] = []
    for seed in range(cases):
        case = _draw_case(seed, width_px)
        start = time.perf_counter()
        found = _calibrated(case)
        own_s = time.perf_counter() - start
        truth = case.truth
        start = time.perf_counter()
        try:
            peer_mm, peer_zoom = _peer_pupil_mm(case)
        except RegistrationError:
            peer_mm, peer_zoom = np.nan, np.nan
        peer_s = time.perf_counter() - start
        true_mm = truth.camera.pupil_offset_mm
        lowest = found.heights_mm[0]
        zoom_err = max(
            abs(found.zoom(lowest, h) / truth.zoom(lowest, h) - 1) for h in found.heights_mm
        )
        scales = found.scale_px_per_mm or ()
        scale_err = max(
            abs(scale / truth.scale_px_per_mm(h) - 1)
            for h, scale in zip(found.heights_mm, scales, strict=True)
        )
        tilt = np.array([found.tilt_x_deg, found.tilt_y_deg], dtype=np.float64)
        # Camera turn zero: the bench's tilt axes are those of the image.
        tilt_err = float(np.hypot(*(tilt - case.tilt_deg)))
        k1 = np.nan if found.k1 is None else found.k1
        err_mm, pupil_err_mm = found.pupil_offset_mm - true_mm, found.pupil_offset_err_mm or np.nan
        record.say(
            f"{case.target:9} {len(found.captures):2} {err_mm:+10.4f}"
            f" +- {pupil_err_mm:.4f}"
            f" {peer_mm - true_mm:+11.3f} {zoom_err:9.1e} {peer_zoom:10.1e} {scale_err:10.1e}"
            f" {100 * (k1 - case.k1) / 0.01:+10.2f} {tilt_err:15.4f} {own_s:6.1f} {peer_s:8.1f}",
        )
        own_zooms.append(zoom_err)
        peer_zooms.append(peer_zoom)
        own_mm.append(abs(err_mm))
        off_mm.append(abs(peer_mm - true_mm))
        sigmas.setdefault("pupil", []).append(err_mm / pupil_err_mm)
        for name, value, err, true in (
            ("k1", found.k1, found.k1_err, case.k1),
            ("k2", found.k2, found.k2_err, 0.0),
            ("tilt x", found.tilt_x_deg, found.tilt_x_err_deg, case.tilt_deg[0]),
            ("tilt y", found.tilt_y_deg, found.tilt_y_err_deg, case.tilt_deg[1]),
            ("principal x", found.principal_x_px, found.principal_x_err_px, 0.0),
        ):
            if value is not None and err is not None:
                sigmas.setdefault(name, []).append((value - true) / err)
    for name, values in sigmas.items():
        within = np.abs(values) < 1.96
        record.figure(f"error of {name} over its standard error", float(np.std(values)), "se")
        record.say(
            f"{name:12} covered {within.mean():.0%} of {len(values)}, rms {np.std(values):.2f} se"
        )
    for what, unit, own, peer in (
        ("worst error of a zoom, median of the cases", "1e-6", own_zooms, peer_zooms),
        ("error of the pupil, median of the cases", "um", own_mm, off_mm),
    ):
        scale = 1e6 if unit == "1e-6" else 1e3
        record.figure(
            what,
            scale * float(np.median(own)),
            unit,
            "homographies on SIFT, pair by pair",
            scale * float(np.nanmedian(peer)),
        )


@benchmark("numpy", "scipy", "opencv-contrib-python-headless", note="{width_px} px wide")
def main(
    record: Recorder,
    *,
    cases: Annotated[int | None, "number of cameras, 24 by default"] = None,
    width_px: int = WIDTH_PX,
) -> None:
    _compare(record, cases or record.pick(24, 3), width_px)
