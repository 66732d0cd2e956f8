"""The stated error of a simulated pixel beside the error that it has.

Pairs of a closed form (sums of plane waves through Gaussians) and of the simulated bench (textures
through a soft Gaussian lens over square pixels) share no code with the model. In each pair the
calibrated PSF, the focus of either photograph and the noise are off at random, by what is known of
them; the figure is the root mean square of (follow-up - simulated) / stated error. The follow-up
itself has no noise. A second figure counts the error that the model states of itself, too.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import cos, radians, sin, sqrt

import numpy as np

from benchmarks.harness import Recorder, benchmark
from hil_mocks.truth.bench_truth import BenchTruth
from hil_mocks.truth.render import CameraPose
from simulation import GaussianPsf, LensOtf, MeasuredPsf, PoseOptions, Psf
from simulation.arrays import BoolArray, FloatArray
from simulation.choices import PoseModel
from simulation.uncertainty import (
    KnownErrors,
    SimulatedView,
    pixel_uncertainty,
    principal_steps,
)
from tests.hil_mocks.benches import bench_config
from tests.simulation.poses import tilted
from tests.simulation.wave_scene import WaveScene

MODELS: tuple[PoseModel, ...] = ("matched", "lmmse")
SCATTER_PX2 = 0.05
NOISE_DN = 1.0
WIDTH_ERR = 0.01
"""Relative error of the PSF's width."""

WAVES_SHAPE = (72, 90)
BENCH_SIZE = (320, 240)
NEAR_MM = 200.0
EXPOSURE_US = 8000.0
OPTICAL_PX2 = 0.6
"""Variance of the bench's lens: soft enough that little is beyond the pixels' limit."""

PIXEL_PX2 = 1 / 12


@dataclass(frozen=True)
class _Case:
    """A kind of pair: where the follow-up is, and how near and far are rendered by their PSFs."""

    name: str
    view: Callable[[PoseModel], SimulatedView]
    render: Callable[[int, float, float], tuple[FloatArray, FloatArray]]
    psf: Callable[[float], Psf]
    variance_px2: float
    inner: tuple[slice, slice]


@dataclass(frozen=True)
class _Ratios:
    """Mean squares of errors over what is stated, one for each pair."""

    without_model: list[float]
    with_model: list[float]

    def add(self, error: FloatArray, known: FloatArray, whole: FloatArray) -> None:
        """Add a pair; pixels outside the reference are NaN."""
        self.without_model.append(float(np.nanmean((error / known) ** 2)))
        self.with_model.append(float(np.nanmean((error / whole) ** 2)))


def _wave_cases() -> Iterator[_Case]:
    """Zooms and a tilt; the PSF is a Gaussian."""
    variance = 0.64
    size = (54, 42)
    middle = np.array([[1.0, 0.0, 18.0], [0.0, 1.0, 15.0], [0.0, 0.0, 1.0]])
    tilt = tilted(180.0, (WAVES_SHAPE[1], WAVES_SHAPE[0]), 15.0, 1.3) @ middle

    def at_zoom(zoom: float) -> Callable[[PoseModel], SimulatedView]:
        return lambda model: SimulatedView.at_zoom(WAVES_SHAPE, zoom, model)

    def of_pose(model: PoseModel) -> SimulatedView:
        return SimulatedView.of_pose(WAVES_SHAPE, tilt, size, PoseOptions(model=model))

    views = [(f"zoom {zoom:g}", at_zoom(zoom)) for zoom in (1.1, 1.5, 2.0)]
    for name, view in [*views, ("tilt 15 degrees, zoom 1.3", of_pose)]:
        seen = view("matched").survey()

        def render(
            seed: int, near_px2: float, far_px2: float, seen: FloatArray = seen
        ) -> tuple[FloatArray, FloatArray]:
            y, x = np.mgrid[0 : WAVES_SHAPE[0], 0 : WAVES_SHAPE[1]].astype(np.float64)
            scene = WaveScene(seed)
            flat = np.broadcast_to(near_px2 * np.array([1.0, 0.0, 1.0]), (*WAVES_SHAPE, 3))
            far = scene.photographed(seen[..., 0], seen[..., 1], far_px2 * seen[..., 2:])
            return scene.photographed(x, y, flat), far

        yield _Case(f"waves, {name}", view, render, _gaussian, variance, np.s_[8:-8, 8:-8])


def _gaussian(variance_px2: float) -> Psf:
    return GaussianPsf(sigma_px=sqrt(variance_px2))


def _bench_cases() -> Iterator[_Case]:
    """The simulated bench from further away, and tilted."""
    truth = _truth(OPTICAL_PX2)
    near = CameraPose(height_mm=NEAR_MM)
    for zoom, tilt_deg in ((1.25, 0.0), (1.5, 0.0), (1.5, 15.0)):
        far = _pose(truth, zoom, tilt_deg)
        matrix = truth.homography_far_to_near(near, far)

        def view(model: PoseModel, matrix: FloatArray = matrix) -> SimulatedView:
            options = PoseOptions(model=model)
            return SimulatedView.of_pose(BENCH_SIZE[::-1], matrix, BENCH_SIZE, options)

        seen = view("matched").survey()
        border = 16
        inside = (np.abs(seen[..., 0] - BENCH_SIZE[0] / 2) < BENCH_SIZE[0] / 2 - border) & (
            np.abs(seen[..., 1] - BENCH_SIZE[1] / 2) < BENCH_SIZE[1] / 2 - border
        )

        def render(
            seed: int,
            near_px2: float,
            far_px2: float,
            far: CameraPose = far,
            inside: BoolArray = inside,
        ) -> tuple[FloatArray, FloatArray]:
            target = ("grass", "gravel", "brick", "astronaut")[seed % 4]
            images = [
                _truth(variance).expected_image_dn(target, 0.0, pose, exposure_us=EXPOSURE_US)
                for variance, pose in ((near_px2, near), (far_px2, far))
            ]
            return images[0], np.where(inside, images[1], np.nan)

        name = f"bench, zoom {zoom:g}" + f", tilt {tilt_deg:g} degrees" * (tilt_deg > 0)
        yield _Case(name, view, render, _over_pixels, OPTICAL_PX2, np.s_[:, :])


def _over_pixels(variance_px2: float) -> Psf:
    total = GaussianPsf(sigma_px=sqrt(variance_px2 + PIXEL_PX2))
    return MeasuredPsf(lens=LensOtf(gaussian_px2=(variance_px2, 0.0, variance_px2)), gaussian=total)


def _truth(optical_px2: float) -> BenchTruth:
    sigma_px = sqrt(optical_px2)
    return BenchTruth(
        bench_config(
            stage__limits_mm=[10.0, 800.0],
            optics__pixel_pitch_um=20.0,
            simulated__width_px=BENCH_SIZE[0],
            simulated__height_px=BENCH_SIZE[1],
            simulated__optical_sigma_x_px=sigma_px,
            simulated__optical_sigma_y_px=sigma_px,
        )
    )


def _pose(truth: BenchTruth, zoom: float, tilt_deg: float) -> CameraPose:
    near_mm, lean = truth.camera.distance_mm(NEAR_MM), radians(tilt_deg)
    return CameraPose(
        height_mm=NEAR_MM - near_mm + zoom * near_mm * cos(lean),
        offset_x_mm=-zoom * near_mm * sin(lean),
        tilt_x_deg=tilt_deg,
    )


def _ratios_of(case: _Case, model: PoseModel, pairs: int, noise_dn: float) -> _Ratios:
    """Draw pairs; every four of them have the errors of a design of two levels in the focus."""
    view, rng = case.view(model), np.random.default_rng(0)
    found = _Ratios([], [])
    sigma = sqrt(case.variance_px2)
    for pair in range(pairs):
        signs = [1 - 2 * (pair >> bit & 1) for bit in range(3)]
        off = SCATTER_PX2 * np.array(signs[:2])
        near, far = case.render(pair // 8, *(case.variance_px2 + off))
        near = near + noise_dn * rng.normal(size=near.shape)
        known = np.array([sigma * (1 + signs[2] * WIDTH_ERR)])
        steps = principal_steps(
            lambda values: case.psf(float(values[0]) ** 2),
            known,
            np.array([[(WIDTH_ERR * sigma) ** 2]]),
            view.zoom,
        )
        psf = case.psf(float(known[0]) ** 2)
        errors = KnownErrors(
            noise_dn2=np.full(near.shape, noise_dn**2),
            psf_steps=steps,
            focus_scatter_px2=SCATTER_PX2,
        )
        stated = pixel_uncertainty(view, near, psf, errors)
        assert stated.err is not None
        assert stated.err_without_model is not None
        error = far - view.rendered(near, psf)
        found.add(error[case.inner], stated.err_without_model[case.inner], stated.err[case.inner])
    return found


@benchmark()
def main(record: Recorder) -> None:
    record.say("| pairs | model | error over stated | with the model's own |")
    record.say("|---|---|---:|---:|")
    for cases, pairs, noise_dn in (
        (_wave_cases(), record.pick(64, 8), NOISE_DN),
        (_bench_cases(), record.pick(32, 8), 4 * NOISE_DN),
    ):
        for case in cases:
            for model in MODELS:
                found = _ratios_of(case, model, pairs, noise_dn)
                without, whole = (
                    sqrt(np.mean(one)) for one in (found.without_model, found.with_model)
                )
                record.say(f"| {case.name} | {model} | {without:.3f} | {whole:.3f} |")
                record.figure(f"{case.name}, {model}", without, "ratio")
                record.figure(f"{case.name}, {model}, with model error", whole, "ratio")
