"""The models that a validation compares, as functions from a grid to a follow-up."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.choices import ValidationModel
from simulation import MODELS, Model, Psf, SamplingGrid, zoom_out_on_grid
from simulation.arrays import AnyArray, FloatArray
from simulation.choices import KERNEL_MODELS, Sampler
from simulation.kernelgan import EstimatedKernel, kernel_operator

Simulate = Callable[[SamplingGrid], NDArray[np.floating[Any]]]
"""Simulates the follow-up of one reference on a grid."""


def is_learned(model: ValidationModel) -> bool:
    """Whether a model is trained on every reference and zoom."""
    return model in KERNEL_MODELS


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ModelInputs:
    """Inputs of the models to try: the total PSF, and a trained kernel for each learned one.

    ``kernels`` has an entry for every model to try, None for one that is not learned.
    """

    psf: Psf
    kernels: Mapping[ValidationModel, EstimatedKernel | None]

    def simulator(
        self, reference: AnyArray, model: ValidationModel, sampler: Sampler = "exact"
    ) -> Simulate:
        """Return a model as a function of the grid.

        ``reference``: grey, shape ``(rows, cols)``.
        """
        image = np.asarray(reference, dtype=np.float64)
        for plain in MODELS:
            if plain == model:
                return partial(_on_grid, image, self.psf, plain)
        kernel = self.kernels[model]
        if kernel is None:
            raise ValueError(f"model {model!r} needs its trained kernel")
        return partial(_by_kernel, image, kernel, sampler)


def _on_grid(
    image: FloatArray, psf: Psf, model: Model, grid: SamplingGrid
) -> NDArray[np.floating[Any]]:
    return zoom_out_on_grid(image, grid, psf, model)


def _by_kernel(
    image: FloatArray, kernel: EstimatedKernel, sampler: Sampler, grid: SamplingGrid
) -> NDArray[np.floating[Any]]:
    shape = image.shape[0], image.shape[1]
    return kernel_operator(shape, grid, kernel, sampler).apply(image)
