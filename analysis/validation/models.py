"""The models that a validation compares, as functions from a grid to a follow-up."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.choices import VALIDATION_MODELS, ValidationModel
from simulation import MODELS, GaussianPsf, Model, SamplingGrid, zoom_out_on_grid
from simulation.kernelgan import (
    KERNEL_MODELS,
    EstimatedKernel,
    Sampler,
    kernel_operator,
)

__all__ = ["VALIDATION_MODELS", "Simulate", "ValidationModel", "is_learned", "simulator"]


Simulate = Callable[[SamplingGrid], NDArray[np.floating[Any]]]
"""Gives the follow-up of one reference on a grid."""


def is_learned(model: ValidationModel) -> bool:
    """Whether a model is trained on every reference and zoom."""
    return model in KERNEL_MODELS


def simulator(
    reference: NDArray[np.generic],
    model: ValidationModel,
    psf: GaussianPsf,
    kernel: EstimatedKernel | None = None,
    sampler: Sampler = "exact",
) -> Simulate:
    """Model as a function of the grid.

    Parameters
    ----------
    reference
        Grey, shape ``(rows, cols)``.
    model
        One of ``VALIDATION_MODELS``.
    psf
        Total PSF of the camera.
    kernel
        The trained one, for a learned model.
    sampler
        How a learned model samples.

    Raises
    ------
    ValueError
        If a learned model has no kernel.
    """
    for plain in MODELS:
        if plain == model:
            return partial(_on_grid, np.asarray(reference, dtype=np.float64), psf, plain)
    if kernel is None:
        raise ValueError(f"model {model!r} needs its trained kernel")
    return partial(_by_kernel, np.asarray(reference, dtype=np.float64), kernel, sampler)


def _on_grid(
    image: NDArray[np.float64], psf: GaussianPsf, model: Model, grid: SamplingGrid
) -> NDArray[np.floating[Any]]:
    return zoom_out_on_grid(image, grid, psf, model)


def _by_kernel(
    image: NDArray[np.float64], kernel: EstimatedKernel, sampler: Sampler, grid: SamplingGrid
) -> NDArray[np.floating[Any]]:
    shape = image.shape[0], image.shape[1]
    return kernel_operator(shape, grid, kernel, sampler).apply(image)
