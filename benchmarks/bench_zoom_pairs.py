"""Table II on real photographs: postcards photographed twice, from near and from further away.

The further photograph of each pair was scaled up onto the nearer one's grid by whoever published
them, so the simulated follow-up is scaled up too, as in the paper's procedure. The PSF is fitted on
the *other* pairs of the same camera, never on the pair that it is judged by: the Gaussian whose
model has the least mean squared error there. Photographs are read as they are, gamma included.

    STANDOFF_REAL_DATA=/path/to/data python -m benchmarks.bench_zoom_pairs

exits 0 with a remark where the folder is not named.
"""

import os
import sys
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.optimize import minimize

from analysis.validation import (
    ImageMetrics,
    compare_images,
    mean_metrics,
    process_for_comparison,
    scaled_up,
)
from benchmarks.harness import Recorder, bench_parser
from calibration.psf import luma_plane
from simulation import GaussianPsf, Model, zoom_out
from simulation.arrays import FloatArray

ZOOMS = {"nikon": 2.9, "iphone": 2.4}
"""Ratios of focal lengths and of distances, as the publication of the photographs has them."""

MODELS: tuple[Model, ...] = ("bicubic", "paper", "matched")
START_PX = 0.6
METRICS = ("correlation", "mse_dn2", "nmi", "psnr_db", "ssim")


@dataclass(frozen=True)
class Pair:
    """A nearer photograph and the further one on its grid."""

    name: str
    camera: str
    near: FloatArray
    far: FloatArray

    def metrics(self, model: Model, psf: GaussianPsf) -> ImageMetrics:
        """Of the processed further photograph and the processed simulated one."""
        zoom = ZOOMS[self.camera]
        shape = self.near.shape[0], self.near.shape[1]
        simulated = scaled_up(zoom_out(self.near, zoom, psf, model), zoom, shape)
        return compare_images(process_for_comparison(self.far), process_for_comparison(simulated))


def main() -> None:
    packages = ("numpy", "scipy", "opencv-contrib-python-headless", "scikit-image")
    given = bench_parser(__doc__).parse_args()
    with Recorder.of(given, "zoom_pairs", packages=packages) as record:
        judge_cameras(record)


def judge_cameras(record: Recorder) -> None:
    """Print Table II of every camera."""
    folder = os.environ.get("STANDOFF_REAL_DATA")
    if folder is None:
        record.say("STANDOFF_REAL_DATA does not name a folder of real photographs: nothing to do")
        return
    cameras: dict[str, list[Pair]] = defaultdict(list)
    for pair in read_pairs(Path(folder) / "zoom_pairs"):
        cameras[pair.camera].append(pair)
    if not cameras:
        sys.exit(f"{folder}/zoom_pairs contains no photographs")
    failures = [
        camera for camera, pairs in cameras.items() if not print_camera(record, camera, pairs)
    ]
    if failures:
        sys.exit(f"the paper's model does not beat bicubic on {', '.join(failures)}")


def print_camera(record: Recorder, camera: str, pairs: list[Pair]) -> bool:
    """Print Table II of one camera; whether the paper's model is better in all five metrics."""
    found: dict[Model, list[ImageMetrics]] = defaultdict(list)
    record.say(f"\n{camera}, zoom {ZOOMS[camera]}, {len(pairs)} pairs")
    for judged in pairs:
        others = [pair for pair in pairs if pair is not judged]
        psf = fitted_psf(others)
        names = ", ".join(pair.name for pair in others)
        widths = f"sigma x {psf.sigma_x_px:.3f}, y {psf.sigma_y_px:.3f} px"
        record.say(f"  {judged.name}: {widths} fitted on {names}")
        for model in MODELS:
            found[model].append(judged.metrics(model, psf))
    record.say("  model      correlation     MSE     NMI  PSNR / dB    SSIM")
    means = {model: mean_metrics(found[model]) for model in MODELS}
    record.figure(
        f"MSE of the paper's model, {camera}",
        means["paper"].mse_dn2,
        "DN^2",
        peer="bicubic",
        peer_value=means["bicubic"].mse_dn2,
    )
    for model, mean in means.items():
        figures = f"{mean.correlation:.4f}  {mean.mse_dn2:6.2f}  {mean.nmi:.4f}      "
        record.say(f"  {model:<9}       {figures}{mean.psnr_db:5.2f}  {mean.ssim:.4f}")
    better = {
        name: (getattr(means["paper"], name) < getattr(means["bicubic"], name))
        if name == "mse_dn2"
        else (getattr(means["paper"], name) > getattr(means["bicubic"], name))
        for name in METRICS
    }
    verdicts = ", ".join(f"{name} {is_better}" for name, is_better in better.items())
    record.say(f"  paper better than bicubic: {verdicts}")
    return all(better.values())


def fitted_psf(pairs: list[Pair]) -> GaussianPsf:
    """Axis-aligned Gaussian whose model has the least mean squared error on the pairs."""

    def error(log_sigmas_px: FloatArray) -> float:
        x_px, y_px = np.exp(log_sigmas_px).tolist()
        psf = GaussianPsf(sigma_x_px=x_px, sigma_y_px=y_px)
        return float(np.mean([pair.metrics("paper", psf).mse_dn2 for pair in pairs]))

    found = minimize(
        error,
        np.log([START_PX, START_PX]),
        method="Nelder-Mead",
        options={"xatol": 0.01, "fatol": 0.01, "maxiter": 40},
    )
    x_px, y_px = np.exp(found.x).tolist()
    return GaussianPsf(sigma_x_px=x_px, sigma_y_px=y_px)


def read_pairs(folder: Path) -> list[Pair]:
    """All pairs of a folder: ``camera_numberH.png`` nearer, ``camera_numberL.png`` further."""
    pairs = []
    for near in sorted(folder.glob("*H.png")):
        far = near.with_name(near.name.replace("H.png", "L.png"))
        planes = [luma_plane(np.asarray(Image.open(path))) for path in (near, far)]
        name = near.stem.removesuffix("H")
        pairs.append(Pair(name, name.partition("_")[0], *planes))
    return pairs


if __name__ == "__main__":
    main()
