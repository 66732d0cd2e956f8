"""How a scene looks from further away, and how far a camera may move before a change is missed.

    python examples/how_far_away.py [PHOTOGRAPH] [--out FOLDER]

A script in cells: Jupyter and most editors run it cell by cell. Without a photograph it takes
scikit-image's coins.
"""

# %% A photograph and the PSF of its camera
import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import skimage.data

import standoff

parser = argparse.ArgumentParser(description="A scene from further away, and what is lost.")
parser.add_argument("photograph", nargs="?")
parser.add_argument("--psf", help="psf.json of the camera")
parser.add_argument("--out", type=Path, default=Path("how-far-away"))
given = parser.parse_args()
given.out.mkdir(parents=True, exist_ok=True)

near = given.photograph or skimage.data.coins()
psf = given.psf or standoff.GaussianPsf(sigma_x_px=0.76, sigma_y_px=0.67, rho=0.12)

# %% The same scene from twice as far away, by every model
followups = {
    model: standoff.zoom_out(near, 2.0, psf, model)
    for model in ("bicubic", "paper", "matched", "lmmse")
}
figure, panels = plt.subplots(1, len(followups), figsize=(11, 3), layout="constrained")
for axes, (model, far) in zip(panels, followups.items(), strict=True):
    apart_dn = float(np.sqrt(np.mean((far - followups["lmmse"]) ** 2)))
    print(f"{model:8s} differs from the best linear model by {apart_dn:6.3f} DN rms")
    axes.imshow(far, cmap="gray")
    axes.set(title=model, xticks=[], yticks=[])
figure.savefig(given.out / "followups.png")

# %% How well a small change is found against the zoom-out (Figures 4 and 5 of the paper)
curves = standoff.d_prime_curves(
    [near],
    psf,
    standoff.DetectionTask(
        zooms=(1, 1.01, 1.1, 1.25, 1.5, 2),
        noises_dn=(1, 2),
        contrasts_dn=(12,),
        models=("bicubic", "matched"),
    ),
)
print(curves)
curves.plot().savefig(given.out / "curves.png")

# %% What that allows: distance ratio and tilt
limits = standoff.pose_limits(
    next(
        curve
        for curve in curves.curves
        if (curve.model, curve.observer, curve.noise_dn) == ("matched", "hotelling", 2)
    ),
    min_d_prime=2,
    focal_length_px=964,
    image_size=(780, 580),
)
print(limits)
limits.plot().savefig(given.out / "limits.png")
print(f"wrote followups.png, curves.png and limits.png in {given.out}")
