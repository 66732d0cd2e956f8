"""The training of KernelGAN: discriminator and generator alternately, on crops of one image.

All that is learnt is one kernel; the discriminator rates each patch of 7 x 7 px.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import sqrt
from typing import Protocol

import numpy as np
import torch
from numpy.lib.stride_tricks import sliding_window_view
from torch import Tensor
from torch.nn import functional

from simulation.arrays import FloatArray
from simulation.kernelgan._crops import CropPicker, KernelGanError

_PATCH_PX = 7  # publication, section 4.2
_DISCRIMINATOR_CHANNELS = 64
_HIDDEN_LAYERS = 5  # of 1 px, with batch normalisation
_START_STD = 0.02  # Radford et al., DCGAN, 2016, section 3
_MIDDLE_LEVEL = 0.5
_POWER_START = 20
_POWER_STEPS = 1  # per update: Miyato et al., algorithm 1
_NORM_FLOOR = 1e-12


class _PatchDiscriminator:
    """One layer of 7 x 7 px, then layers of 1 px: a map of how real each patch looks.

    Spectral normalisation on every layer, batch normalisation and ReLU after the hidden ones,
    a sigmoid at the end. Written without modules, whose initial weights come from the global
    random state.

    References
    ----------
    T. Miyato et al., "Spectral normalization for generative adversarial networks", ICLR 2018.
    """

    def __init__(self, rng: torch.Generator, dtype: torch.dtype = torch.float32) -> None:
        shapes = [
            (_DISCRIMINATOR_CHANNELS, 1, _PATCH_PX, _PATCH_PX),
            *[(_DISCRIMINATOR_CHANNELS, _DISCRIMINATOR_CHANNELS, 1, 1)] * _HIDDEN_LAYERS,
            (1, _DISCRIMINATOR_CHANNELS, 1, 1),
        ]
        self.weights: list[Tensor] = []
        self._left: list[Tensor] = []
        for shape in shapes:
            weight = _START_STD * torch.randn(shape, generator=rng, dtype=dtype)
            self.weights.append(weight.requires_grad_())
            self._left.append(torch.randn(shape[0], generator=rng, dtype=dtype))
        self.biases = [torch.zeros(s[0], dtype=dtype).requires_grad_() for s in shapes]
        self.gains = [
            torch.ones(_DISCRIMINATOR_CHANNELS, dtype=dtype).requires_grad_()
            for _ in range(_HIDDEN_LAYERS)
        ]
        self.normalise(_POWER_START)

    @property
    def parameters(self) -> list[Tensor]:
        """All trainable parameters."""
        return [*self.weights, *self.biases, *self.gains]

    def normalise(self, steps: int = _POWER_STEPS) -> None:
        """Follow the largest singular vectors of the weights by power iteration."""
        with torch.no_grad():
            for index, weight in enumerate(self.weights):
                matrix = weight.reshape(weight.shape[0], -1)
                left = self._left[index]
                for _ in range(steps):
                    right = functional.normalize(matrix.T @ left, dim=0, eps=_NORM_FLOOR)
                    left = functional.normalize(matrix @ right, dim=0, eps=_NORM_FLOOR)
                self._left[index] = left

    def normalised_weights(self) -> list[Tensor]:
        """Return the weights divided by their largest singular values, differentiable."""
        made = []
        for weight, left in zip(self.weights, self._left, strict=True):
            # |W^T u| is the singular value where u is its left vector.
            along = weight.reshape(weight.shape[0], -1).T @ left
            made.append(weight / (along.norm() + _NORM_FLOOR))
        return made

    def __call__(self, image: Tensor, layers: Sequence[Tensor] | None = None) -> Tensor:
        """Map of an image, shape (1, 1, n - 6, n - 6), between 0 and 1.

        The image has the shape (1, 1, n, n), levels from 0 to 1; 0.5 is subtracted, so as not to
        use up the first layer's gain. To train the discriminator, ``layers`` are
        ``normalised_weights()``; without them, no gradient reaches its parameters.
        """
        biases, gains = self.biases, self.gains
        if layers is None:
            with torch.no_grad():
                layers = self.normalised_weights()
            biases, gains = [b.detach() for b in biases], [g.detach() for g in gains]
        first, *hidden, last = layers
        x = functional.conv2d(image - _MIDDLE_LEVEL, first, biases[0])
        # After the first layer a patch is a row of 64 numbers.
        rows, cols = x.shape[2:]
        x = x.reshape(_DISCRIMINATOR_CHANNELS, -1).T
        for index, weight in enumerate(hidden):
            x = x @ weight[:, :, 0, 0].T
            bias, gain = biases[index + 1], gains[index]
            x = torch.relu(functional.batch_norm(x, None, None, gain, bias, training=True))
        x = x @ last[:, :, 0, 0].T + biases[-1]
        return torch.sigmoid(x).T.reshape(1, 1, rows, cols)


_LAYER_SIZES = (7, 5, 3, 1, 1, 1)  # publication, section 4.1
_GENERATOR_CHANNELS = 64  # publication, section 4.1
_START_NOISE = 0.1
"""Random part of the initial weights, relative to their Gaussian part."""


class _Generator(Protocol):
    """A kernel with trainable parameters."""

    parameters: list[Tensor]

    def kernel(self) -> Tensor:
        """Return the kernel, shape (13, 13), order (y, x), differentiable."""
        ...


def composed_kernel(layers: Sequence[Tensor]) -> Tensor:
    """The single kernel equivalent to convolution layers without activations.

    ``conv2d(.. conv2d(x, layers[0]) .., layers[-1])`` equals ``conv2d(x, composed)``; the last
    layer has one output channel. Composed from the output end, where only one channel is left, it
    costs a millionth of the layers themselves. Shape (1, in, K, K), K the sum of the ``k - 1``,
    plus 1.
    """
    composed = layers[-1]
    for weight in reversed(layers[:-1]):
        composed = functional.conv_transpose2d(composed, weight)
    return composed


def sampled(crop: Tensor, kernel: Tensor, taps: Tensor) -> Tensor:
    """The blur of a square crop at some positions, shape (1, 1, n, n).

    ``kernel`` is a correlation kernel, shape (k, k); ``taps`` the crop coordinates of its first
    weight along either axis, shape (n,). Only what is sampled is computed, as one product of a
    matrix and a vector.
    """
    size = kernel.shape[0]
    # Numpy's indexing copies whole rows of a window, torch's every number individually.
    windows = sliding_window_view(crop.numpy(), (size, size))
    seen = torch.from_numpy(windows[taps.numpy()[:, None], taps.numpy()])
    made = seen.reshape(-1, size * size) @ kernel.reshape(-1)
    return made.reshape(1, 1, len(taps), len(taps))


class DeepLinearGenerator:
    """Six convolution layers without activations: 7, 5, 3, 1, 1, 1 px, 64 channels.

    The initial weights are a Gaussian per layer times a random orthogonal mixing of the channels,
    with noise: the composed kernel starts as a blur of about ``sigma_px`` that sums to 1.
    """

    def __init__(self, rng: torch.Generator, sigma_px: float, dtype: torch.dtype) -> None:
        spread = sum(size**2 - 1 for size in _LAYER_SIZES)
        layers = []
        for index, size in enumerate(_LAYER_SIZES):
            out = 1 if index == len(_LAYER_SIZES) - 1 else _GENERATOR_CHANNELS
            into = 1 if index == 0 else _GENERATOR_CHANNELS
            mixing = torch.randn(out, into, generator=rng, dtype=torch.float64)
            if out == into:
                mixing = torch.linalg.qr(mixing)[0]
            blur = _gaussian_1d(sigma_px * sqrt((size**2 - 1) / spread), size)
            weight = mixing[:, :, None, None] * torch.outer(blur, blur)
            noise = torch.randn(weight.shape, generator=rng, dtype=torch.float64)
            layers.append(weight + _START_NOISE * noise * weight.std() / size)
        total = composed_kernel(layers).sum()
        # The last layer carries the sign, and every layer its share of the gain.
        layers[-1] = layers[-1] * torch.sign(total)
        gain = float(total.abs()) ** (-1 / len(layers))
        self.parameters = [(w * gain).to(dtype).requires_grad_() for w in layers]

    def kernel(self) -> Tensor:
        """Return the composed kernel."""
        return composed_kernel(self.parameters)[0, 0]


class _GaussianGenerator:
    """A sampled Gaussian: log sigma_y, log sigma_x and the inverse hyperbolic tangent of rho."""

    def __init__(self, sigma_px: float, dtype: torch.dtype, size: int = 13) -> None:
        start = torch.tensor([sigma_px, sigma_px], dtype=dtype).log()
        self.log_sigma_px = start.requires_grad_()
        self.atanh_rho = torch.zeros((), dtype=dtype).requires_grad_()
        self.parameters = [self.log_sigma_px, self.atanh_rho]
        self._offset = torch.arange(size, dtype=dtype) - size // 2

    def kernel(self) -> Tensor:
        """Return the Gaussian sampled at the pixels and normalised."""
        sigma_y, sigma_x = self.log_sigma_px.exp()
        rho = self.atanh_rho.tanh()
        y, x = self._offset[:, None] / sigma_y, self._offset[None, :] / sigma_x
        quadratic = (y * y - 2 * rho * y * x + x * x) / (1 - rho * rho)
        return torch.softmax(-0.5 * quadratic.reshape(-1), dim=0).reshape(quadratic.shape)


def _gaussian_1d(sigma_px: float, size: int) -> Tensor:
    if size == 1:
        return torch.ones(1, dtype=torch.float64)
    offset = torch.arange(size, dtype=torch.float64) - size // 2
    return torch.softmax(-0.5 * (offset / sigma_px) ** 2, dim=0)


_SUM_WEIGHT = 0.5  # alpha
_BOUNDARY_WEIGHT = 0.5  # beta
_SPARSE_WEIGHT = 5.0  # gamma
_CENTRE_WEIGHT = 1.0  # delta
_ROOT_FLOOR = 1e-6
"""Below this the square root of the sparsity term has no useful slope."""

_BOUNDARY_GROWTH_PX = 2.0


def _boundary_mask(size: int, dtype: torch.dtype) -> Tensor:
    """Return weights that grow exponentially with the distance from the middle, up to 1.

    The publication gives no rate; here they are 0 in the middle and e-fold in 2 px.
    """
    offset = torch.arange(size, dtype=dtype) - size // 2
    distance_px = torch.hypot(offset[:, None], offset[None, :])
    grown = torch.expm1(distance_px / _BOUNDARY_GROWTH_PX)
    return grown / grown.max()


class _KernelRegulariser:
    """Penalties for a sum other than 1, boundary weights, many weights, and an off-centre mass."""

    def __init__(self, size: int, dtype: torch.dtype) -> None:
        self._mask = _boundary_mask(size, dtype)
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

    With ``is_gaussian`` it is of a Gaussian of three parameters, without the regularisers.
    """

    def __init__(self, picker: CropPicker, *, is_gaussian: bool, zoom: float, seed: int) -> None:
        self._picker = picker
        self._rng = np.random.default_rng(seed)
        weights_rng = torch.Generator().manual_seed(seed)
        dtype = torch.float32
        sigma_px = _START_SIGMA_PER_ZOOM * zoom
        self.generator: _Generator = (
            _GaussianGenerator(sigma_px, dtype)
            if is_gaussian
            else DeepLinearGenerator(weights_rng, sigma_px, dtype)
        )
        self._judge = _PatchDiscriminator(weights_rng, dtype)
        self._regulariser = None if is_gaussian else _KernelRegulariser(13, dtype)
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
        """Raise `KernelGanError` if the training has failed.

        It has if the kernel is not finite, its sum does not approach 1, or the discriminator
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
    """The kernel after ``steps`` steps, shape (13, 13), not normalised."""
    report_steps = max(1, steps // _REPORTS)
    with _one_thread():
        training = KernelGanTraining(picker, is_gaussian=is_gaussian, zoom=zoom, seed=seed)
        for done in range(1, steps + 1):
            training.step()
            if done % _CHECK_STEPS == 0 or done == steps:
                training.check()
            if progress is not None and (done % report_steps == 0 or done == steps):
                progress(done)
        return training.kernel


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let torch use one thread inside the block: the same sums on any machine, and no slower."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _tensor(crop: FloatArray) -> Tensor:
    return torch.from_numpy(crop.astype(np.float32))
