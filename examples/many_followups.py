"""Many follow-ups of one photograph: whose pose is good enough, and when each change appeared.

    python examples/many_followups.py [REFERENCE FOLLOWUP ...] [--out FOLDER]

A script in cells: Jupyter and most editors run it cell by cell. Without photographs it makes
three follow-ups of scikit-image's coins, from ever further away, with one coin ever brighter.
"""

# %% A reference, and photographs of the same scene later
import argparse
from pathlib import Path

import numpy as np
import skimage.data
import tifffile

import standoff

parser = argparse.ArgumentParser(description="Poses and changes of many follow-ups.")
parser.add_argument("photographs", nargs="*", metavar="REFERENCE FOLLOWUP", type=Path)
parser.add_argument("--out", type=Path, default=Path("many-followups"))
given = parser.parse_args()
given.out.mkdir(parents=True, exist_ok=True)

NOISE_DN = 1.0
BRIGHTER_DN = {1.1: 0.0, 1.2: 12.0, 1.3: 24.0}  # by the ratio of the distances
CHANGE_AT = (57.0, 152.0)  # row and column of the reference
lens = standoff.GaussianPsf(0.76, 0.67, 0.12)


def made(folder: Path, rng: np.random.Generator) -> list[Path]:
    """The coins, and follow-ups with a change; noise in all of them."""
    before = skimage.data.coins().astype(np.float64)
    rows, cols = np.indices(before.shape)
    spot = np.exp(-((rows - CHANGE_AT[0]) ** 2 + (cols - CHANGE_AT[1]) ** 2) / (2 * 4.0**2))
    images = {"0-reference": before}
    for number, (zoom, peak_dn) in enumerate(BRIGHTER_DN.items(), start=1):
        images[f"{number}-later"] = standoff.zoom_out(before + peak_dn * spot, zoom, lens)
    paths = []
    for name, image in images.items():
        paths.append(folder / f"{name}.tif")
        noisy = image + rng.normal(0, NOISE_DN, image.shape)
        tifffile.imwrite(paths[-1], noisy.astype(np.float32))
    return paths


reference, *followups = given.photographs or made(given.out, np.random.default_rng(2))

# %% How far away a change of 12 DN is still found
task = standoff.DetectionTask(
    zooms=(1.0, 1.1, 1.25, 1.5), noises_dn=(NOISE_DN,), models=("matched",), observers=("npw",)
)
curves = standoff.d_prime_curves(reference, lens, task)

# %% Whose pose is good enough
poses = standoff.judge_poses(reference, followups, given.out / "poses", curves, min_d_prime=3)
for one in poses.first:
    print(f"{Path(one.followup).name}: d' {one.dprime_decisive:.1f}, accepted: {one.is_accepted}")

# %% What changed, and when
changes = standoff.find_changes_of_series(reference, followups, given.out / "changes")
for row in changes.first:
    print(f"{Path(row.followup).name}: {row.changes} changes")
print(f"wrote {given.out / 'changes' / 'report.html'}")
