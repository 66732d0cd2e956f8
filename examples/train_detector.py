"""A change detector of one's own, trained on pairs that the calibrated camera would take.

    python examples/train_detector.py [PHOTOGRAPH ...] [--psf psf.json] [--out FOLDER]

A script in cells: Jupyter and most editors run it cell by cell. Without photographs it takes those
that scikit-image brings. It needs PyTorch: pip install 'standoff[learned]'.
"""

# %% Photographs, and the PSF of their camera
import argparse
from pathlib import Path

import skimage.data

import standoff

BROUGHT = "astronaut brick camera chelsea coffee coins grass gravel moon page text clock_motion"
parser = argparse.ArgumentParser(description="Trains a change detector and evaluates it.")
parser.add_argument("photographs", nargs="*", type=Path)
parser.add_argument("--psf", help="psf.json of the camera")
parser.add_argument("--crops", type=int, default=1000, help="crops for training, about")
parser.add_argument("--epochs", type=int, default=6)
parser.add_argument("--out", type=Path, default=Path("train-detector"))
given = parser.parse_args()
folder = Path(skimage.data.__file__).parent
photographs = given.photographs or [folder / f"{name}.png" for name in BROUGHT.split()]
psf = given.psf or standoff.GaussianPsf(sigma_x_px=0.76, sigma_y_px=0.67, rho=0.12)

# %% Pairs with and without a change, half of the photographs' crops from further away
task = standoff.ChangePairsTask(pairs=max(given.crops // len(photographs), 1), test_fraction=0.2)
made = standoff.change_pairs(photographs, given.out / "pairs", psf, task)
print(made.dataset)

# %% Training, the same for the same seed
detector = standoff.train_detector(
    made.dataset.pairs("train"),
    standoff.TrainingOptions(epochs=given.epochs, seed=1),
    lambda done, steps, loss: print(f"\r{done} of {steps}, loss {loss:.3f}", end="", flush=True),
)
weights = given.out / "detector.pt"
detector.save(weights)

# %% How well it finds changes in the photographs that it has not seen, beside a built-in detector
kept = {one.photograph for one in made.dataset.files if one.split == "test"}
unseen = [path for path in photographs if Path(path).name in kept] or photographs
asked = standoff.EvaluationTask(zooms=(1.0, 1.5, 2.0), crop_px=task.crop_px, crops=20)
for one in (str(weights), "absolute-difference"):
    print(f"\n{standoff.evaluate(one, unseen, psf, asked).evaluation}")
