"""Trained kernels for a validation: one for every reference and zoom-out, as in the paper."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from joblib import Parallel, delayed, parallel_config

from acquisition.session import Session
from analysis.choices import PAPER_TRAINING_STEPS, ValidationModel
from analysis.errors import AnalysisError
from analysis.validation.kernel_cache import KernelCache
from analysis.validation.models import ModelInputs
from analysis.validation.screening import RegisteredPair
from simulation import Psf
from simulation.arrays import AnyArray
from simulation.choices import KERNEL_MODELS
from simulation.kernelgan import EstimatedKernel, KernelGanError, KernelGanSettings, estimate_kernel

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
        self,
        image: AnyArray,
        models: Sequence[ValidationModel],
        zoom: float,
        psf: Psf,
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
