"""The kernel that a model learns from a photograph, trained once and then kept."""

from dataclasses import dataclass
from pathlib import Path

from acquisition.photographs import luma_plane
from analysis.validation import KernelCache, default_cache_folder
from simulation.arrays import AnyArray
from simulation.kernelgan import (
    EstimatedKernel,
    KernelGanError,
    KernelGanSettings,
    estimate_kernel,
)
from standoff.errors import ApplicationError
from standoff.library.call import Call
from standoff.library.inputs import FilePath


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundKernel:
    """A kernel, and where it is stored."""

    kernel: EstimatedKernel
    path: Path
    is_from_cache: bool


def found_kernel(
    call: Call, reference: AnyArray, settings: KernelGanSettings, folder: FilePath | None
) -> FoundKernel:
    """Return the kernel of a photograph; train it unless it is stored.

    Raises
    ------
    ApplicationError
        If it cannot be trained.
    """
    grey = luma_plane(reference)
    cache = KernelCache(default_cache_folder() if folder is None else Path(folder))
    path = cache.path(grey, settings)
    stored = cache.load(grey, settings)
    if stored is not None:
        call.note(f"kernel taken from {path}")
        return FoundKernel(kernel=stored, path=path, is_from_cache=True)
    try:
        with call.bar(f"training {settings.model}", settings.steps) as advance_to:
            kernel = estimate_kernel(grey, settings, advance_to)
    except KernelGanError as error:
        raise ApplicationError(str(error)) from error
    cache.store(grey, settings, kernel)
    return FoundKernel(kernel=kernel, path=path, is_from_cache=False)
