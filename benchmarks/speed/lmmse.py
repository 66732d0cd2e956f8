"""Speed of model ``lmmse`` beside ``matched``: applying the operator, and making it.

Float32, one thread. Making is timed for a PSF that was not seen before, and then for another image
size, which finds the kernels in the cache. The error against exact photographs is in
``docs/theory-lmmse.md`` and its tests.
"""

from functools import partial
from time import perf_counter

import numpy as np

from benchmarks.harness import Recorder, benchmark, shortest_s
from simulation import GaussianPsf, Model, SamplingGrid, ZoomOperator, zoom_operator

SIGMA_PX = 0.935
SHAPES = ((580, 780), (3000, 4000))
ZOOMS = (1.1, 1.3, 2.0, 3.0)
MODELS: tuple[Model, ...] = ("matched", "lmmse")


def _compare(record: Recorder, shape: tuple[int, int], rho: float) -> None:
    """Time all zooms for one size and one correlation of the PSF."""
    image = np.random.default_rng(0).uniform(0, 255, shape).astype(np.float32)
    # Another width for each size: nothing of it is in a cache.
    psf = GaussianPsf(sigma_x_px=SIGMA_PX + 1e-9 * shape[0], sigma_y_px=SIGMA_PX, rho=rho)
    other = (shape[0] + 20, shape[1] + 31)
    for zoom in ZOOMS:
        times: dict[str, dict[str, float]] = {"make": {}, "make again": {}, "apply": {}}
        operators: dict[str, ZoomOperator] = {}
        for model in MODELS:
            for what, size in (("make", shape), ("make again", other)):
                start_s = perf_counter()
                made = zoom_operator(size, SamplingGrid.centred(size, zoom), psf, model)
                times[what][model] = perf_counter() - start_s
                operators.setdefault(model, made)
        applied_s = shortest_s(
            [partial(operators[model].apply, image) for model in MODELS], record.pick(2.0, 0.2)
        )
        times["apply"] = dict(zip(MODELS, applied_s, strict=True))
        for what, by_model in times.items():
            name = f"{what} lmmse, {shape[1]} x {shape[0]}, rho {rho}, zoom {zoom}"
            record.time(name, by_model["lmmse"], "matched", by_model["matched"])


@benchmark(
    "numpy",
    "numba",
    "scipy",
    note=f"float32, sigma {SIGMA_PX} px",
)
def main(record: Recorder) -> None:
    for shape in record.pick(SHAPES, SHAPES[:1]):
        for rho in (0.0, 0.3):
            _compare(record, shape, rho)
