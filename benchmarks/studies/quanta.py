"""Noise-equivalent quanta against d' of a comparison: ten cameras of the simulated bench.

Each camera has another lens (Gaussian, turned, 0.4 to 1.1 px), gain, read noise and exposure. A
session of it is carried out: edges in four directions, darks and flats. From the calibrated PSF and
noise NEQ predicts Hotelling's d' of a spot between two photographs from one distance (zoom 1),
which ``analysis.detectability`` computes from operators on pixels, with the model ``lmmse``, which
is right for any lens, and with ``matched``. The last column is NEQ with the lens and the noise that
the bench states: how far the calibration itself is off.

    python -m benchmarks.studies.quanta
"""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from math import pi, sqrt
from pathlib import Path
from typing import Annotated

import numpy as np

import standoff
from analysis.detectability import (
    GaussianSignal,
    Scenario,
    local_changes,
)
from benchmarks.harness import Recorder, benchmark
from calibration.capacity import NoisePower, SignalAndNoise, Transfer, ideal_observer_snr
from simulation.arrays import FloatArray
from simulation.choices import Model
from simulation.psf import GaussianPsf, Psf

CONFIG = Path(__file__).parents[2] / "configs" / "simulated.toml"
CAMERAS = 10
SPOT_PX, REFERENCE_ZOOM, WINDOW_PX = 2.0, 2.0, 33
LEVEL_DN = 1500.0
PLAN = """
schema = "standoff.plan/1"
name = "quanta"
heights_mm = [200]
frames_per_capture = 4

[[targets]]
kind = "edge"
target = "edge"
orientations_deg = [5, 50, 95, 140]

[[targets]]
kind = "dark"
target = "dark"
exposure_us = [21, 9000]

[[targets]]
kind = "flat"
target = "flat"
exposure_us = [1500, 3000, 6000, 9000, 12000, 17000]
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotographedSpot:
    """The object that a nearer photograph shows as a Gaussian spot of peak 1.

    In px of the reference, which is ``zoom`` times as far away as that photograph.
    """

    sigma_px: float
    zoom: float
    transfer: Transfer

    @property
    def extent_px(self) -> float:
        """Where it has vanished."""
        return 6.0 * self.sigma_px

    def spectrum(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """Spectrum of the spot over the transfer that has blurred it, farther away."""
        near_x, near_y = fx / self.zoom, fy / self.zoom
        variance = self.sigma_px**2
        shown = 2 * pi * variance * np.exp(-2 * pi**2 * variance * (near_x**2 + near_y**2))
        return np.asarray(shown / (self.zoom**2 * self.transfer(near_x, near_y)))


def predicted(transfer: Transfer, noise_dn: float) -> float:
    """D' of the spot of 1 DN by NEQ; both photographs have the noise."""
    camera = SignalAndNoise(
        transfer=transfer, noise=NoisePower(variance_dn2=2 * noise_dn**2), signal_dn=1.0
    )
    spot = PhotographedSpot(sigma_px=SPOT_PX, zoom=REFERENCE_ZOOM, transfer=transfer)
    return ideal_observer_snr(camera, spot)


def hotelling(psf: Psf, noise_dn: float, model: Model) -> float:
    """D' by the operators: at zoom 1 the alignment changes nothing, and the noise is white."""
    scenario = Scenario(psf=psf, reference_zoom=REFERENCE_ZOOM, window_px=WINDOW_PX, positions=16)
    changes = local_changes(GaussianSignal(sigma_px=SPOT_PX), scenario, model, 1.0)
    found = []
    for change in changes:
        unit = change.signal / np.sqrt(np.sum(change.signal**2))
        seen = float(np.sum(unit * change.signal))
        found.append(seen / (noise_dn * sqrt(change.noise_variance(unit))))
    return float(np.sqrt(np.mean(np.square(found))))


def settings(number: int) -> dict[str, float | str]:
    """What differs from camera to camera, drawn once."""
    rng = np.random.default_rng([1288, number])
    wide = rng.uniform(0.45, 1.0)
    return {
        "simulated.seed": number + 1,
        "simulated.width_px": 300,
        "simulated.height_px": 220,
        "simulated.corner_sigma_gain": 0.0,
        "simulated.vignetting": 0.0,
        "simulated.k1": 0.0,
        "simulated.optical_sigma_x_px": round(wide, 3),
        "simulated.optical_sigma_y_px": round(wide * rng.uniform(0.8, 1.2), 3),
        "simulated.optical_rho": round(rng.uniform(-0.2, 0.2), 3),
        "simulated.gain_e_per_dn": round(rng.uniform(4.6, 6.0), 2),
        "simulated.read_noise_e": round(rng.uniform(5.0, 30.0), 1),
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """d' of one camera: by NEQ, by both models, and by NEQ of what the bench states."""

    by_neq: float
    by_lmmse: float
    by_matched: float
    by_truth: float


def compared(count: int) -> Iterator[tuple[dict[str, float | str], Compared]]:
    """Capture, calibrate and compare so many cameras."""
    with tempfile.TemporaryDirectory() as folder:
        plan = Path(folder) / "plan.toml"
        plan.write_text(PLAN, encoding="utf-8")
        for number in range(count):
            known = settings(number)
            out = Path(folder) / f"camera-{number}"
            standoff.capture_session(plan, CONFIG, out, settings=known)
            session = standoff.Session(out)
            psf = standoff.calibrate_psf(session).best_psf("psf")
            noise = standoff.measure_noise(session).calibration.capture_noise
            noise_dn = sqrt(float(noise.variance_dn2(np.array(noise.black_level_dn + LEVEL_DN))))
            gain, read = (
                float(known["simulated.gain_e_per_dn"]),
                float(known["simulated.read_noise_e"]),
            )
            true_dn = sqrt((LEVEL_DN / gain + (read / gain) ** 2 + 1 / 12) / noise.frames_averaged)
            yield (
                known,
                Compared(
                    by_neq=predicted(psf.otf, noise_dn),
                    by_lmmse=hotelling(psf, noise_dn, "lmmse"),
                    by_matched=hotelling(psf, noise_dn, "matched"),
                    by_truth=predicted(_true_transfer(known), true_dn),
                ),
            )


def _true_transfer(known: dict[str, float | str]) -> Transfer:
    lens = GaussianPsf(
        sigma_x_px=float(known["simulated.optical_sigma_x_px"]),
        sigma_y_px=float(known["simulated.optical_sigma_y_px"]),
        rho=float(known["simulated.optical_rho"]),
    )

    def transfer(fx: FloatArray, fy: FloatArray) -> FloatArray:
        return np.asarray(lens.otf(fx, fy) * np.sinc(fx) * np.sinc(fy))

    return transfer


@benchmark("numpy", "scipy", note="spot of 2 px, reference at zoom 2")
def main(record: Recorder, *, cameras: Annotated[int, "to simulate"] = CAMERAS) -> None:
    """Compare camera by camera."""
    record.say(
        "sigma x, y, rho; read noise:  d' by NEQ / lmmse - 1, / matched - 1, / truth - 1 in %"
    )
    away: dict[str, list[float]] = {"lmmse": [], "matched": [], "the bench's truth": []}
    for known, found in compared(2 if record.is_quick else cameras):
        pair = (found.by_lmmse, found.by_matched, found.by_truth)
        percent = [100 * (found.by_neq / other - 1) for other in pair]
        for name, value in zip(away, percent, strict=True):
            away[name].append(abs(value))
        lens = "  ".join(f"{known[f'simulated.optical_{key}']:6.3f}"
                         for key in ("sigma_x_px", "sigma_y_px", "rho"))  # fmt: skip
        said = "  ".join(f"{value:+6.2f}" for value in percent)
        record.say(f"{lens}  {known['simulated.read_noise_e']:5.1f}   {said}")
    for name, values in away.items():
        record.figure(f"d' by NEQ against {name}, largest difference", max(values), "%")
