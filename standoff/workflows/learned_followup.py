"""Follow-ups by KernelGAN: find or train the kernel of a photograph, then blur and sample."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.validation import KernelCache
from calibration.psf import luma_plane
from simulation import SamplingGrid
from simulation.capture_noise import CaptureNoise
from simulation.kernelgan import (
    EstimatedKernel,
    KernelGanError,
    KernelGanSettings,
    Sampler,
    estimate_kernel,
    kernel_operator,
)
from simulation.resampling import reference_shape
from standoff.errors import ApplicationError
from standoff.terminal import note, progress_bar
from standoff.workflows.followup import FollowUp, followup_by

__all__ = ["FoundKernel", "found_kernel", "zoomed_out_by_kernel"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundKernel:
    """A kernel, and where it is stored."""

    kernel: EstimatedKernel
    path: Path
    is_from_cache: bool


def found_kernel(
    reference: NDArray[np.generic],
    settings: KernelGanSettings,
    cache_folder: Path,
) -> FoundKernel:
    """Return the kernel of a photograph, trained with a bar on stderr unless it is stored.

    Raises
    ------
    ApplicationError
        If it cannot be trained.
    ResultsFileError
        If the cache cannot be read or written.
    """
    grey = luma_plane(reference)
    cache = KernelCache(cache_folder)
    path = cache.path(grey, settings)
    stored = cache.load(grey, settings)
    if stored is not None:
        note(f"kernel taken from {path}")
        return FoundKernel(kernel=stored, path=path, is_from_cache=True)
    try:
        with progress_bar(f"training {settings.model}", settings.steps) as bar:
            kernel = estimate_kernel(grey, settings, bar.advance_to)
    except KernelGanError as error:
        raise ApplicationError(str(error)) from error
    cache.store(grey, settings, kernel)
    return FoundKernel(kernel=kernel, path=path, is_from_cache=False)


def zoomed_out_by_kernel(
    reference: NDArray[np.generic],
    zoom: float,
    kernel: EstimatedKernel,
    sampler: Sampler,
    noise: CaptureNoise | None = None,
) -> FollowUp:
    """Follow-up on ``SamplingGrid.centred`` by a kernel; the reference is taken to have ``noise``.

    Raises
    ------
    ValueError
        If the image is too small for the zoom.
    """
    shape = reference_shape(reference)
    grid = SamplingGrid.centred(shape, zoom)
    return followup_by(reference, kernel_operator(shape, grid, kernel, sampler), noise)
