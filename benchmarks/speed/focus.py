"""Focus measures: time against a copy of the frame, and which finds the peak best.

Run with ``python -m benchmarks.speed.focus``. The first table is the time of a full Mono12 frame;
the others the error of the peak, in percent of the travel, on the simulated bench: a single frame
and the mean of ten, which the command takes, of an edge and of a textured print at 15 heights, by
signal-to-noise ratio of white paper in one frame, with and without an exposure that drifts by 20 %
over the sweep. "refused" counts sweeps without peak.
"""

from functools import partial
from pathlib import Path

import numpy as np

from acquisition.bench import load_bench
from acquisition.choices import FocusMeasure
from acquisition.focus import FOCUS_MEASURES, NoFocusPeakError, fit_focus_peak, focus_value
from benchmarks.harness import Recorder, benchmark, medians_s
from hil_mocks.truth import BenchTruth, CameraPose
from simulation.arrays import Float32Array

ROUNDS, SEEDS = 200, 16
STEP_MM, STEPS, FOCUS_MM = 7.0, 15, 306.4
TRAVEL_MM = STEP_MM * (STEPS - 1)
MIDDLES_MM = (294.0, 301.0, 308.0, 315.0)
Views = dict[tuple[str, float], Float32Array]
CONFIGS = Path(__file__).parents[2] / "configs"


def _compare_times(record: Recorder) -> None:
    frame = np.random.default_rng(1).integers(0, 4096, (580, 780)).astype(np.uint16)
    measures = [
        partial(focus_value, frame, black_level_dn=64, measure=name) for name in FOCUS_MEASURES
    ]
    copy_s, *times_s = medians_s([frame.copy, *measures], record.pick(ROUNDS, 50))
    for name, ours_s in zip(FOCUS_MEASURES, times_s, strict=True):
        record.figure(
            f"focus of a frame, {name}", 1e6 * ours_s, "us", "a copy of the frame", 1e6 * copy_s
        )


def _truth_of_bench() -> BenchTruth:
    """A lens of f/1 that is focused at one distance, on a small sensor."""
    keys = {
        "width_px": 390,
        "height_px": 290,
        "corner_sigma_gain": 0.0,
        "f_number": 1.0,
        "focus_distance_mm": FOCUS_MM + 12.5,
    }
    return BenchTruth(
        load_bench(
            CONFIGS / "simulated.toml", {f"simulated.{key}": value for key, value in keys.items()}
        )
    )


def _sweep_errors(
    truth: BenchTruth,
    views: Views,
    target: str,
    measure: FocusMeasure,
    snr: float,
    drift: float,
    frames: int,
    seeds: int,
) -> tuple[float, float, int]:
    """RMS and worst error in percent of the travel, and the number of refused sweeps."""
    errors, refused = [], 0
    for seed in range(seeds):
        rng = np.random.default_rng([seed, round(snr), frames])
        heights = MIDDLES_MM[seed % 4] + STEP_MM * (np.arange(STEPS) - STEPS // 2)
        exposure_us = snr**2 / 1.5 * np.linspace(1 - drift / 2, 1 + drift / 2, STEPS)
        values = []
        for height_mm, exposure in zip(heights, exposure_us, strict=True):
            if (target, height_mm) not in views:
                pose = CameraPose(height_mm=float(height_mm))
                views[target, height_mm] = truth.irradiance(target, 5.0, pose)
            clean = 64.0 + views[target, height_mm] * (1.5 * exposure / 5.0)
            spread = np.sqrt(((clean - 64.0) / 5.0 + 12.0**2 / 25) / frames)
            variance = float(np.mean(spread**2))
            values.append(
                focus_value(
                    clean + spread * rng.standard_normal(clean.shape),
                    black_level_dn=64.0,
                    noise_variance_dn2=variance,
                    measure=measure,
                )
            )
        try:
            peak = fit_focus_peak(heights.astype(np.float64), np.array(values))
        except NoFocusPeakError:
            refused += 1
        else:
            errors.append(100 * (peak.height_mm - FOCUS_MM) / TRAVEL_MM)
    if not errors:
        return float("nan"), float("nan"), refused
    return float(np.sqrt(np.mean(np.square(errors)))), float(np.max(np.abs(errors))), refused


def _compare_peaks(record: Recorder) -> None:
    truth, seeds = _truth_of_bench(), record.pick(SEEDS, 4)
    views: Views = {}
    levels = record.pick((100.0, 50.0, 20.0, 10.0), (20.0,))
    cases = [(snr, drift) for snr in levels for drift in (0.0, 0.2)]
    for frames, target in ((1, "edge"), (1, "coins"), (10, "edge"), (10, "coins")):
        record.say(
            f"\n{target}, mean of {frames}: rms / worst error of the peak in % of the travel"
        )
        record.say(" " * 18 + "".join(f"      SNR {s:3.0f} {100 * d:2.0f} %" for s, d in cases))
        for name in FOCUS_MEASURES:
            cells = [
                _sweep_errors(truth, views, target, name, *case, frames, seeds) for case in cases
            ]
            line = "".join(f" {rms:5.2f} /{worst:5.2f} ({bad:2d})" for rms, worst, bad in cells)
            record.say(f"{name:18s}{line}")
            for (snr, drift), (rms, _, _) in zip(cases, cells, strict=True):
                if snr == 20.0 and drift:
                    record.figure(
                        f"error of the focus peak, {name}, {target}, mean of {frames}, "
                        f"SNR {snr:g}, light drifts by {100 * drift:.0f} %",
                        rms,
                        "% of the travel",
                    )


@benchmark("numpy", "numba")
def main(record: Recorder) -> None:
    _compare_times(record)
    _compare_peaks(record)
