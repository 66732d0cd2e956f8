"""Cameras over a plane: exact points by the simulated bench's own optics, and photographs."""

from collections.abc import Sequence
from functools import cache

import numpy as np

from acquisition.bench import BenchConfig
from calibration.geometry import GeometryCapture, PlaneLens
from calibration.geometry._bundle_adjustment import CapturePose, PlaneMatches, PosedCapture, Series
from hil_mocks.truth.bench_truth import BenchTruth
from hil_mocks.truth.render import CameraPose, PinholeCamera
from simulation.arrays import FloatArray

WIDTH_PX, HEIGHT_PX = 390, 290
FOCAL_MM, PITCH_UM = 8.0, 16.6
FOCAL_PX = FOCAL_MM / (PITCH_UM * 1e-3)
PUPIL_MM = 12.5
HEIGHTS_MM = (180.0, 220.0, 275.0, 340.0, 430.0)


def pinhole(k1: float = -0.01, pupil_mm: float = PUPIL_MM) -> PinholeCamera:
    return PinholeCamera(
        width_px=WIDTH_PX,
        height_px=HEIGHT_PX,
        focal_length_mm=FOCAL_MM,
        pixel_pitch_um=PITCH_UM,
        pupil_offset_mm=pupil_mm,
        k1=k1,
    )


def start_lens(focal_px: float = FOCAL_PX) -> PlaneLens:
    return PlaneLens(width_px=WIDTH_PX, height_px=HEIGHT_PX, focal_length_px=focal_px)


def poses_over(
    heights_mm: Sequence[float],
    *,
    tilt_deg: tuple[float, float] = (0.0, 0.0),
    drift_mm_per_mm: tuple[float, float] = (0.0, 0.0),
    roll_deg: float = 0.0,
) -> list[CameraPose]:
    """A camera on a stage that leans by the drift."""
    return [
        CameraPose(
            height_mm=height,
            offset_x_mm=drift_mm_per_mm[0] * height,
            offset_y_mm=drift_mm_per_mm[1] * height,
            roll_deg=roll_deg,
            tilt_x_deg=tilt_deg[0],
            tilt_y_deg=tilt_deg[1],
        )
        for height in heights_mm
    ]


def blank_captures(heights_mm: Sequence[float], target: str = "brick") -> list[GeometryCapture]:
    """Captures whose matches are known, so that nobody looks at their picture."""
    return [
        GeometryCapture(
            name=f"{target}-{height:g}.tif",
            kind="texture",
            target=target,
            orientation_deg=0.0,
            height_mm=height,
            image=np.zeros((HEIGHT_PX, WIDTH_PX)),
        )
        for height in heights_mm
    ]


def exact_matches(
    camera: PinholeCamera,
    captures: Sequence[GeometryCapture],
    poses: Sequence[CameraPose],
    *,
    noise_px: float = 0.0,
    rng: np.random.Generator | None = None,
    step_px: int = 24,
) -> list[PlaneMatches]:
    """A grid of pixels of every further capture and where every nearer one sees the same points.

    With noise every image of a point is off by its own amount, the same in all of its matches.
    """
    matches = []
    for far in range(1, len(poses)):
        y, x = np.mgrid[8 : HEIGHT_PX - 8 : step_px, 8 : WIDTH_PX - 8 : step_px].astype(np.float64)
        seen = np.column_stack([x.ravel(), y.ravel()])
        plane_x, plane_y = camera.to_plane_mm(seen[:, 0], seen[:, 1], poses[far])
        far_noise = np.zeros_like(seen) if rng is None else rng.normal(0, noise_px, seen.shape)
        for near in range(far):
            other = np.column_stack(camera.to_pixel(plane_x, plane_y, poses[near]))
            inside = np.all((other >= 0) & (other <= (WIDTH_PX - 1, HEIGHT_PX - 1)), axis=1)
            near_noise = 0.0 if rng is None else rng.normal(0, noise_px, other.shape)
            matches.append(
                PlaneMatches(
                    capture=captures[far],
                    seen_px=(seen + far_noise)[inside],
                    other=captures[near],
                    other_points=(other + near_noise)[inside],
                    covariance_px2=np.tile(
                        np.eye(2) * max(noise_px, 1e-3) ** 2, (int(inside.sum()), 1, 1)
                    ),
                )
            )
    return matches


def start_series(captures: Sequence[GeometryCapture], focal_px: float = FOCAL_PX) -> Series:
    """Rough poses: distances without the pupil's offset, no turn, no place."""
    unit_mm = captures[0].height_mm
    return Series(
        lens=start_lens(focal_px),
        captures=tuple(
            PosedCapture(
                capture=one, pose=CapturePose(log_distance=float(np.log(one.height_mm / unit_mm)))
            )
            for one in captures
        ),
        is_in_mm=False,
    )


@cache
def truth(k1: float = -0.01) -> BenchTruth:
    return BenchTruth(
        BenchConfig.model_validate(
            {
                "camera": {
                    "driver": "simulated",
                    "pixel_format": "Mono12",
                    "exposure_us": 9000.0,
                    "gain_db": 0.0,
                    "frame_rate_hz": 60.0,
                },
                "stage": {"driver": "simulated", "limits_mm": [120.0, 620.0]},
                "optics": {"focal_length_mm": FOCAL_MM, "pixel_pitch_um": PITCH_UM},
                "simulated": {
                    "width_px": WIDTH_PX,
                    "height_px": HEIGHT_PX,
                    "optical_sigma_x_px": 0.55,
                    "optical_sigma_y_px": 0.48,
                    "optical_rho": 0.15,
                    "corner_sigma_gain": 0.15,
                    "pupil_offset_mm": PUPIL_MM,
                    "k1": k1,
                    "vignetting": 0.15,
                },
            }
        )
    )


@cache
def photograph(
    target: str, height_mm: float, tilt_x_deg: float, orientation_deg: float
) -> FloatArray:
    pose = CameraPose(height_mm=height_mm, tilt_x_deg=tilt_x_deg)
    image = truth().expected_image_dn(target, orientation_deg, pose, exposure_us=9000.0)
    image.setflags(write=False)
    return image


def captures(
    target: str,
    heights_mm: Sequence[float] = HEIGHTS_MM,
    *,
    tilt_x_deg: float = 0.0,
    orientation_deg: float = 4.0,
    seed: int = 1,
) -> list[GeometryCapture]:
    """Photographs of a target, the noise of ten averaged frames on them."""
    rng = np.random.default_rng(seed)
    sensor = truth().sensor
    found = []
    for index, height_mm in enumerate(heights_mm):
        clean = photograph(target, height_mm, tilt_x_deg, orientation_deg)
        light = np.maximum(clean - sensor.black_level_dn, 0) / sensor.gain_e_per_dn
        variance = light + (sensor.read_noise_e / sensor.gain_e_per_dn) ** 2 + 1 / 12
        found.append(
            GeometryCapture(
                name=f"{target}-{height_mm:g}",
                kind="board" if target == "board" else "texture",
                target=target,
                orientation_deg=orientation_deg,
                height_mm=height_mm,
                image=clean + rng.normal(size=clean.shape) * np.sqrt(variance / 10),
                index=index,
            )
        )
    return found
