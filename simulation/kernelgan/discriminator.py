"""Discriminator of KernelGAN: rates how much each 7 x 7 px patch looks like the image's own."""

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

PATCH_PX = 7  # publication, section 4.2
_CHANNELS = 64
_HIDDEN_LAYERS = 5  # of 1 px, with batch normalisation
_START_STD = 0.02  # Radford et al., DCGAN, 2016, section 3
_MIDDLE_LEVEL = 0.5
_POWER_START = 20
_POWER_STEPS = 1  # per update: Miyato et al., algorithm 1
_NORM_FLOOR = 1e-12


class PatchDiscriminator:
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
            (_CHANNELS, 1, PATCH_PX, PATCH_PX),
            *[(_CHANNELS, _CHANNELS, 1, 1)] * _HIDDEN_LAYERS,
            (1, _CHANNELS, 1, 1),
        ]
        self.weights: list[Tensor] = []
        self._left: list[Tensor] = []
        for shape in shapes:
            weight = _START_STD * torch.randn(shape, generator=rng, dtype=dtype)
            self.weights.append(weight.requires_grad_())
            self._left.append(torch.randn(shape[0], generator=rng, dtype=dtype))
        self.biases = [torch.zeros(s[0], dtype=dtype).requires_grad_() for s in shapes]
        self.gains = [
            torch.ones(_CHANNELS, dtype=dtype).requires_grad_() for _ in range(_HIDDEN_LAYERS)
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
        """Return the map of an image, shape (1, 1, n - 6, n - 6), between 0 and 1.

        Parameters
        ----------
        image
            Shape (1, 1, n, n), levels from 0 to 1; 0.5 is subtracted, so as not to use up the
            first layer's gain.
        layers
            ``normalised_weights()``, to train the discriminator; without them, no gradient reaches
            its parameters.
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
        x = x.reshape(_CHANNELS, -1).T
        for index, weight in enumerate(hidden):
            x = x @ weight[:, :, 0, 0].T
            bias, gain = biases[index + 1], gains[index]
            x = torch.relu(functional.batch_norm(x, None, None, gain, bias, training=True))
        x = x @ last[:, :, 0, 0].T + biases[-1]
        return torch.sigmoid(x).T.reshape(1, 1, rows, cols)
