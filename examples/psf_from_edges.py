"""The PSF of a camera from photographs of edges.

    python examples/psf_from_edges.py [EDGE.tif ...] [--out FOLDER]

A script in cells: Jupyter and most editors run it cell by cell. Without photographs it computes
edges whose blur is known, so that one sees how near the calibration comes.
"""

# %% Photographs, or edges of known blur
import argparse
from math import cos, radians, sin, sqrt
from pathlib import Path

import numpy as np
from scipy.special import ndtr

import standoff

parser = argparse.ArgumentParser(description="The PSF of a camera from photographs of edges.")
parser.add_argument("edges", nargs="*")
parser.add_argument("--out", type=Path, default=Path("psf-from-edges"))
given = parser.parse_args()
given.out.mkdir(parents=True, exist_ok=True)

TRUE = standoff.GaussianPsf(sigma_x_px=0.76, sigma_y_px=0.67, rho=0.12)
NOISE_DN = 0.5


def known_edge(angle_deg: float, rng: np.random.Generator) -> np.ndarray:
    """An edge of 20 and 235 DN whose blur across it is the Gaussian's width in that direction."""
    y, x = np.mgrid[-64.0:64.0, -64.0:64.0]
    normal = np.array([cos(radians(angle_deg)), sin(radians(angle_deg))])
    width_px = sqrt(normal @ TRUE.covariance_px2 @ normal)
    levels = 20 + 215 * ndtr((x * normal[0] + y * normal[1]) / width_px)
    return levels + rng.normal(0, NOISE_DN, levels.shape)


rng = np.random.default_rng(1)
edges = given.edges or [known_edge(angle, rng) for angle in (5, 35, 65, 95, 125, 155)]

# %% One edge alone
(first, *_) = standoff.measure_edges(edges[0])
print(f"first edge: sigma {first.sigma_px:.4f} +- {first.sigma_err_px:.4f} px across it")

# %% All of them: the PSF in both directions, with its correlation
psf = standoff.calibrate_psf(edges)
print(psf)
if not given.edges:
    print(f"true: sigma_x {TRUE.sigma_x_px}, sigma_y {TRUE.sigma_y_px} px, rho {TRUE.rho}")

# %% Look at it, and keep it
psf.plot().savefig(given.out / "psf.png")
standoff.write_psf(given.out / "psf.json", psf)
assert standoff.read_psf(given.out / "psf.json").sigma_x_px == psf.sigma_x_px
print(f"wrote {given.out / 'psf.json'} and psf.png")
