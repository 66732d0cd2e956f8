"""Errors of a KernelGAN training."""

from typing import Literal

KernelGanReason = Literal[
    "torch_missing", "flat", "too_small", "not_finite", "wrong_sum", "discriminator_won"
]
"""``discriminator_won``: the discriminator distinguishes the patches with ease."""


class KernelGanError(Exception):
    """No kernel could be trained on this image; the message says what to do."""

    def __init__(self, message: str, *, reason: KernelGanReason = "too_small") -> None:
        super().__init__(message)
        self.reason = reason


class TorchMissingError(KernelGanError, ImportError):
    """PyTorch is not installed."""
