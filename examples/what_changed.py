"""What changed between two photographs that the movement of the camera does not explain.

    python examples/what_changed.py [BEFORE AFTER --psf psf.json] [--out FOLDER]

A script in cells: Jupyter and most editors run it cell by cell. Without photographs it makes a
follow-up of scikit-image's coins from 1.4 times further away, with one coin a little brighter.
"""

# %% Two photographs of one scene
import argparse
from pathlib import Path

import numpy as np
import skimage.data

import standoff

parser = argparse.ArgumentParser(description="What changed between two photographs.")
parser.add_argument("photographs", nargs="*", metavar="BEFORE AFTER")
parser.add_argument("--psf", help="psf.json of the camera, if there is one")
parser.add_argument("--out", type=Path, default=Path("what-changed"))
given = parser.parse_args()
given.out.mkdir(parents=True, exist_ok=True)

NOISE_DN = 1.0
CHANGE_DN = 12.0
CHANGE_AT = (57.0, 152.0)  # row and column of the reference
lens = standoff.GaussianPsf(sigma_x_px=0.76, sigma_y_px=0.67, rho=0.12)


def made_pair(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The coins, and the coins with a change from further away; noise in both."""
    before = skimage.data.coins().astype(np.float64)
    rows, cols = np.indices(before.shape)
    apart_px2 = (rows - CHANGE_AT[0]) ** 2 + (cols - CHANGE_AT[1]) ** 2
    changed = before + CHANGE_DN * np.exp(-apart_px2 / (2 * 4.0**2))
    after = standoff.zoom_out(changed, 1.4, lens)
    return (
        before + rng.normal(0, NOISE_DN, before.shape),
        after + rng.normal(0, NOISE_DN, after.shape),
    )


before, after = given.photographs or made_pair(np.random.default_rng(2))

# %% Where the follow-up was taken from
pose = standoff.register(before, after, given.psf)
print(pose)

# %% What is left when the pose's part is taken off
found = standoff.find_changes(before, after, given.psf)
print(found)
for change in found.summary.changes:
    print(f"at {change.x_px:.1f}, {change.y_px:.1f}: {change.amplitude_dn:+.1f} DN")
found.plot().savefig(given.out / "changes.png")
print(f"wrote {given.out / 'changes.png'}")
