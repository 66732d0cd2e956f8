"""Planned sessions that are carried out again and again on the simulated bench.

Each repetition captures what the plan says, with noise, focus, heights and photographs of its own,
and is evaluated by the calibrations that a real session gets. The scatter of the results is what
``plan_study`` predicts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import standoff
from acquisition.bench import BenchConfig, load_bench
from acquisition.plan import CapturePlan, PlanEntry, parse_plan, plan_entries
from analysis.detectability import (
    DetectabilityCurve,
    DetectionTask,
    GaussianSignal,
    curves_of_images,
)
from analysis.pose import ViewingCamera, limits_of_curve
from analysis.study import PlanStudy
from calibration.edges import EdgeImage
from calibration.geometry import GeometryCapture, GeometryOptions, geometry_of_captures
from calibration.noise import NoiseCalibration, fit_level_noise
from calibration.psf import PsfCalibration, psf_of_images
from hil_mocks.truth import ADC_MAX_DN, BenchTruth, CameraPose
from simulation.psf import Psf

CONFIGS = Path(__file__).parents[2] / "configs"
ZOOMS = (1.0, 1.01, 1.1, 1.2, 1.35, 1.5, 1.75, 2.0, 2.5)
QUARTER = np.array([0.25]), np.zeros(1)

Image = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class StudiedSession:
    """A plan, its bench, and what differs from repetition to repetition.

    ``plan`` is as in a plan file without schema and name, ``bench`` the keys of ``[simulated]``
    that differ from configs/simulated.toml. Scatters and errors are standard deviations of what a
    repetition draws; its photographs are cut from a photograph of skimage, the scene.
    """

    name: str
    plan: dict[str, object]
    bench: dict[str, float] = field(default_factory=dict)
    exposure_us: float = 9000.0
    focus_scatter_px2: float = 0.0
    height_scatter_mm: float = 0.0
    gain_relative_err: float = 0.0
    scene: str = "gravel"
    photographs: int = 4
    contrast_dn: float = 80.0
    min_d_prime: float = 2.0

    @property
    def capture_plan(self) -> CapturePlan:
        """The plan."""
        table = {"schema": "standoff.plan/1", "name": self.name, **self.plan}
        return parse_plan(table, source=self.name)

    @property
    def config(self) -> BenchConfig:
        """The bench: small frames, no field."""
        shipped = load_bench(CONFIGS / "simulated.toml")
        plain = {"corner_sigma_gain": 0.0, "k1": 0.0, "vignetting": 0.0}
        size = {"width_px": 240, "height_px": 180}
        assert shipped.simulated is not None
        return shipped.model_copy(
            update={
                "simulated": shipped.simulated.model_copy(update=plain | size | self.bench),
                "camera": shipped.camera.model_copy(update={"exposure_us": self.exposure_us}),
            }
        )

    def truth(self, variance_px2: float = 0.0) -> BenchTruth:
        """The bench's truth, with so much added to the variance of its PSF."""
        config = self.config
        known = config.simulated
        assert known is not None
        x, y = known.optical_sigma_x_px, known.optical_sigma_y_px
        xx, xy, yy = x * x + variance_px2, known.optical_rho * x * y, y * y + variance_px2
        moved = known.model_copy(
            update={
                "optical_sigma_x_px": sqrt(xx),
                "optical_sigma_y_px": sqrt(yy),
                "optical_rho": xy / sqrt(xx * yy),
            }
        )
        return BenchTruth(config.model_copy(update={"simulated": moved}))

    @property
    def frames(self) -> int:
        """Frames of a capture."""
        return self.capture_plan.frames_per_capture or self.config.capture.frames_per_capture

    @property
    def entries(self) -> tuple[PlanEntry, ...]:
        """Captures of the plan."""
        return plan_entries(self.capture_plan)

    @property
    def noise(self) -> NoiseCalibration:
        """The camera's noise as measured: right, with the error that repetitions draw."""
        sensor = self.truth().sensor
        return NoiseCalibration(
            gain_e_per_dn=sensor.gain_e_per_dn,
            gain_e_per_dn_err=self.gain_relative_err * sensor.gain_e_per_dn,
            read_noise_e=sensor.read_noise_e,
            read_noise_e_err=0.0,
            black_level_dn=sensor.black_level_dn,
            frames_averaged=self.frames,
        )

    def study(self, psf: PsfCalibration, rng: np.random.Generator) -> PlanStudy:
        """What ``plan_study`` says beforehand."""
        return standoff.plan_study(
            self.capture_plan,
            self.config,
            psf,
            photographs=self.scenes(rng, 24),
            photograph_count=self.photographs,
            noise=self.noise,
            focus_scatter_px2=self.focus_scatter_px2,
            height_scatter_mm=self.height_scatter_mm,
            contrast_dn=self.contrast_dn,
            min_d_prime=self.min_d_prime,
        )

    def scenes(self, rng: np.random.Generator, count: int) -> list[Image]:
        """Photographs of the scene, 160 px wide and high, anywhere in it."""
        from skimage import data

        whole = np.asarray(getattr(data, self.scene)(), dtype=np.float64)
        found = []
        for _ in range(count):
            top, left = (int(rng.integers(size - 160 + 1)) for size in whole.shape)
            part = whole[top : top + 160, left : left + 160]
            found.append(200.0 + 8.0 * np.rot90(part, int(rng.integers(4))))
        return found


def capture(
    truth: BenchTruth, session: StudiedSession, entry: PlanEntry, rng: np.random.Generator
) -> tuple[Image, Image]:
    """Mean and variance of the frames of one capture."""
    light = truth.irradiance(
        entry.target, entry.orientation_deg, CameraPose(height_mm=entry.height_mm)
    )
    electrons = truth.sensor.electrons(light, session.exposure_us)
    frames = np.stack(
        [truth.sensor.expose(electrons, 0.0, "Mono12", rng) for _ in range(session.frames)]
    ).astype(np.float64)
    return frames.mean(axis=0), frames.var(axis=0, ddof=1)


def calibrated(session: StudiedSession, rng: np.random.Generator) -> PsfCalibration:
    """The PSF of one repetition."""
    steady = session.truth()
    images = []
    for entry in session.entries:
        if entry.kind != "edge":
            continue
        drawn = session.focus_scatter_px2 * float(rng.standard_normal())
        mean, variance = capture(session.truth(drawn) if drawn else steady, session, entry, rng)
        noise = fit_level_noise(mean, variance, ADC_MAX_DN).averaged(session.frames)
        images.append(
            EdgeImage(
                name=entry.stem,
                image_dn=mean,
                capture=entry.index,
                height_mm=entry.height_mm,
                noise=noise,
                saturation_dn=float(ADC_MAX_DN),
            )
        )
    return psf_of_images(images)


def _pupil_offset_mm(
    session: StudiedSession, truth: BenchTruth, rng: np.random.Generator
) -> float | None:
    """The pupil offset of one repetition; None without captures of a board."""
    captures = [
        GeometryCapture(
            name=entry.stem,
            kind="board",
            target=entry.target,
            orientation_deg=entry.orientation_deg,
            height_mm=entry.height_mm + session.height_scatter_mm * float(rng.standard_normal()),
            image=capture(truth, session, entry, rng)[0],
        )
        for entry in session.entries
        if entry.kind == "board"
    ]
    if not captures:
        return None
    optics = session.config.optics
    focal_px = 1000 * optics.focal_length_mm / optics.pixel_pitch_um
    return geometry_of_captures(
        captures, GeometryOptions(nominal_focal_px=focal_px)
    ).pupil_offset_mm


@dataclass(frozen=True, slots=True, kw_only=True)
class _ChangeCurves:
    """Curves of d' of a session's photographs, at no more zooms than d' and tilt need."""

    session: StudiedSession
    zooms: tuple[float, ...] = ZOOMS

    def curve(self, psf: Psf, rng: np.random.Generator, noise_dn: float) -> DetectabilityCurve:
        """Curve of photographs that were not seen before."""
        session = self.session
        task = DetectionTask(
            signal=GaussianSignal(sigma_px=2.0),
            contrasts_dn=(session.contrast_dn,),
            noises_dn=(noise_dn,),
            zooms=self.zooms,
            models=("matched",),
            observers=("hotelling",),
        )
        return curves_of_images(session.scenes(rng, session.photographs), psf, task).curves[0]

    def about(self, curve: DetectabilityCurve) -> "_ChangeCurves":
        """Return the same with the zooms next to where a curve falls below the threshold."""
        below = int(np.sum(np.array(curve.dprime) >= self.session.min_d_prime))
        near = ZOOMS[max(below - 2, 0) : below + 2]
        return replace(self, zooms=tuple(sorted({1.0, 1.5, *near})))

    def d_prime_and_tilt(
        self, psf: Psf, rng: np.random.Generator, noise_dn: float
    ) -> tuple[float, float]:
        """Return d' at zoom 1.5 and the tilt limit of one repetition."""
        session = self.session
        curve = self.curve(psf, rng, noise_dn)
        optics, known = session.config.optics, session.config.simulated
        assert known is not None
        camera = ViewingCamera(
            focal_length_px=1000 * optics.focal_length_mm / optics.pixel_pitch_um,
            width_px=known.width_px,
            height_px=known.height_px,
        )
        limits = limits_of_curve(curve, session.min_d_prime, camera)
        return curve.dprime[self.zooms.index(1.5)], limits.tilt_deg or 0.0


def achieved(
    session: StudiedSession, repetitions: int, boards: int, seed: tuple[int, int]
) -> dict[str, Sequence[float]]:
    """Values of every quantity over the repetitions; the board is captured in fewer of them."""
    rng = np.random.default_rng(seed)
    truth = session.truth()
    mean_dn = float(np.mean([one.mean() for one in session.scenes(np.random.default_rng(0), 24)]))
    sensor = truth.sensor
    changes = _ChangeCurves(session=session)
    found: dict[str, list[float]] = {}

    def keep(name: str, value: float | None) -> None:
        if value is not None:
            found.setdefault(name, []).append(value)

    for number in range(repetitions):
        psf = calibrated(session, rng)
        keep("sigma_x_px", psf.sigma_x_px)
        keep("sigma_y_px", psf.sigma_y_px)
        if psf.transfer_2d is not None:
            keep("transfer_x", float(psf.transfer_2d.otf(*QUARTER)[0]))
            keep("transfer_y", float(psf.transfer_2d.otf(*QUARTER[::-1])[0]))
        if number < boards:
            keep("pupil_offset_mm", _pupil_offset_mm(session, truth, rng))
        gain = sensor.gain_e_per_dn * (1 + session.gain_relative_err * float(rng.standard_normal()))
        variance = (mean_dn - sensor.black_level_dn) / gain + (sensor.read_noise_e / gain) ** 2
        noise_dn = sqrt((variance + 1 / 12) / session.frames)
        best = psf.best_psf("psf")
        if number == 0:
            changes = changes.about(changes.curve(best, rng, noise_dn))
        d_prime, tilt = changes.d_prime_and_tilt(best, rng, noise_dn)
        keep("d_prime", d_prime)
        keep("tilt_limit_deg", tilt)
    return {name: tuple(values) for name, values in found.items()}
