"""KernelGAN: the composed generator beside the layers one by one; what blind methods recover.

Without options, the time of one training step of both, in one run; 3000 steps are extrapolated
from it. ``--table`` prints the true blur variance beside the one that KernelGAN,
Gaussian-KernelGAN, the edges of a single image and two distances find on images of a known PSF;
a training takes a minute or less.

    python -m benchmarks.studies.kernelgan --table --seeds 3 --steps 3000
"""

import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Annotated, Literal

import numpy as np
import torch
from scipy.stats import spearmanr
from torch import Tensor
from torch.nn import functional

from benchmarks.harness import Recorder, benchmark
from calibration.blind import NearAndFar, calibrate_from_scene, pair_psf
from calibration.blind.two_distance import ClippedPixels
from calibration.edges import EdgeImage
from calibration.errors import CalibrationError
from simulation.arrays import FloatArray
from simulation.choices import KERNEL_MODELS, KernelModel
from simulation.kernelgan import (
    CropPicker,
    DeepLinearGenerator,
    KernelGanError,
    KernelGanSettings,
    KernelGanTraining,
    composed_kernel,
    estimate_kernel,
    sampled,
)
from tests.simulation.dead_leaves import dead_leaves

SHAPE = (580, 780)
TABLE_SHAPE = (290, 390)  # a photograph of 780 x 580 downsampled by 2
ZOOM = 2.0
FULL_STEPS = 3000
TOP_DN = 4000.0
Method = Literal[KernelModel, "single-image", "two-distance"]
METHODS: tuple[Method, ...] = (*KERNEL_MODELS, "single-image", "two-distance")

Variances = tuple[float, float]
Estimator = Callable[[float, int], Variances]


def _layer_by_layer(crop: Tensor, layers: Sequence[Tensor], taps: Tensor) -> Tensor:
    """Convolve layer by layer, then sample: what any zoom needs, the publication's order."""
    x = crop[None, None]
    for weight in layers:
        x = functional.conv2d(x, weight)
    return x[:, :, taps][:, :, :, taps]


def _layer_by_layer_with_stride(crop: Tensor, layers: Sequence[Tensor], _: Tensor) -> Tensor:
    """The same at zoom 2 by a stride in the last layer wider than 1 px: a quarter of the rest."""
    x = crop[None, None]
    for place, weight in enumerate(layers):
        x = functional.conv2d(x, weight, stride=2 if place == 2 else 1)
    return x


def _composed(crop: Tensor, layers: Sequence[Tensor], taps: Tensor) -> Tensor:
    """Compose the kernel, then convolve at the samples only."""
    return sampled(crop, composed_kernel(layers)[0, 0], taps)


Form = Callable[[Tensor, Sequence[Tensor], Tensor], Tensor]
FORMS: dict[str, Form] = {
    "composed": _composed,
    "layer by layer": _layer_by_layer,
    "... with stride": _layer_by_layer_with_stride,
}


def _generator_s(steps: int, form: Form) -> list[float]:
    """Times of forward and backward of the generator alone."""
    layers = DeepLinearGenerator(torch.Generator().manual_seed(0), 1.0, torch.float32).parameters
    crop = torch.rand(63, 63, generator=torch.Generator().manual_seed(1))
    taps = torch.arange(26) * 2
    times = []
    for _ in range(steps):
        start = time.thread_time()
        made = form(crop, layers, taps)
        made.square().mean().backward()  # type: ignore[no-untyped-call]
        times.append(time.thread_time() - start)
    return times


def _step_s(steps: int) -> list[float]:
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


def _print_speed(record: Recorder, steps: int) -> None:
    # The first steps allocate and choose algorithms.
    whole_s = statistics.median(_step_s(steps)[3:])
    own_s = {name: statistics.median(_generator_s(steps, form)[3:]) for name, form in FORMS.items()}
    # All else in a step is the same for all.
    rest_s = whole_s - own_s["composed"]
    record.figure(
        "a training step at zoom 2",
        whole_s * 1e3,
        "ms",
        "layer by layer",
        (rest_s + own_s["layer by layer"]) * 1e3,
    )
    record.say(f"medians of {steps - 3} steps at zoom 2 on {SHAPE[1]} x {SHAPE[0]}")
    record.say("CPU time of the one thread, so that other programs count less")
    record.say("                  generator ms  ratio   whole step ms  ratio   3000 steps s")
    for name, own in own_s.items():
        step = rest_s + own
        record.say(
            f"  {name:15s} {own * 1e3:12.2f} {own / own_s['composed']:6.1f}"
            f" {step * 1e3:15.2f} {step / whole_s:6.1f} {FULL_STEPS * step:14.0f}"
        )
    record.say(
        "3000 steps are extrapolated; the whole step by layers is the composed one with the other"
    )
    record.say("generator: discriminator, crops and regularisers are the same")


def _by_training(model: KernelModel, steps: int, sigma_px: float, seed: int) -> Variances:
    """Variances of the kernel that a training on one photograph found, (y, x), px^2."""
    image = dead_leaves(TABLE_SHAPE, sigma_px, seed)
    settings = KernelGanSettings(zoom=ZOOM, model=model, steps=steps, seed=seed)
    (xx, _), (_, yy) = estimate_kernel(image, settings).covariance_px2.tolist()
    return yy, xx


def _by_edges(sigma_px: float, seed: int) -> Variances:
    """The same from the edges of a photograph of squares: discs have no straight ones."""
    image = dead_leaves(
        TABLE_SHAPE, sigma_px, seed, discs_per_px=0.003, is_square=True, radius_min_px=12.0
    )
    calibration = calibrate_from_scene([EdgeImage(name="squares", image_dn=TOP_DN * image)])
    return _between(calibration.total.covariance_px2)


def _by_distances(sigma_px: float, seed: int) -> Variances:
    """The same from that photograph and one of the scene from twice as far away."""
    near, far = (TOP_DN * dead_leaves(TABLE_SHAPE, sigma_px, seed, zoom=z) for z in (1, 2))
    matrix = np.array([[2.0, 0.0, 0.5], [0.0, 2.0, 0.5], [0.0, 0.0, 1.0]])
    clipped = ClippedPixels.none(near.shape, far.shape)
    pair = NearAndFar(near_dn=near, far_dn=far, clipped=clipped)
    xx, xy, yy = pair_psf(pair, matrix).gaussian.px2
    return _between(np.array([[xx, xy], [xy, yy]]))


def _between(covariance_px2: FloatArray | None) -> Variances:
    """What a PSF adds at the zoom-out of the table."""
    assert covariance_px2 is not None
    (xx, _), (_, yy) = (covariance_px2 * (ZOOM**2 - 1)).tolist()
    return yy, xx


def _print_table(
    record: Recorder, methods: dict[str, Estimator], sigmas_px: Sequence[float], seeds: int
) -> None:
    record.say(
        f"{TABLE_SHAPE[1]} x {TABLE_SHAPE[0]} dead leaves (squares for single-image), blurred by "
        "sigma and downsampled by 2\n"
        "sigma in px before, variances in px^2 after downsampling; "
        "true: what a camera of this PSF adds at zoom 2, Sigma (zoom^2 - 1)"
    )
    for name, estimate in methods.items():
        record.say(f"\n{name}\n  sigma  seed   true   estimated y, x    mean   ratio")
        truths, means = [], []
        for sigma_px in sigmas_px:
            true_px2 = sigma_px**2 / 4 * (ZOOM**2 - 1)
            for seed in range(seeds):
                try:
                    yy, xx = estimate(sigma_px / 2, seed)
                except (KernelGanError, CalibrationError) as error:
                    record.say(f"  {sigma_px:5.2f} {seed:5d} {true_px2:6.2f}   {error}")
                    continue
                mean = (xx + yy) / 2
                truths.append(true_px2)
                means.append(mean)
                record.say(
                    f"  {sigma_px:5.2f} {seed:5d} {true_px2:6.2f} {yy:10.2f} {xx:6.2f} {mean:7.2f}"
                    f" {mean / true_px2:7.2f}"
                )
        record.say(f"  rank correlation {spearmanr(truths, means).statistic:.3f}")


@benchmark("numpy", "torch", note="float32, one thread")
def main(
    record: Recorder,
    *,
    table: Annotated[bool, "true against estimated variance"] = False,
    method: Annotated[list[Method] | None, "all four by default"] = None,
    sigmas: str = "0.8,1.1,1.4,1.7,2.0",
    seeds: int = 1,
    steps: Annotated[int | None, "1000 for the table, otherwise 30"] = None,
) -> None:
    torch.set_num_threads(1)
    if not table:
        _print_speed(record, steps or record.pick(30, 15))
        return
    steps = steps or 1000
    methods: dict[str, Estimator] = {
        **{model: partial(_by_training, model, steps) for model in KERNEL_MODELS},
        "single-image": _by_edges,
        "two-distance": _by_distances,
    }
    sigmas_px = [float(text) for text in sigmas.split(",")]
    chosen = method or METHODS
    _print_table(record, {name: methods[name] for name in chosen}, sigmas_px, seeds)
