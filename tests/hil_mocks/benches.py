"""Benches for the tests: small, and each with one thing changed."""

from typing import Any

from acquisition.bench import BenchConfig
from hil_mocks import SimulatedBench

SMALL_BENCH: dict[str, dict[str, Any]] = {
    "camera": {
        "driver": "simulated",
        "pixel_format": "Mono12",
        "exposure_us": 8000.0,
        "gain_db": 0.0,
        "frame_rate_hz": 50.0,
    },
    "stage": {
        "driver": "simulated",
        "limits_mm": [10.0, 400.0],
        "feed_mm_per_min": 1200.0,
        "settle_s": 0.5,
    },
    "optics": {"focal_length_mm": 8.0, "pixel_pitch_um": 8.3},
    "simulated": {"width_px": 96, "height_px": 64, "full_well_e": 30000.0},
}


def bench_config(**keys: object) -> BenchConfig:
    """The small bench with single keys, as ``camera__gain_db=6.0``, or whole tables replaced."""
    table: dict[str, Any] = {section: dict(values) for section, values in SMALL_BENCH.items()}
    for key, value in keys.items():
        section, _, name = key.partition("__")
        if name:
            table[section][name] = value
        else:
            table[section] = value
    return BenchConfig.model_validate(table)


def homed_bench(**keys: object) -> SimulatedBench:
    """The small bench of these keys, homed and at 200 mm."""
    bench = SimulatedBench(bench_config(**keys))
    bench.stage.home(60)
    bench.stage.move_to(200.0, 60)
    return bench
