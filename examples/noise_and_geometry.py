"""What a camera's noise is, and where it looks from: two capture sessions on a bench.

    python examples/noise_and_geometry.py [--bench bench.toml] [--out FOLDER]

A script in cells: Jupyter and most editors run it cell by cell. Without a bench file it takes a
small simulated one. On a real bench, cover the lens for the first target when you are asked to.
"""

# %% A bench
import argparse
from pathlib import Path

import standoff

parser = argparse.ArgumentParser(description="Noise and geometry of a camera on its stage.")
parser.add_argument("--bench", type=Path, help="bench file; a simulated bench without it")
parser.add_argument("--out", type=Path, default=Path("noise-and-geometry"))
given = parser.parse_args()
given.out.mkdir(parents=True, exist_ok=True)

SIMULATED = """
[camera]
driver = "simulated"
pixel_format = "Mono12"
exposure_us = 12000.0
gain_db = 0.0
frame_rate_hz = 60.0

[stage]
driver = "simulated"
limits_mm = [120.0, 620.0]

[optics]
focal_length_mm = 8.0
pixel_pitch_um = 20.0

[simulated]
width_px = 320
height_px = 240
optical_sigma_x_px = 0.7
optical_sigma_y_px = 0.6
pupil_offset_mm = 12.5
"""
if given.bench is None:
    given.bench = given.out / "bench.toml"
    given.bench.write_text(SIMULATED)

# %% A dark, and flats at several exposures
NOISE_PLAN = """
schema = "standoff.plan/1"
name = "noise"
heights_mm = [200.0]

[[targets]]
kind = "dark"
target = "dark"
exposure_us = [21.0, 8000.0]

[[targets]]
kind = "flat"
target = "flat"
exposure_us = [1000.0, 2000.0, 4000.0, 6000.0, 8000.0, 16000.0]
"""
plan = given.out / "noise-plan.toml"
plan.write_text(NOISE_PLAN)
with standoff.Bench(given.bench) as bench:
    bench.home()
    flats = bench.run(plan, given.out / "flats")
    series = bench.sweep(
        [160, 220, 300], given.out / "board", target="board", kind="board", orientation_deg=5
    )

# %% Photon transfer
noise = standoff.measure_noise(flats, report=given.out / "noise.html")
standoff.write_noise(given.out / "noise.json", noise)
print(noise)

# %% The geometry of the height series
geometry = standoff.calibrate_geometry(series, report=given.out / "geometry.html")
standoff.write_geometry(given.out / "geometry.json", geometry)
print(geometry)
for excluded in geometry.excluded:
    print(f"{excluded.image} is left out: {excluded.reason}")
low, high = series.records[0].height_mm, series.records[-1].height_mm
print(f"from {low:g} to {high:g} mm the scene is {geometry.zoom(low, high):.4f} times smaller")
