"""How sure the PSF is: 95 % intervals with a focus that scatters, and a target that is soft.

Truth: a Gaussian lens before square pixels that sees a few dark squares, in closed form (products
of error functions, pixels averaged by quadrature: benchmarks/truth/edges.py), with noise. Each
capture adds a variance of its own to the lens: normal, of a standard deviation of 0, 0.05, 0.10 or
0.15 px^2. Every calibration has 4 to 12 captures of two squares each, turned at random. An interval
covers where it holds the width of the mean variance, of the lens and in total, and the transfer of
the same lens at half Nyquist (0.25 cy/px), in four directions. The total width of a Gaussian lens
with a square pixel is that of the Gaussian that fits an edge best, which has no closed form: it is
that of edges without noise.

Softness: five heights, each with two squares of one target of 40 mm, whose blur is constant in mm;
the scale is 964 px over the distance in mm, as on the simulated bench, 12.5 mm from the heights.

    python -m benchmarks.studies.psf_coverage
"""

from dataclasses import dataclass
from functools import cache
from itertools import product
from math import hypot, pi, sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.bench import load_bench
from benchmarks.harness import Recorder, benchmark
from benchmarks.truth.edges import Rectangle, patches, white_noise
from calibration.edges import EdgeImage, edges_of_image
from calibration.psf import PsfCalibration, PsfEstimates, psf_of_images
from hil_mocks.truth import BenchTruth, CameraPose, Edge, Placed
from simulation.arrays import BoolArray, FloatArray

LENS_PX2 = 0.62**2
GROUND_DN, DARK_DN = 3000.0, 600.0
CONTRAST_DN = GROUND_DN - DARK_DN
SCATTERS_PX2 = (0.0, 0.05, 0.10, 0.15)
SNRS = (100.0, 30.0)
HALF_NYQUIST = 0.25
ANGLES_RAD = np.deg2rad([0.0, 45.0, 90.0, 135.0])
HEIGHTS_MM = (180.0, 220.0, 270.0, 330.0, 400.0)
PX_MM, PUPIL_MM = 8.0 / 8.3e-3, 12.5
SIDE_MM = 10.0
CONFIG = Path(__file__).parents[2] / "configs" / "demo_bench.toml"
BENCH_NOISE_DN = 24.0
BLURS_MM = (0.0, 0.05, 0.1, 0.2, 0.3)


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """One capture: the variance of its lens, half the side of its squares, and its noise."""

    lens_px2: float
    half_px: float
    snr: float
    capture: int
    height_mm: float | None = None


def photographed(shot: Shot, rng: np.random.Generator) -> EdgeImage:
    """Two squares beside each other, turned by any angle, in noise that is known."""
    reach = int(1.5 * shot.half_px) + 14
    squares = [
        Rectangle(
            x_px=x * reach + rng.uniform(-0.5, 0.5),
            y_px=reach + rng.uniform(-0.5, 0.5),
            half_px=(shot.half_px, shot.half_px),
            angle_rad=rng.uniform(0.0, pi / 2),
            level_dn=DARK_DN,
        )
        for x in (1, 3)
    ]
    image = patches((2 * reach, 4 * reach), squares, GROUND_DN, sqrt(shot.lens_px2))
    noise_dn = CONTRAST_DN / shot.snr
    known = white_noise(noise_dn)
    return EdgeImage(
        name=f"capture {shot.capture}",
        image_dn=image + rng.normal(0.0, noise_dn, image.shape),
        capture=shot.capture,
        height_mm=shot.height_mm,
        noise=known,
    )


@cache
def _total_px2() -> float:
    """Mean squared total width of edges of the lens in all directions, nearly without noise."""
    rng = np.random.default_rng(0)
    shots = [Shot(lens_px2=LENS_PX2, half_px=22.0, snr=1e4, capture=k) for k in range(24)]
    edges = [edge for shot in shots for edge in edges_of_image(photographed(shot, rng))]
    return float(np.mean([edge.sigma_px**2 for edge in edges]))


def _holds(estimates: PsfEstimates, truth_px2: float) -> list[bool]:
    """Whether the intervals of both widths hold the truth."""
    known = (estimates.sigma_x_px, estimates.sigma_y_px)
    return [one is not None and one.low <= sqrt(truth_px2) <= one.high for one in known]


def _calibrated(scatter_px2: float, snr: float, rng: np.random.Generator) -> PsfCalibration:
    """A calibration from 4 to 12 captures at one height."""
    captures = int(rng.integers(4, 13))
    offsets = rng.normal(0.0, scatter_px2, captures).tolist()
    shots = [
        Shot(lens_px2=max(LENS_PX2 + away, 0.02), half_px=22.0, snr=snr, capture=k)
        for k, away in enumerate(offsets)
    ]
    return psf_of_images(photographed(shot, rng) for shot in shots)


def _transfer(fx: FloatArray, fy: FloatArray) -> FloatArray:
    """The true transfer at the mean focus."""
    gauss = np.exp(-2 * pi**2 * LENS_PX2 * (fx**2 + fy**2))
    return np.asarray(gauss * np.sinc(fx) * np.sinc(fy))


def _coverage(record: Recorder, draws: int) -> None:
    """Shares of intervals that hold the truth."""
    fx, fy = HALF_NYQUIST * np.cos(ANGLES_RAD), HALF_NYQUIST * np.sin(ANGLES_RAD)
    truth = _transfer(fx, fy)
    for snr in SNRS:
        for scatter_px2 in SCATTERS_PX2:
            rng = np.random.default_rng([round(snr), round(100 * scatter_px2)])
            held: list[list[bool]] = []
            bands: list[BoolArray] = []
            found_px4: list[float] = []
            for _ in range(draws):
                psf = _calibrated(scatter_px2, snr, rng)
                held.append(_holds(psf.optical, LENS_PX2) + _holds(psf.total, _total_px2()))
                assert psf.transfer_2d is not None
                away = np.abs(psf.transfer_2d.otf(fx, fy) - truth)
                bands.append(away < 1.96 * psf.transfer_2d.otf_err(fx, fy))
                found_px4.append(0.0 if psf.focus is None else psf.focus.scatter_px2**2)
            lens_x, lens_y, x, y = (100 * np.mean(held, axis=0)).tolist()
            band = 100 * float(np.mean(bands))
            rms = sqrt(float(np.mean(found_px4)))
            record.say(
                f"SNR {snr:3.0f}, focus scatter {scatter_px2:.2f} px^2, {draws} calibrations: 95 % "
                f"intervals hold sigma_x {lens_x:.1f} %, sigma_y {lens_y:.1f} % of the lens, "
                f"{x:.1f} %, {y:.1f} % in total, transfer {band:.1f} %; found {rms:.3f} px^2"
            )
            name = f"SNR {snr:.0f}, scatter {scatter_px2:.2f} px^2"
            record.figure(f"sigma of the lens covered, {name}", (lens_x + lens_y) / 2, "%")
            record.figure(f"sigma covered, {name}", (x + y) / 2, "%")
            record.figure(f"transfer covered, {name}", band, "%")


def _soft(blur_mm: float, snr: float, rng: np.random.Generator) -> PsfCalibration:
    """A calibration over five heights from a target of this blur."""
    shots = []
    for k, height_mm in enumerate(HEIGHTS_MM):
        scale = PX_MM / (height_mm + PUPIL_MM)
        shots.append(
            Shot(
                lens_px2=LENS_PX2 + (blur_mm * scale) ** 2,
                half_px=SIDE_MM / 2 * scale,
                snr=snr,
                capture=k,
                height_mm=height_mm,
            )
        )
    return psf_of_images(photographed(shot, rng) for shot in shots)


def _softness(record: Recorder, draws: int) -> None:
    """Bias of the width, and how often a softness is taken off."""
    for snr in SNRS:
        for blur_mm in BLURS_MM:
            rng = np.random.default_rng([7, round(snr), round(1000 * blur_mm)])
            widths, held, removed = [], [], []
            for _ in range(draws):
                psf = _soft(blur_mm, snr, rng)
                optical = psf.optical
                assert optical.sigma_x_px is not None
                assert optical.sigma_y_px is not None
                widths.append([optical.sigma_x_px.value, optical.sigma_y_px.value])
                held.append(_holds(optical, LENS_PX2))
                removed.append(psf.target_softness is not None and psf.target_softness.is_removed)
            ratio = np.array(widths) / sqrt(LENS_PX2) - 1
            bias, scatter = 100 * float(ratio.mean()), 100 * float(ratio.std())
            record.say(
                f"SNR {snr:3.0f}, blur {blur_mm:.2f} mm, {draws} calibrations: sigma of the lens "
                f"off by {bias:+.2f} % in the mean, scatter {scatter:.2f} %, 95 % intervals hold "
                f"{100 * np.mean(held):.1f} %, taken off in {100 * np.mean(removed):.1f} %"
            )
            name = f"SNR {snr:.0f}, blur {blur_mm:.2f} mm"
            record.figure(f"bias of sigma, {name}", bias, "%")
            record.figure(f"taken off, {name}", 100 * float(np.mean(removed)), "%")


@dataclass(frozen=True, slots=True, kw_only=True)
class _SoftEdge:
    """The simulated bench's edge, printed with a blur."""

    blur_mm: float

    def reflectance(
        self, x_mm: FloatArray, y_mm: FloatArray, sigma_mm: float
    ) -> NDArray[np.float64]:
        """Two Gaussians in a row are one."""
        return Edge().reflectance(x_mm, y_mm, hypot(sigma_mm, self.blur_mm))  # type: ignore[return-value]


def _on_the_bench(record: Recorder, draws: int) -> None:
    """The same on the simulated bench: one long edge a capture, scales from the heights."""
    truth = BenchTruth(load_bench(CONFIG))
    lens_px2 = np.square([truth.settings.optical_sigma_x_px, truth.settings.optical_sigma_y_px])
    for blur_mm in BLURS_MM:
        views = [
            (
                k,
                height_mm,
                truth.renderer.irradiance(
                    Placed(scene=_SoftEdge(blur_mm=blur_mm), angle_deg=angle_deg),
                    CameraPose(height_mm=height_mm),
                ),
            )
            for k, (height_mm, angle_deg) in enumerate(
                product(HEIGHTS_MM, (5.0, 50.0, 95.0, 140.0))
            )
        ]
        ratios, removed = [], []
        for seed in range(draws):
            rng = np.random.default_rng([13, seed])
            psf = psf_of_images(
                EdgeImage(
                    name=f"capture {k}",
                    image_dn=GROUND_DN * view + rng.normal(0.0, BENCH_NOISE_DN, view.shape),
                    capture=k,
                    height_mm=height_mm,
                    noise=white_noise(BENCH_NOISE_DN),
                )
                for k, height_mm, view in views
            )
            ratios.append([psf.optical_sigma_x_px or 0.0, psf.optical_sigma_y_px or 0.0])
            removed.append(psf.target_softness is not None and psf.target_softness.is_removed)
        bias = 100 * (np.mean(ratios, axis=0) / np.sqrt(lens_px2) - 1)
        record.say(
            f"bench, blur {blur_mm:.2f} mm, {draws} calibrations of 20 captures: sigma of the "
            f"lens off by {bias[0]:+.2f} %, {bias[1]:+.2f} %, "
            f"taken off in {100 * np.mean(removed):.0f} %"
        )
        record.figure(
            f"bias of sigma on the bench, {blur_mm:.2f} mm", float(np.abs(bias).max()), "%"
        )


@benchmark("numpy", "scipy")
def main(record: Recorder) -> None:
    _on_the_bench(record, record.pick(8, 1))
    _softness(record, record.pick(40, 2))
    _coverage(record, record.pick(500, 3))
