"""Generators of KernelGAN: all that they learn from the image is one kernel."""

from collections.abc import Sequence
from math import sqrt
from typing import Protocol

import torch
from numpy.lib.stride_tricks import sliding_window_view
from torch import Tensor
from torch.nn import functional

_LAYER_SIZES = (7, 5, 3, 1, 1, 1)  # publication, section 4.1
_CHANNELS = 64  # publication, section 4.1
_START_NOISE = 0.1
"""Random part of the initial weights, relative to their Gaussian part."""


class Generator(Protocol):
    """A kernel with trainable parameters."""

    parameters: list[Tensor]

    def kernel(self) -> Tensor:
        """Return the kernel, shape (13, 13), order (y, x), differentiable."""
        ...


def composed_kernel(layers: Sequence[Tensor]) -> Tensor:
    """Return the single kernel equivalent to convolution layers without activations.

    ``conv2d(.. conv2d(x, layers[0]) .., layers[-1])`` equals ``conv2d(x, composed)``. Composed
    from the output end, where only one channel is left, it costs a millionth of the layers
    themselves.

    Parameters
    ----------
    layers
        Weights as ``conv2d`` takes them, shapes (out, in, k, k), first layer first; the last
        has one output channel.

    Returns
    -------
    Tensor
        Shape (1, in, K, K), K the sum of the ``k - 1``, plus 1.
    """
    composed = layers[-1]
    for weight in reversed(layers[:-1]):
        composed = functional.conv_transpose2d(composed, weight)
    return composed


def sampled(crop: Tensor, kernel: Tensor, taps: Tensor) -> Tensor:
    """Return the blur of a crop at some positions, shape (1, 1, n, n).

    Only what is sampled is computed, as one product of a matrix and a vector.

    Parameters
    ----------
    crop
        Shape (side, side).
    kernel
        Correlation kernel, shape (k, k).
    taps
        Crop coordinates of the kernel's first weight, along either axis, shape (n,).
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
            out = 1 if index == len(_LAYER_SIZES) - 1 else _CHANNELS
            into = 1 if index == 0 else _CHANNELS
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


class GaussianGenerator:
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
