"""From photographs of edges to the PSF and an MTF plot, step by step with the library.

    python examples/psf_and_mtf.py [EDGE.tif ...] [--out mtf.png]

Without photographs it takes some with the simulated bench, whose truth is then drawn as well.
"""

import argparse
from pathlib import Path

import numpy as np

from acquisition.bench import load_bench
from analysis.reports import new_figure, png_bytes
from calibration.edges import EdgeImage
from calibration.psf import PsfCalibration, calibrate_psf
from hil_mocks import BenchTruth, CameraPose
from standoff.shipped_configs import shipped_config
from standoff.workflows import read_grey

HEIGHT_MM = 200.0
ORIENTATIONS_DEG = (5.0, 35.0, 65.0, 95.0, 125.0, 155.0)
EVEN = {"simulated.corner_sigma_gain": 0.0, "simulated.k1": 0.0}


def simulated_edges() -> tuple[list[EdgeImage], tuple[float, float]]:
    """Edges of the simulated bench with the noise of one frame, and its true optical widths."""
    truth = BenchTruth(load_bench(shipped_config("simulated.toml"), EVEN))
    rng = np.random.default_rng(1)
    images = []
    for orientation_deg in ORIENTATIONS_DEG:
        light = truth.irradiance("edge", orientation_deg, CameraPose(height_mm=HEIGHT_MM))
        electrons = truth.sensor.electrons(light, 9000.0)
        frame = truth.sensor.expose(electrons, 0.0, "Mono12", rng)
        images.append(
            EdgeImage(name=f"{orientation_deg:g} degrees", image_dn=frame.astype(np.float64))
        )
    (xx, _), (_, yy) = truth.optical_covariance_px2(HEIGHT_MM).tolist()
    return images, (xx**0.5, yy**0.5)


def plot_mtf(found: PsfCalibration, true_px: tuple[float, float] | None) -> bytes:
    """Draw the lens's MTF in x and y: Gaussian, so exp(-2 pi^2 sigma^2 f^2)."""
    figure = new_figure()
    axes = figure.subplots()
    freq = np.linspace(0, 0.5, 200)
    widths = (found.optical.sigma_x_px, found.optical.sigma_y_px)
    for place, (name, width, colour) in enumerate(
        zip("xy", widths, ("#0072B2", "#D55E00"), strict=True)
    ):
        if width is None:
            continue  # these edges do not tell it
        for sigma_px, alpha in ((width.low, 0.3), (width.value, 1.0), (width.high, 0.3)):
            mtf = np.exp(-2 * (np.pi * sigma_px * freq) ** 2)
            axes.plot(freq, mtf, color=colour, alpha=alpha, label=name if alpha == 1 else None)
        if true_px is not None:
            axes.plot(freq, np.exp(-2 * (np.pi * true_px[place] * freq) ** 2), "k:", lw=1)
    axes.set(xlabel="frequency / cycles per px", ylabel="MTF of the lens", ylim=(0, 1))
    axes.legend()
    return png_bytes(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description="PSF and MTF from photographs of edges.")
    parser.add_argument("edges", nargs="*", type=Path)
    parser.add_argument("--out", type=Path, default=Path("mtf.png"))
    given = parser.parse_args()
    true_px = None
    if given.edges:
        images = [EdgeImage(name=path.name, image_dn=read_grey(path)) for path in given.edges]
    else:
        images, true_px = simulated_edges()
    found = calibrate_psf(images)
    for name, width in (("x", found.optical.sigma_x_px), ("y", found.optical.sigma_y_px)):
        if width is None:
            print(f"optical sigma_{name}: not determined by these edges")
        else:
            print(f"optical sigma_{name} {width.value:.4f} px, {width.low:.4f} to {width.high:.4f}")
    if true_px is not None:
        print(f"true {true_px[0]:.4f} and {true_px[1]:.4f} px")
    given.out.write_bytes(plot_mtf(found, true_px))
    print(f"wrote {given.out}")


if __name__ == "__main__":
    main()
