"""How often the 95 % interval of a focus sweep covers the truth, and how wide it is.

The figures of a sweep are those of the simulated bench: its views of an edge and of a print, by
f-number, give the focus value at heights 5 mm apart, between which a spline goes, and draws of the
sensor's noise give the scatter of the mean of the frames and of single ones. Sweeps are then drawn
from these, each with its own noise, heights and errors, so that a thousand cost what a few would in
pixels.

The pupil is 12.5 mm above height 0 and the focus at 287.5 mm; the ranges lie on both sides of
the peak, evenly and unevenly, and nearly on one. ``known`` is with a geometry (± 0.03 mm),
``unknown`` without. Sweeps that are refused, with a line that says why, are counted apart.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from acquisition.bench import load_bench
from acquisition.focus import (
    UNKNOWN_PUPIL,
    FocusPeak,
    NoFocusPeakError,
    PupilOffset,
    fit_focus_peak,
    focus_value,
    pooled_errs,
    texture_share,
)
from benchmarks.harness import Recorder, benchmark
from hil_mocks.truth import BenchTruth, CameraPose
from simulation.arrays import Float32Array, FloatArray

PUPIL_MM, FOCUS_MM = 12.5, 287.5
F_NUMBERS = (1.4, 2.0, 2.8, 4.0, 5.6, 8.0)
RANGES_MM = (
    (-20, 20), (-30, 30), (-60, 60), (-100, 100), (-10, 40), (-40, 10), (-20, 80), (-70, 25),
)  # fmt: skip
"""Lowest and highest height from the focus."""

PUPILS = {"known": PupilOffset(offset_mm=PUPIL_MM, err_mm=0.03), "unknown": UNKNOWN_PUPIL}
EXPOSURE_US, STEPS, GRID_MM, NOISE_DRAWS = 9000.0, 15, 5.0, 5
CONFIGS = Path(__file__).parents[2] / "configs"


@dataclass(frozen=True, slots=True, eq=False)
class _Figures:
    """Focus value by height, its scatter in one frame and in the mean of several, and the share."""

    f_number: float
    value: CubicSpline
    single: FloatArray
    mean: FloatArray
    texture_share: float

    @classmethod
    def of_bench(cls, target: str, f_number: float, frames: int, seed: int) -> "_Figures":
        """Render the views of a target and take their figures."""
        keys = {"width_px": 390, "height_px": 290, "f_number": f_number, "focus_distance_mm": 300.0}
        truth = BenchTruth(
            load_bench(
                CONFIGS / "simulated.toml",
                {f"simulated.{key}": value for key, value in keys.items()},
            )
        )
        rng = np.random.default_rng([seed, round(10 * f_number)])
        heights = np.arange(175.0, 405.0, GRID_MM)
        views = [
            truth.irradiance(target, 5.0, CameraPose(height_mm=float(each))) for each in heights
        ]
        values = np.array([focus_value(view, black_level_dn=0.0) for view in views])
        scatter = np.array([[_scatter(truth, view, n, rng) for n in (1, frames)] for view in views])
        sharpest = views[int(np.argmax(values))]
        # Symmetric in 1 / distance, where it is smoothest.
        by_inverse = CubicSpline(1 / (heights + PUPIL_MM)[::-1], np.log(values[::-1]))
        single, mean = np.polynomial.polynomial.polyfit(heights - FOCUS_MM, np.log(scatter), 2).T
        return cls(f_number, by_inverse, single, mean, texture_share(sharpest))

    def sweep(
        self, heights_mm: FloatArray, frames: int, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Focus values of one sweep, and their standard errors from the scatter of its frames."""
        clean = np.exp(self.value(1 / (heights_mm + PUPIL_MM)))
        single, mean = (
            np.exp(np.polynomial.polynomial.polyval(heights_mm - FOCUS_MM, each))
            for each in (self.single, self.mean)
        )
        values = clean + mean * rng.standard_normal(heights_mm.size)
        drawn = rng.chisquare(frames - 1, heights_mm.size) / (frames - 1)
        return values, single * np.sqrt(drawn / frames)


def _scatter(truth: BenchTruth, view: Float32Array, frames: int, rng: np.random.Generator) -> float:
    sensor = truth.sensor
    electrons = sensor.white_e_per_us * EXPOSURE_US * view.astype(np.float64)
    noise_e = np.sqrt((electrons + sensor.read_noise_e**2) / frames)
    values = [
        focus_value(
            electrons + noise_e * rng.standard_normal(view.shape),
            black_level_dn=0.0,
            noise_variance_dn2=float(np.mean(noise_e**2)),
        )
        for _ in range(NOISE_DRAWS)
    ]
    return float(np.std(values, ddof=1))


def _peaks_of(
    figures: _Figures, range_mm: tuple[int, int], pupil: PupilOffset, frames: int, draws: int
) -> list[FocusPeak]:
    """The peaks of the sweeps that are not refused."""
    low, high = range_mm
    rng = np.random.default_rng([frames, low + 1000, high, round(10 * figures.f_number)])
    found = []
    for _ in range(draws):
        moved = rng.uniform(-0.5, 0.5) * (high - low) / (STEPS - 1)
        heights_mm = np.round(FOCUS_MM + moved + np.linspace(low, high, STEPS), 3)
        values, errs = figures.sweep(heights_mm, frames, rng)
        try:
            peak = fit_focus_peak(
                heights_mm,
                values,
                pooled_errs(errs, frames),
                pupil=pupil,
                texture_share=figures.texture_share,
            )
        except NoFocusPeakError:
            continue
        found.append(peak)
    return found


def _coverage(
    record: Recorder, target: str, frames: int, draws: int, f_numbers: Sequence[float]
) -> None:
    figures = {f: _Figures.of_bench(target, f, frames, 1) for f in f_numbers}
    for name, pupil in PUPILS.items():
        record.say(
            f"\n{target}, mean of {frames} frames, pupil {name}: covered / %, mean half-interval"
        )
        record.say("  f/     sweeps  refused  covered  rms error / mm  half interval / mm")
        covered = total = 0
        for f in f_numbers:
            peaks = [
                peak
                for range_mm in RANGES_MM
                for peak in _peaks_of(figures[f], range_mm, pupil, frames, draws)
            ]
            asked = draws * len(RANGES_MM)
            if not peaks:
                record.say(f"  {f:4.1f} {asked:8d} {asked:8d}")
                continue
            errors = np.array([peak.height_mm - FOCUS_MM for peak in peaks])
            halves = 1.96 * np.array([peak.err_mm for peak in peaks])
            inside = int(np.sum(np.abs(errors) <= halves))
            covered, total = covered + inside, total + len(peaks)
            record.say(
                f"  {f:4.1f} {asked:8d} {asked - len(peaks):8d} {100 * inside / len(peaks):8.1f} "
                f"{np.sqrt(np.mean(errors**2)):15.3f} {np.mean(halves):19.3f}"
            )
        what = f"focus sweep of {target}, {frames} frames, pupil {name}"
        record.figure(f"intervals that cover, {what}", 100 * covered / max(total, 1), "%")
        record.say(f"  of {total} intervals {100 * covered / max(total, 1):.1f} % cover")


@benchmark("numpy", "scipy")
def main(record: Recorder) -> None:
    draws = record.pick(40, 2)
    f_numbers = record.pick(F_NUMBERS, (1.4, 4.0))
    _coverage(record, "edge", 10, draws, f_numbers)
    _coverage(record, "edge", 2, draws // 2, f_numbers)
    _coverage(record, "coins", 10, draws // 2, f_numbers)
