"""How well each model predicts what the camera sees from further away: the paper's Table II.

    python examples/how_well_is_it_simulated.py [--session SESSION] [--out FOLDER]

A script in cells: Jupyter and most editors run it cell by cell. Without a capture session it
captures one on a small simulated bench: edges for the PSF, and coins at three heights.
"""

# %% A session with edges and a textured target
import argparse
from pathlib import Path

import standoff

parser = argparse.ArgumentParser(description="Simulated against captured follow-ups.")
parser.add_argument("--session", type=Path, help="a session with edges and a texture")
parser.add_argument("--out", type=Path, default=Path("how-well-is-it-simulated"))
given = parser.parse_args()
given.out.mkdir(parents=True, exist_ok=True)

BENCH = """
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
pixel_pitch_um = 16.0

[simulated]
width_px = 400
height_px = 300
optical_sigma_x_px = 0.7
optical_sigma_y_px = 0.6
"""
PLAN = """
schema = "standoff.plan/1"
name = "edges and coins"
heights_mm = [180.0, 250.0, 340.0]

[[targets]]
kind = "edge"
target = "edge"
orientations_deg = [5.0, 50.0, 95.0, 140.0]
heights_mm = [180.0]

[[targets]]
kind = "texture"
target = "coins"
"""
if given.session is None:
    given.session = given.out / "session"
    (given.out / "bench.toml").write_text(BENCH)
    (given.out / "plan.toml").write_text(PLAN)
    with standoff.Bench(given.out / "bench.toml") as bench:
        bench.home()
        bench.run(given.out / "plan.toml", given.session)
session = standoff.Session(given.session)

# %% The camera's PSF, for the centre of the frame
psf = standoff.calibrate_psf(session, region="centre")
print(psf)
standoff.write_psf(given.out / "psf.json", psf)

# %% Tables I and II, Figures 2 and 3
found = standoff.validate(
    session,
    given.out / "psf.json",
    given.out / "validation",
    models=["bicubic", "paper", "matched", "lmmse"],
)
for model, mean in found.means("followup-grid").items():
    print(f"{model}: correlation {mean.correlation:.4f}, MSE {mean.mse_dn2:.2f}")
print(f"wrote {given.out / 'validation' / 'report.html'}")
