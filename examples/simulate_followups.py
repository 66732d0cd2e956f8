"""How a scene looks from further away: all models, from the library alone.

    python examples/simulate_followups.py [PHOTOGRAPH] [--out FOLDER]

Writes the follow-up at zoom-outs 1.5, 2 and 3 by every model as float32 TIFF, and prints how far
each is from ``lmmse``, the best linear one. Without a photograph it takes one of scikit-image's.
"""

import argparse
from pathlib import Path

import numpy as np
import skimage.data

from simulation import MODELS, GaussianPsf, zoom_out
from standoff.workflows import read_grey, write_float_tiff

# A camera's total PSF as calibrate finds it, in px: use your own psf.json's.
PSF = GaussianPsf(sigma_x_px=0.76, sigma_y_px=0.67, rho=0.12)
ZOOMS = (1.5, 2.0, 3.0)


def main() -> None:
    parser = argparse.ArgumentParser(description="Simulate follow-ups by all models.")
    parser.add_argument("photograph", nargs="?", type=Path)
    parser.add_argument("--out", type=Path, default=Path("followups"))
    given = parser.parse_args()
    near = skimage.data.coins() if given.photograph is None else read_grey(given.photograph)
    near = near.astype(np.float32)
    given.out.mkdir(parents=True, exist_ok=True)
    print("zoom  model     differs from lmmse, RMS / DN")
    for zoom in ZOOMS:
        best = zoom_out(near, zoom, PSF, "lmmse")
        for model in MODELS:
            far = zoom_out(near, zoom, PSF, model)
            path = given.out / f"{model}-{zoom:g}.tif"
            write_float_tiff(path, far, f"{model}, zoom {zoom:g}")
            print(f"{zoom:4.1f}  {model:8s} {float(np.sqrt(np.mean((far - best) ** 2))):8.3f}")


if __name__ == "__main__":
    main()
