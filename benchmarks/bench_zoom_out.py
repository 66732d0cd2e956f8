"""Speed of the zoom-out models beside Pillow + scipy.ndimage.

Everything here runs on one thread by itself; float32, weights cached. ``peer`` is ``Image.resize``
with the same box, then ``gaussian_filter`` with the paper's width; ``memcpy`` copies the input.
"""

import platform
import sys
import time
from collections.abc import Callable
from functools import partial
from math import sqrt

import numba
import numpy as np
import PIL
import scipy
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter

from simulation import MODELS, GaussianPsf, SamplingGrid, zoom_out

SIGMA_PX = 0.935
SHAPES = ((580, 780), (3000, 4000))
ZOOMS = (1.3, 2.0, 3.0)


def best_s(call: Callable[[], object], seconds: float = 1.0) -> float:
    """Shortest of as many runs as fit, after one that warms up."""
    call()
    best, end = np.inf, time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - start)
    return float(best)


def pillow_and_scipy(image: NDArray[np.float32], zoom: float) -> NDArray[np.float32]:
    grid = SamplingGrid.centred((image.shape[0], image.shape[1]), zoom)
    margin_x, margin_y = (
        max((size - count * zoom) / 2, 0.0)
        for size, count in ((image.shape[1], grid.cols), (image.shape[0], grid.rows))
    )
    box = (margin_x, margin_y, image.shape[1] - margin_x, image.shape[0] - margin_y)
    resized = Image.fromarray(image).resize(
        (grid.cols, grid.rows), Image.Resampling.BICUBIC, box=box
    )
    return np.asarray(gaussian_filter(np.asarray(resized), SIGMA_PX * sqrt(1 - zoom**-2)))


def main() -> None:
    print(
        f"{platform.processor() or platform.machine()}, Python {sys.version.split()[0]}, "
        f"numpy {np.__version__}, numba {numba.__version__}, scipy {scipy.__version__}, "
        f"Pillow {PIL.__version__}; one thread, float32, sigma {SIGMA_PX} px"
    )
    psf = GaussianPsf(sigma_x_px=SIGMA_PX, sigma_y_px=SIGMA_PX)
    for shape in SHAPES:
        image = np.random.default_rng(0).uniform(0, 255, shape).astype(np.float32)
        copy = np.empty_like(image)
        memcpy_s = best_s(partial(np.copyto, copy, image))
        print(f"\n{shape[1]} x {shape[0]}, memcpy {memcpy_s * 1e3:.2f} ms")
        print("  zoom  model        ms   peer ms  times faster  memcpys")
        speedups: dict[str, list[float]] = {model: [] for model in MODELS}
        for zoom in ZOOMS:
            peer_s = best_s(partial(pillow_and_scipy, image, zoom))
            for model in MODELS:
                own_s = best_s(partial(zoom_out, image, zoom, psf, model))
                speedups[model].append(peer_s / own_s)
                print(
                    f"  {zoom:4.1f}  {model:8s} {own_s * 1e3:7.2f} {peer_s * 1e3:8.2f}"
                    f" {peer_s / own_s:12.1f} {own_s / memcpy_s:9.1f}"
                )
        means = ", ".join(f"{model} {np.mean(ratios):.1f}" for model, ratios in speedups.items())
        print(f"  mean times faster: {means}")


if __name__ == "__main__":
    main()
