"""Photographs of the simulated bench with a change that is really in the scene."""

from dataclasses import dataclass, replace

import numpy as np

from hil_mocks.truth.bench_truth import BenchTruth
from hil_mocks.truth.render import CameraPose
from hil_mocks.truth.scenes import Placed, SumOfScenes, ZonePlate
from hil_mocks.truth.targets import scene_of
from simulation import GaussianPsf
from simulation.arrays import FloatArray
from simulation.capture_noise import CaptureNoise

EXPOSURE_US = 12000.0
FRAMES_AVERAGED = 10
NEAR_MM = 180.0


@dataclass(frozen=True, kw_only=True, eq=False)
class BenchPair:
    """Reference, follow-up, what the change adds to the follow-up, and the true homography."""

    reference: FloatArray
    followup: FloatArray
    change: FloatArray
    matrix: FloatArray


def far_pose(truth: BenchTruth, zoom: float, **pose: float) -> CameraPose:
    """Where the camera is ``zoom`` times as far from the plane as for the reference."""
    height_mm = zoom * truth.camera.distance_mm(NEAR_MM) - truth.camera.distance_mm(0.0)
    return CameraPose(height_mm=height_mm, **pose)


def bench_psf(truth: BenchTruth) -> GaussianPsf:
    """What a perfect calibration of the bench says."""
    covariance = truth.total_covariance_px2(NEAR_MM)
    return GaussianPsf.from_covariance(covariance)


def bench_noise(truth: BenchTruth, frames_averaged: int = FRAMES_AVERAGED) -> CaptureNoise:
    """What a perfect noise.json of the bench says."""
    return CaptureNoise(
        gain_e_per_dn=truth.gain_e_per_dn(),
        read_noise_e=truth.read_noise_e,
        black_level_dn=truth.black_level_dn,
        frames_averaged=frames_averaged,
    )


def bench_pair(
    truth: BenchTruth,
    target: str,
    followup: CameraPose,
    *,
    contrast: float,
    sigma_mm: float,
    pitch_mm: float,
    seed: int,
    frames_averaged: int | None = FRAMES_AVERAGED,
) -> BenchPair:
    """Photograph a target, and photograph it again from another pose with spots on it.

    Parameters
    ----------
    contrast
        Reflectance that a spot adds at its middle; 0 for no change.
    sigma_mm
        Width of a spot, a Gaussian.
    pitch_mm
        Distance of the spots, which lie on a grid.
    frames_averaged
        Of both photographs; None for none of their noise.
    """
    rng = np.random.default_rng(seed)
    scene = Placed(scene=scene_of(target))
    spot = ZonePlate(amplitude=contrast, window_mm=sigma_mm, freq_cy_per_mm=0.0)
    places = np.arange(-50.0, 50.1, pitch_mm)
    spots = [
        (Placed(scene=spot, x_mm=x + rng.uniform(-2, 2), y_mm=y + rng.uniform(-2, 2)), 5 * sigma_mm)
        for y in places
        for x in places
    ]
    near = CameraPose(height_mm=NEAR_MM)
    reference = truth.renderer.irradiance(scene, near)
    plain = truth.renderer.irradiance(scene, followup)
    changed = plain
    if contrast:
        changed = truth.renderer.irradiance(SumOfScenes(scene, spots), followup)
    levels = [
        truth.sensor.expected_dn(light, EXPOSURE_US, 0.0, "Mono12")
        for light in (reference, plain, changed)
    ]
    clean = BenchPair(
        reference=levels[0],
        followup=levels[2],
        change=levels[2] - levels[1],
        matrix=truth.homography_far_to_near(near, followup),
    )
    return (
        clean
        if frames_averaged is None
        else with_noise_of(truth, clean, seed=seed + 1, frames_averaged=frames_averaged)
    )


def with_noise_of(
    truth: BenchTruth, pair: BenchPair, *, seed: int, frames_averaged: int
) -> BenchPair:
    """Return a pair without noise as the means of frames show it."""
    noise = bench_noise(truth, frames_averaged)
    rng = np.random.default_rng(seed)

    def shot(mean: FloatArray) -> FloatArray:
        return mean + np.sqrt(noise.variance_dn2(mean)) * rng.standard_normal(mean.shape)

    return replace(pair, reference=shot(pair.reference), followup=shot(pair.followup))
