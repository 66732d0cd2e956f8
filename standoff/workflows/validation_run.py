"""Validates a session and writes everything that comes of it."""

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from acquisition.session import Session
from analysis.reports import plot_curves, plot_images, png_bytes, render_validation, svg_bytes
from analysis.results_file import write_results
from analysis.validation import (
    VALIDATION_MODELS,
    KernelBook,
    Validation,
    ValidationModel,
    both_tables,
    curves_csv,
    is_learned,
    registrations_at_most,
    screen,
    trainings_needed,
    validate,
    validation_document,
)
from simulation import GaussianPsf
from standoff.errors import ApplicationError
from standoff.terminal import note, progress_bar
from standoff.workflows.reports import make_folder, write_file, write_page

__all__ = ["ValidationSettings", "default_models", "run_validation"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ValidationSettings:
    """How a validation is made.

    ``references`` are the reference poses of every target, ``workers`` the processes that train
    kernels.
    """

    models: tuple[ValidationModel, ...]
    kernels: KernelBook
    references: int = 2
    workers: int = 1


def default_models() -> tuple[ValidationModel, ...]:
    """Return the paper's models and ours; KernelGAN only where PyTorch is installed."""
    models = [model for model in VALIDATION_MODELS if model != "gaussian-kernelgan"]
    if find_spec("torch") is None:
        note("PyTorch is not installed: model kernelgan is left out; the extra kernelgan has it")
        models = [model for model in models if not is_learned(model)]
    return tuple(models)


def run_validation(
    out: Path, session: Session, psf: GaussianPsf, psf_name: str, settings: ValidationSettings
) -> tuple[Validation, dict[str, Any]]:
    """Validate a session, and write tables, figures, report and JSON into the folder ``out``.

    Interrupted, the same command goes on with the kernels that were trained.

    Raises
    ------
    AnalysisError, ApplicationError, SessionError
        If the captures do not allow it or a file cannot be read or written.
    """
    if any(map(is_learned, settings.models)) and find_spec("torch") is None:
        raise ApplicationError(
            "the learned models need PyTorch: pip install standoff[kernelgan], or leave them out "
            "with --models"
        )
    make_folder(out)
    total = registrations_at_most(session, settings.references)
    with progress_bar("aligning", total) as bar:
        screening = screen(session, psf, references=settings.references, progress=bar.advance_to)
    for one in screening.excluded:
        note(f"excluded: {one.text}")
    for remark in screening.remarks:
        note(remark)
    needed = trainings_needed(session, screening.pairs, settings.models, settings.kernels)
    if needed:
        with progress_bar("training kernels", len(needed)) as bar:
            settings.kernels.train_all(session, needed, settings.workers, bar.advance_to)
    with progress_bar("comparing", len(screening.pairs)) as bar:
        validation = validate(
            session, psf, screening, settings.models, settings.kernels, bar.advance_to
        )
    document = validation_document(validation, _facts(session, psf, psf_name, settings))
    _write_all(out, session, validation, document)
    return validation, document


def _facts(
    session: Session, psf: GaussianPsf, psf_name: str, settings: ValidationSettings
) -> dict[str, Any]:
    return {
        "session": str(session.path),
        "psf": psf_name,
        "psf_covariance_px2": psf.covariance_px2.tolist(),
        "models": list(settings.models),
        "references_per_target": settings.references,
        "training_steps": settings.kernels.steps,
        "training_seed": settings.kernels.seed,
    }


def _write_all(
    out: Path, session: Session, validation: Validation, document: dict[str, Any]
) -> None:
    for table in both_tables(validation):
        for suffix, text in (
            (".txt", table.text()),
            (".csv", table.csv()),
            (".tex", table.latex()),
        ):
            write_file(out / f"{table.name}{suffix}", text.encode("utf-8"))
    write_file(out / "curves.csv", curves_csv(validation).encode("utf-8"))
    for name, figure in (
        ("figure_2", plot_images(validation)),
        ("figure_3", plot_curves(validation)),
    ):
        write_file(out / f"{name}.png", png_bytes(figure))
        write_file(out / f"{name}.svg", svg_bytes(figure))
    facts = (
        ("psf", str(document["psf"])),
        ("models", ", ".join(validation.models)),
        ("steps of a training", str(document["training_steps"])),
    )
    write_page(out / "report.html", render_validation(session, validation, facts))
    # Last, so that who finds it finds the rest.
    write_results(out / "validation.json", document)
