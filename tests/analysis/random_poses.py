"""Random poses of the simulated bench, what its camera sees there, and its truth."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.bench import BenchConfig
from hil_mocks.truth.bench_truth import BenchTruth
from hil_mocks.truth.render import CameraPose
from simulation.arrays import FloatArray

NEAR_MM = 180.0
EXPOSURE_US = 12000.0
READ_NOISE_DN = 6.0


@dataclass(frozen=True, kw_only=True, eq=False)
class PosedFrame:
    """A frame, and the true homography from it to the reference."""

    image_dn: NDArray[np.uint16]
    matrix: FloatArray


def reference_frame(truth: BenchTruth, target: str, seed: int) -> NDArray[np.uint16]:
    """Upright, from the near height."""
    return shot(truth, target, CameraPose(height_mm=NEAR_MM), np.random.default_rng(seed))


def posed_frames(truth: BenchTruth, target: str, count: int, seed: int) -> Iterator[PosedFrame]:
    """Frames from 0.95 to 1.8 times the distance, tilted, turned and shifted at random."""
    rng = np.random.default_rng([seed, 1])
    for _ in range(count):
        zoom = rng.uniform(0.95, 1.8)
        distance_mm = zoom * truth.camera.distance_mm(NEAR_MM)
        pose = CameraPose(
            height_mm=distance_mm - truth.camera.distance_mm(0.0),
            offset_x_mm=rng.uniform(-8, 8),
            offset_y_mm=rng.uniform(-8, 8),
            roll_deg=rng.uniform(-15, 15),
            tilt_x_deg=rng.uniform(-10, 10),
            tilt_y_deg=rng.uniform(-10, 10),
        )
        yield PosedFrame(
            image_dn=shot(truth, target, pose, rng),
            matrix=truth.homography_far_to_near(NEAR_MM, pose),
        )


def bench_truth(config: BenchConfig, width_px: int, height_px: int) -> BenchTruth:
    """The bench with a smaller sensor of the same field of view."""
    assert config.simulated is not None
    factor = config.simulated.width_px / width_px
    return BenchTruth(
        config.model_copy(
            update={
                "simulated": config.simulated.model_copy(
                    update={"width_px": width_px, "height_px": height_px}
                ),
                "optics": config.optics.model_copy(
                    update={"pixel_pitch_um": config.optics.pixel_pitch_um * factor}
                ),
            }
        )
    )


def shot(
    truth: BenchTruth, target: str, pose: CameraPose, rng: np.random.Generator
) -> NDArray[np.uint16]:
    mean = truth.expected_image_dn(target, 0.0, pose, exposure_us=EXPOSURE_US)
    variance = READ_NOISE_DN**2 + np.maximum(mean, 0.0) / truth.gain_e_per_dn()
    noisy = mean + np.sqrt(variance) * rng.standard_normal(mean.shape)
    return np.clip(np.rint(noisy), 0, 4095).astype(np.uint16)
