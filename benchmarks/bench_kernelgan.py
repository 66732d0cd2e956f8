"""KernelGAN: the composed generator beside the layers one by one, and what it recovers.

Without options, the time of one training step of both, in one run; 3000 steps are extrapolated
from it. ``--table`` trains on images of a known PSF and prints the true blur variance beside the
estimated one: about a minute for each kernel at 1000 steps.

    python -m benchmarks.bench_kernelgan --table --seeds 3 --steps 3000
"""

import argparse
import platform
import statistics
import sys
import time
from collections.abc import Sequence

import numpy as np
import torch
from scipy.stats import spearmanr
from torch import Tensor
from torch.nn import functional

from simulation.kernelgan import (
    KERNEL_MODELS,
    KernelGanError,
    KernelGanSettings,
    KernelModel,
    estimate_kernel,
)
from simulation.kernelgan_crops import CropPicker
from simulation.kernelgan_generator import DeepLinearGenerator, composed_kernel, sampled
from simulation.kernelgan_training import KernelGanTraining
from tests.simulation.dead_leaves import dead_leaves

SHAPE = (580, 780)
TABLE_SHAPE = (290, 390)  # a photograph of 780 x 580 downsampled by 2
ZOOM = 2.0
FULL_STEPS = 3000


def layer_by_layer(crop: Tensor, layers: Sequence[Tensor]) -> Tensor:
    """Convolve layer by layer; sampled by a stride in the last layer wider than 1 px."""
    x = crop[None, None]
    for place, weight in enumerate(layers):
        x = functional.conv2d(x, weight, stride=2 if place == 2 else 1)
    return x


def generator_s(steps: int, *, is_composed: bool) -> list[float]:
    """Times of forward and backward of the generator alone."""
    layers = DeepLinearGenerator(torch.Generator().manual_seed(0), 1.0, torch.float32).parameters
    crop = torch.rand(63, 63, generator=torch.Generator().manual_seed(1))
    taps = torch.arange(26) * 2
    times = []
    for _ in range(steps):
        start = time.thread_time()
        made = (
            sampled(crop, composed_kernel(layers)[0, 0], taps)
            if is_composed
            else layer_by_layer(crop, layers)
        )
        made.square().mean().backward()  # type: ignore[no-untyped-call]
        times.append(time.thread_time() - start)
    return times


def step_s(steps: int) -> list[float]:
    """Times of whole training steps with the composed generator."""
    image = dead_leaves(SHAPE, 0.8, seed=0, discs_per_px=0.3)
    picker = CropPicker.of_image(image, ZOOM, 13)
    training = KernelGanTraining(picker, is_gaussian=False, zoom=ZOOM, seed=0)
    times = []
    for _ in range(steps):
        start = time.thread_time()
        training.step()
        times.append(time.thread_time() - start)
    return times


def print_speed(steps: int) -> None:
    # The first steps allocate and choose algorithms.
    whole, composed, layered = (
        statistics.median(times[3:])
        for times in (
            step_s(steps),
            generator_s(steps, is_composed=True),
            generator_s(steps, is_composed=False),
        )
    )
    # All else in a step is the same for both.
    by_layers = whole - composed + layered
    print(f"medians of {steps - 3} steps at zoom 2 on {SHAPE[1]} x {SHAPE[0]}")
    print("CPU time of the one thread, so that other programs count less")
    print("                  generator ms   whole step ms   3000 steps s (extrapolated)")
    for name, own, step in (
        ("composed", composed, whole),
        ("layer by layer", layered, by_layers),
    ):
        print(f"  {name:15s} {own * 1e3:12.2f} {step * 1e3:15.2f} {FULL_STEPS * step:12.0f}")
    print(
        f"  ratio           {layered / composed:12.1f} {by_layers / whole:15.1f}"
        "   (the whole step by layers is the composed one with the other generator)"
    )


def print_table(
    models: Sequence[KernelModel], sigmas_px: Sequence[float], seeds: int, steps: int
) -> None:
    print(
        f"{TABLE_SHAPE[1]} x {TABLE_SHAPE[0]} dead leaves, blurred by sigma and downsampled by 2; "
        f"{steps} steps at zoom 2\nsigma in px before, variances in px^2 after downsampling; "
        "true: what a camera of this PSF adds at zoom 2, Sigma (zoom^2 - 1)"
    )
    for model in models:
        print(f"\n{model}\n  sigma  seed   true   estimated y, x    mean   ratio")
        truths, means = [], []
        for sigma_px in sigmas_px:
            true_px2 = sigma_px**2 / 4 * (ZOOM**2 - 1)
            for seed in range(seeds):
                image = dead_leaves(TABLE_SHAPE, sigma_px / 2, seed)
                settings = KernelGanSettings(zoom=ZOOM, model=model, steps=steps, seed=seed)
                try:
                    (xx, _), (_, yy) = estimate_kernel(image, settings).covariance_px2.tolist()
                except KernelGanError as error:
                    print(f"  {sigma_px:5.2f} {seed:5d} {true_px2:6.2f}   {error}")
                    continue
                mean = (xx + yy) / 2
                truths.append(true_px2)
                means.append(mean)
                print(
                    f"  {sigma_px:5.2f} {seed:5d} {true_px2:6.2f} {yy:10.2f} {xx:6.2f} {mean:7.2f}"
                    f" {mean / true_px2:7.2f}",
                    flush=True,
                )
        print(f"  rank correlation {spearmanr(truths, means).statistic:.3f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--table", action="store_true", help="true against estimated variance")
    parser.add_argument("--model", choices=KERNEL_MODELS, action="append")
    parser.add_argument("--sigmas", default="0.8,1.1,1.4,1.7,2.0")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--steps", type=int, default=None, help="1000 for the table, else 30")
    given = parser.parse_args()
    torch.set_num_threads(1)
    print(
        f"{platform.processor() or platform.machine()}, Python {sys.version.split()[0]}, "
        f"numpy {np.__version__}, torch {torch.__version__}; float32, one thread"
    )
    if given.table:
        sigmas_px = [float(text) for text in given.sigmas.split(",")]
        print_table(given.model or KERNEL_MODELS, sigmas_px, given.seeds, given.steps or 1000)
    else:
        print_speed(given.steps or 30)


if __name__ == "__main__":
    main()
