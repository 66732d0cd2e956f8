"""The models that a validation compares, and trained kernels: one for every reference and zoom-out.

On disk each is a ``.npy`` that every tool reads, and a picture of it beside. Both are replaced as a
whole: a training that is interrupted leaves nothing.
"""

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
from joblib import Parallel, delayed, parallel_config
from numpy.typing import NDArray
from PIL import Image

from acquisition.session import Session, write_shared
from analysis.choices import CACHE_VARIABLE, PAPER_TRAINING_STEPS, ValidationModel
from analysis.design_cache import user_cache_folder
from analysis.errors import AnalysisError, ResultsFileError
from analysis.validation._screening import RegisteredPair
from simulation import MODELS, Model, Psf, SamplingGrid, zoom_out_on_grid
from simulation.arrays import AnyArray, FloatArray
from simulation.choices import KERNEL_MODELS, Sampler
from simulation.kernelgan import (
    EstimatedKernel,
    KernelGanError,
    KernelGanSettings,
    estimate_kernel,
    kernel_operator,
)

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


_TRAINING_VERSION = 1
"""Increases when training gives different kernels than before."""

_KEY_DIGITS = 24
_PICTURE_PX_PER_WEIGHT = 16


def default_cache_folder() -> Path:
    """Return the folder of ``STANDOFF_KERNEL_CACHE``, else the user's cache folder (XDG)."""
    if named := os.environ.get(CACHE_VARIABLE):
        return Path(named)
    return user_cache_folder() / "kernels"


class KernelCache:
    """A folder of trained kernels; it is created when the first is stored."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, image: AnyArray, settings: KernelGanSettings) -> Path:
        """Return the path of the kernel of an image and settings, whether or not it exists."""
        content = hashlib.sha256()
        stated = {**asdict(settings), "version": _TRAINING_VERSION}
        stated |= {"shape": image.shape, "dtype": image.dtype.str}
        content.update(json.dumps(stated, sort_keys=True).encode())
        content.update(np.ascontiguousarray(image).tobytes())
        return self.folder / f"{settings.model}-{content.hexdigest()[:_KEY_DIGITS]}.npy"

    def load(self, image: AnyArray, settings: KernelGanSettings) -> EstimatedKernel | None:
        """Return a stored kernel; None where there is none, or its file is damaged."""
        path = self.path(image, settings)
        try:
            weights = np.load(path, allow_pickle=False)
            return EstimatedKernel(weights=np.asarray(weights, dtype=np.float64))
        except FileNotFoundError:
            return None
        except OSError as error:
            raise ResultsFileError(
                f"cannot read {path}: {error.strerror or error}", source=str(path)
            ) from error
        except (ValueError, EOFError, SyntaxError, TokenError):
            # It is trained again, and the file replaced.
            return None

    def store(self, image: AnyArray, settings: KernelGanSettings, kernel: EstimatedKernel) -> Path:
        """Store a kernel and its picture; return the path of the ``.npy``."""
        path = self.path(image, settings)
        buffer = BytesIO()
        np.save(buffer, kernel.weights, allow_pickle=False)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            write_shared(path.with_suffix(".png"), _picture(kernel.weights))
            write_shared(path, buffer.getvalue())
        except OSError as error:
            raise ResultsFileError(
                f"cannot write {path}: {error.strerror or error}", source=str(path)
            ) from error
        return path


def _picture(weights: FloatArray) -> bytes:
    """Return a PNG of the weights: 0 black, the largest white, negative ones black."""
    levels = np.clip(np.rint(255 * weights / weights.max()), 0, 255).astype(np.uint8)
    magnified = np.kron(levels, np.ones((_PICTURE_PX_PER_WEIGHT,) * 2, dtype=np.uint8))
    buffer = BytesIO()
    Image.fromarray(magnified).save(buffer, format="PNG")
    return buffer.getvalue()


_ZOOM_DECIMALS = 3
"""Zooms are rounded so that a registration's last digits do not cause another training."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KernelBook:
    """Kernels of the learned models, found in the cache or trained into it.

    ``folder``: folder of the cache. ``steps, seed``: steps and seed of every training.
    """

    folder: Path
    steps: int = PAPER_TRAINING_STEPS
    seed: int = 0

    def settings(self, model: ValidationModel, zoom: float) -> KernelGanSettings | None:
        """What determines a kernel besides the image; None for a model that needs none."""
        for learned in KERNEL_MODELS:
            if learned == model:
                rounded = max(round(zoom, _ZOOM_DECIMALS), 1.0)
                return KernelGanSettings(
                    zoom=rounded, model=learned, steps=self.steps, seed=self.seed
                )
        return None

    def kernel(
        self, image: AnyArray, model: ValidationModel, zoom: float
    ) -> EstimatedKernel | None:
        """Kernel of a model for a reference and a zoom; trained here where it is not stored."""
        settings = self.settings(model, zoom)
        if settings is None:
            return None
        cache = KernelCache(self.folder)
        stored = cache.load(image, settings)
        return _trained(image, settings, self.folder) if stored is None else stored

    def inputs(
        self, image: AnyArray, models: Sequence[ValidationModel], zoom: float, psf: Psf
    ) -> ModelInputs:
        """Return what the models need to simulate a follow-up of a reference; see ``kernel``."""
        return ModelInputs(
            psf=psf, kernels={model: self.kernel(image, model, zoom) for model in models}
        )

    def train_all(
        self,
        session: Session,
        needed: Sequence[tuple[RegisteredPair, KernelGanSettings]],
        workers: int = 1,
        progress: Callable[[int], None] = lambda _: None,
    ) -> None:
        """Train what is not stored yet; each kernel is stored as soon as it is there.

        ``workers``: processes; the kernels are the same for any number.
        """
        jobs = (
            delayed(_trained)(session.load(pair.reference).mean_dn, settings, self.folder)
            for pair, settings in needed
        )
        # More workers than trainings would only be started for nothing.
        count = max(min(workers, len(needed)), 1)
        with parallel_config(backend="loky", inner_max_num_threads=1):
            results = Parallel(n_jobs=count, return_as="generator_unordered")(jobs)
            for done, _ in enumerate(results, start=1):
                progress(done)


def trainings_needed(
    session: Session,
    pairs: Sequence[RegisteredPair],
    models: Sequence[ValidationModel],
    book: KernelBook,
) -> list[tuple[RegisteredPair, KernelGanSettings]]:
    """Pairs and settings whose kernel is not stored, each kernel once."""
    cache = KernelCache(book.folder)
    needed: dict[Path, tuple[RegisteredPair, KernelGanSettings]] = {}
    for pair in pairs:
        wanted = [book.settings(model, pair.registration.zoom) for model in models]
        if not any(wanted):
            continue
        image = session.load(pair.reference).mean_dn
        for settings in wanted:
            if settings is not None and cache.load(image, settings) is None:
                needed.setdefault(cache.path(image, settings), (pair, settings))
    return list(needed.values())


def _trained(image: AnyArray, settings: KernelGanSettings, folder: Path) -> EstimatedKernel:
    try:
        kernel = estimate_kernel(image, settings)
    except KernelGanError as error:
        raise AnalysisError(f"model {settings.model}, zoom {settings.zoom:g}: {error}") from error
    KernelCache(folder).store(image, settings, kernel)
    return kernel
