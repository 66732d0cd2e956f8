"""The training of KernelGAN: discriminator and generator alternately, on crops of one image."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

from simulation.arrays import FloatArray
from simulation.kernelgan.crops import CropPicker
from simulation.kernelgan.discriminator import PatchDiscriminator
from simulation.kernelgan.errors import KernelGanError
from simulation.kernelgan.generator import (
    DeepLinearGenerator,
    GaussianGenerator,
    Generator,
    sampled,
)

_SUM_WEIGHT = 0.5  # alpha
_BOUNDARY_WEIGHT = 0.5  # beta
_SPARSE_WEIGHT = 5.0  # gamma
_CENTRE_WEIGHT = 1.0  # delta
_ROOT_FLOOR = 1e-6
"""Below this the square root of the sparsity term has no useful slope."""

_BOUNDARY_GROWTH_PX = 2.0


def boundary_mask(size: int, dtype: torch.dtype) -> Tensor:
    """Return weights that grow exponentially with the distance from the middle, up to 1.

    The publication gives no rate; here they are 0 in the middle and e-fold in 2 px.
    """
    offset = torch.arange(size, dtype=dtype) - size // 2
    distance_px = torch.hypot(offset[:, None], offset[None, :])
    grown = torch.expm1(distance_px / _BOUNDARY_GROWTH_PX)
    return grown / grown.max()


class KernelRegulariser:
    """Penalties for a sum other than 1, boundary weights, many weights, and an off-centre mass."""

    def __init__(self, size: int, dtype: torch.dtype) -> None:
        self._mask = boundary_mask(size, dtype)
        self._offset = torch.arange(size, dtype=dtype) - size // 2

    def __call__(self, kernel: Tensor) -> Tensor:
        """Return the penalty of a kernel, one differentiable number."""
        total = kernel.sum()
        centre_y = (kernel.sum(dim=1) * self._offset).sum() / total
        centre_x = (kernel.sum(dim=0) * self._offset).sum() / total
        size = kernel.abs()
        return (
            _SUM_WEIGHT * (1 - total).abs()
            + _BOUNDARY_WEIGHT * (size * self._mask).sum()
            + _SPARSE_WEIGHT * ((size + _ROOT_FLOOR) ** 0.5).mean()
            + _CENTRE_WEIGHT * (centre_y**2 + centre_x**2 + _ROOT_FLOOR) ** 0.5
        )


_RATE = 2e-4  # publication, section 4.3
_GAUSSIAN_RATE = 1e-2
"""At 2e-4 per step a logarithm would move by 0.17 in a whole training."""

_BETAS = (0.5, 0.999)  # publication, section 4.3
_DECAY_STEPS = 750  # publication, section 4.3
_DECAY = 0.1  # publication, section 4.3
_RAMP_STEPS = 200
"""Adam's first steps move all weights together at the full rate: the composed kernel of six layers
would change sign, and one with a sum below 0 does not recover."""

_START_SIGMA_PER_ZOOM = 0.5
"""Width of the initial kernel in px, divided by the zoom."""

_REPORTS = 100
_CHECK_STEPS = 50
_SETTLED_STEPS = 300
_SUM_SLACK = 0.5
_WON_MARGIN = 0.9
_MARGIN_MEMORY = 0.02


class KernelGanTraining:
    """One training; ``step`` updates both networks once.

    Parameters
    ----------
    picker
        Crops of the image.
    is_gaussian
        A Gaussian of three parameters, without the regularisers, instead of the free kernel.
    zoom
        Zoom-out; sets the width of the initial kernel.
    seed
        Seed of the initial weights and of the crops.
    """

    def __init__(self, picker: CropPicker, *, is_gaussian: bool, zoom: float, seed: int) -> None:
        self._picker = picker
        self._rng = np.random.default_rng(seed)
        weights_rng = torch.Generator().manual_seed(seed)
        dtype = torch.float32
        sigma_px = _START_SIGMA_PER_ZOOM * zoom
        self.generator: Generator = (
            GaussianGenerator(sigma_px, dtype)
            if is_gaussian
            else DeepLinearGenerator(weights_rng, sigma_px, dtype)
        )
        self._judge = PatchDiscriminator(weights_rng, dtype)
        self._regulariser = None if is_gaussian else KernelRegulariser(13, dtype)
        self._taps = torch.from_numpy(picker.taps)
        rate = _GAUSSIAN_RATE if is_gaussian else _RATE
        self._of_generator = torch.optim.Adam(self.generator.parameters, rate, _BETAS, fused=True)
        self._of_judge = torch.optim.Adam(self._judge.parameters, _RATE, _BETAS, fused=True)
        self._rates = ((self._of_generator, rate), (self._of_judge, _RATE))
        self._steps = 0
        self._margin = 0.0

    @property
    def kernel(self) -> FloatArray:
        """The present kernel, shape (13, 13), order (y, x)."""
        return self.generator.kernel().detach().numpy().astype(np.float64)

    def step(self) -> None:
        """Update the discriminator, then the generator."""
        share = _DECAY ** (self._steps // _DECAY_STEPS)
        if self._steps < _RAMP_STEPS:
            share *= ((self._steps + 1) / _RAMP_STEPS) ** 2
        for optimiser, rate in self._rates:
            optimiser.param_groups[0]["lr"] = share * rate
        crop = _tensor(self._picker.generator_crop(self._rng))
        real = _tensor(self._picker.real_crop(self._rng))[None, None]
        kernel = self.generator.kernel()
        made = sampled(crop, kernel, self._taps)

        self._judge.normalise()
        layers = self._judge.normalised_weights()
        real_map, made_map = self._judge(real, layers), self._judge(made.detach(), layers)
        self._of_judge.zero_grad()
        loss = 0.5 * ((1 - real_map).square().mean() + made_map.square().mean())
        loss.backward()  # type: ignore[no-untyped-call]
        self._of_judge.step()
        margin = float((real_map.detach() - made_map.detach()).mean())
        self._margin += _MARGIN_MEMORY * (margin - self._margin)

        self._of_generator.zero_grad()
        loss = (1 - self._judge(made)).square().mean()
        if self._regulariser is not None:
            loss = loss + self._regulariser(kernel)
        loss.backward()  # type: ignore[no-untyped-call]
        self._of_generator.step()

        self._steps += 1

    def check(self) -> None:
        """Raise if the training has failed.

        Raises
        ------
        KernelGanError
            If the kernel is not finite, its sum does not approach 1, or the discriminator
            distinguishes the patches with ease, so that the generator learns nothing from it.
        """
        where = f"the training failed: after {self._steps} steps "
        kernel = self.kernel
        if not (np.all(np.isfinite(kernel)) and np.isfinite(self._margin)):
            raise KernelGanError(
                f"{where}the kernel is not finite; try another --seed", reason="not_finite"
            )
        if self._steps < _SETTLED_STEPS:
            return
        total = float(kernel.sum())
        if abs(total - 1) > _SUM_SLACK:
            raise KernelGanError(
                f"{where}the kernel sums to {total:.2f} instead of 1; try another --seed",
                reason="wrong_sum",
            )
        if self._margin > _WON_MARGIN:
            raise KernelGanError(
                f"{where}the discriminator has won: the image's patches do not recur at this "
                "zoom; try another --seed or an image with texture all over",
                reason="discriminator_won",
            )


def train(
    picker: CropPicker,
    *,
    is_gaussian: bool,
    zoom: float,
    steps: int,
    seed: int,
    progress: Callable[[int], None] | None = None,
) -> FloatArray:
    """Return the kernel after ``steps`` steps, shape (13, 13), not normalised.

    Raises
    ------
    KernelGanError
        As soon as the training has failed.
    """
    report_steps = max(1, steps // _REPORTS)
    with one_thread():
        training = KernelGanTraining(picker, is_gaussian=is_gaussian, zoom=zoom, seed=seed)
        for done in range(1, steps + 1):
            training.step()
            if done % _CHECK_STEPS == 0 or done == steps:
                training.check()
            if progress is not None and (done % report_steps == 0 or done == steps):
                progress(done)
        return training.kernel


@contextmanager
def one_thread() -> Iterator[None]:
    """Let torch use one thread inside the block, then as many as before.

    The sums are then the same for any number of cores, and the matrices are so small that threads
    would wait for each other longer than they work.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _tensor(crop: FloatArray) -> Tensor:
    return torch.from_numpy(crop.astype(np.float32))
