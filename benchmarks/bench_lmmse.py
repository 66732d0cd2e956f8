"""Speed of model ``lmmse`` beside ``matched``: making the operator, and applying it.

Float32, one thread. The error against closed-form scenes is in ``docs/theory-lmmse.md`` and its
tests.
"""

import platform
import sys
import time
from collections.abc import Callable
from functools import partial

import numba
import numpy as np
import scipy

from simulation import GaussianPsf, Model, SamplingGrid, zoom_operator

SIGMA_PX = 0.935
SHAPES = ((580, 780), (3000, 4000))
ZOOMS = (1.1, 1.3, 2.0, 3.0)
MODELS: tuple[Model, ...] = ("matched", "lmmse")


def best_s(call: Callable[[], object], repeats: int = 5) -> float:
    """Shortest of some runs, after one that warms up."""
    call()
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - start)
    return float(best)


def main() -> None:
    print(
        f"{platform.processor() or platform.machine()}, Python {sys.version.split()[0]}, "
        f"numpy {np.__version__}, numba {numba.__version__}, scipy {scipy.__version__}; "
        f"float32, sigma {SIGMA_PX} px; ratios are lmmse / matched"
    )
    for shape in SHAPES:
        image = np.random.default_rng(0).uniform(0, 255, shape).astype(np.float32)
        for rho in (0.0, 0.3):
            psf = GaussianPsf(sigma_x_px=SIGMA_PX, sigma_y_px=SIGMA_PX, rho=rho)
            print(f"\n{shape[1]} x {shape[0]}, rho {rho}")
            print("  zoom  terms  build ms  ratio  apply ms  ratio")
            for zoom in ZOOMS:
                grid = SamplingGrid.centred(shape, zoom)
                build_s, apply_s = {}, {}
                for model in MODELS:
                    make = partial(zoom_operator.__wrapped__, shape, grid, psf, model)
                    build_s[model] = best_s(make)
                    operator = make()
                    apply_s[model] = best_s(partial(operator.apply, image))
                print(
                    f"  {zoom:4.1f} {len(operator.stages[0].terms):6d}"
                    f" {build_s['lmmse'] * 1e3:9.1f} {build_s['lmmse'] / build_s['matched']:6.1f}"
                    f" {apply_s['lmmse'] * 1e3:9.2f} {apply_s['lmmse'] / apply_s['matched']:6.2f}"
                )


if __name__ == "__main__":
    main()
