"""Speed of model ``lmmse`` beside ``matched``: making the operator, and applying it.

Float32, one thread. The error against closed-form scenes is in ``docs/theory-lmmse.md`` and its
tests.
"""

from functools import partial

import numpy as np

from benchmarks.harness import Recorder, bench_parser
from benchmarks.timing import best_s
from simulation import GaussianPsf, Model, SamplingGrid, zoom_operator

SIGMA_PX = 0.935
SHAPES = ((580, 780), (3000, 4000))
ZOOMS = (1.1, 1.3, 2.0, 3.0)
MODELS: tuple[Model, ...] = ("matched", "lmmse")


def compare(record: Recorder, shape: tuple[int, int], rho: float) -> None:
    """Print a table for one size and one correlation of the PSF."""
    image = np.random.default_rng(0).uniform(0, 255, shape).astype(np.float32)
    psf = GaussianPsf(sigma_x_px=SIGMA_PX, sigma_y_px=SIGMA_PX, rho=rho)
    record.say(f"\n{shape[1]} x {shape[0]}, rho {rho}")
    record.say("  zoom  terms  build ms  ratio  apply ms  ratio")
    seconds = record.pick(1.0, 0.1)
    for zoom in ZOOMS:
        grid = SamplingGrid.centred(shape, zoom)
        build_s, apply_s = {}, {}
        for model in MODELS:
            make = partial(zoom_operator.__wrapped__, shape, grid, psf, model)
            build_s[model] = best_s(make, seconds)
            operator = make()
            apply_s[model] = best_s(partial(operator.apply, image), seconds)
        for what, times in (("make", build_s), ("apply", apply_s)):
            record.figure(
                f"{what} lmmse, {shape[1]} x {shape[0]}, rho {rho}, zoom {zoom}",
                times["lmmse"] * 1e3,
                "ms",
                peer="matched",
                peer_value=times["matched"] * 1e3,
            )
        record.say(
            f"  {zoom:4.1f} {len(operator.stages[0].terms):6d}"
            f" {build_s['lmmse'] * 1e3:9.1f} {build_s['lmmse'] / build_s['matched']:6.1f}"
            f" {apply_s['lmmse'] * 1e3:9.2f} {apply_s['lmmse'] / apply_s['matched']:6.2f}"
        )


def main() -> None:
    with Recorder.of(
        bench_parser(__doc__).parse_args(),
        "lmmse",
        packages=("numpy", "numba", "scipy"),
        note=f"float32, sigma {SIGMA_PX} px; ratios in the table are lmmse / matched",
    ) as record:
        for shape in record.pick(SHAPES, SHAPES[:1]):
            for rho in (0.0, 0.3):
                compare(record, shape, rho)


if __name__ == "__main__":
    main()
