"""How well one's own change detector does from further away: a mole that grows, a wall that cracks.

    python examples/own_detector.py [--out FOLDER]

A script in cells: Jupyter and most editors run it cell by cell. The skin is a print on the
simulated bench, the walls are scikit-image's.
"""

# %% A detector: the difference behind a blur, over what differs around it
import argparse
from pathlib import Path

import cv2
import numpy as np
import skimage.data
import tifffile

import standoff


def detector(reference: np.ndarray, followup: np.ndarray, homography: np.ndarray) -> np.ndarray:
    size = followup.shape[::-1]
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    seen = cv2.warpPerspective(
        reference, homography, size, flags=flags, borderMode=cv2.BORDER_REFLECT_101
    )
    difference = cv2.GaussianBlur(followup - seen, (0, 0), 1.5)
    around = np.sqrt(cv2.GaussianBlur(difference**2, (0, 0), 12.0))
    return np.abs(difference) / (around + 0.5)


# %% Where the photographs come from
parser = argparse.ArgumentParser(description="A change detector from further away.")
parser.add_argument("--out", type=Path, default=Path("own-detector"))
given = parser.parse_args()
skin, walls = given.out / "skin", given.out / "walls"
for folder in (skin, walls):
    folder.mkdir(parents=True, exist_ok=True)
configs = Path(__file__).parents[1] / "configs"
with standoff.Bench(configs / "simulated.toml") as bench:
    bench.home()
    bench.place("lesion")
    for height_mm in (180, 200, 220, 240):
        bench.move(height_mm)
        capture = bench.capture()
        tifffile.imwrite(skin / f"lesion-{height_mm}.tif", capture.mean_dn.astype(np.float32))
for name in ("brick", "gravel", "grass", "camera"):
    wall = getattr(skimage.data, name)().astype(np.float32)
    tifffile.imwrite(walls / f"{name}.tif", wall)
psf = standoff.GaussianPsf(sigma_x_px=0.76, sigma_y_px=0.67, rho=0.12)

# %% A mole: a soft dark spot
mole = standoff.EvaluationTask(
    zooms=(1.0, 1.25, 1.5, 2.0, 2.5),
    noises_dn=(8.0,),
    contrasts_dn=(-150.0,),
    change=standoff.Spot(sigma_px=4.0),
    model="matched",
    crops=15,
)
found = standoff.evaluate(detector, skin, psf, mole)
print("mole: ", found.evaluation)
found.write(given.out / "mole.json", report=given.out / "mole.html")

# %% A crack: a thin dark line, pasted with an alpha
line = np.zeros((41, 41), np.uint8)
points = np.array([(2, 30), (9, 25), (16, 27), (25, 17), (31, 16), (38, 8)])
cv2.polylines(line, [8 * points], False, 255, 1, cv2.LINE_AA, 3)
crack = np.dstack([np.full((41, 41, 3), 40, np.uint8), line])
cv2.imwrite(str(given.out / "crack.png"), crack)
task = standoff.EvaluationTask(
    zooms=(1.0, 1.25, 1.5, 2.0, 2.5),
    contrasts_dn=(1.0,),
    change=standoff.patch_of(given.out / "crack.png"),
    model="matched",
    crops=15,
)
found = standoff.evaluate(detector, walls, psf, task)
print("crack:", found.evaluation)
found.write(given.out / "crack.json", report=given.out / "crack.html")
print(f"wrote mole.json, crack.json, their figures and reports in {given.out}")
