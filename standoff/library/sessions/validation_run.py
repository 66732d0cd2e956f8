"""Validates a session and writes all the results."""

from collections.abc import Iterable
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path

from acquisition.session import Session, utc_text
from analysis.choices import PAPER_TRAINING_STEPS, VALIDATION_MODELS, ValidationModel
from analysis.errors import ResultsFileError
from analysis.reports import plot_curves, plot_images, png_bytes, render_validation, svg_bytes
from analysis.results_file import write_results
from analysis.validation import (
    KernelBook,
    Validation,
    ValidationSettings,
    both_tables,
    curves_csv,
    default_cache_folder,
    is_learned,
    read_validation,
    registrations_at_most,
    screen,
    shown_pairs,
    trainings_needed,
    validate as validated,
)
from calibration.psf import PsfCalibration
from simulation import Psf
from simulation.arguments import checked
from simulation.choices import PsfShape
from standoff.errors import ApplicationError, ArgumentError
from standoff.library.call import Call, Progress
from standoff.library.files import (
    RESULTS_FOLDER,
    make_folder,
    make_results_folder,
    write_file,
    write_page,
    written_together,
)
from standoff.library.inputs import FilePath, opened_session, path_of
from standoff.library.psf import calibration_of, camera_psf

_FILE = "validation.json"
_PAGE = "report.html"
_TABLES = "table_1", "table_2"
VALIDATION_FILES = (
    _FILE,
    _PAGE,
    "curves.csv",
    *(f"{name}{suffix}" for name in _TABLES for suffix in (".txt", ".csv", ".tex")),
    *(f"{name}{suffix}" for name in ("figure_2", "figure_3") for suffix in (".png", ".svg")),
)
"""What ``run_validation`` writes into its folder."""


@checked
def validate(
    session: Session | FilePath,
    psf: FilePath,
    out: FilePath,
    *,
    models: Iterable[ValidationModel] | None = None,
    transfer: PsfShape = "best",
    references: int = 2,
    steps: int = PAPER_TRAINING_STEPS,
    seed: int = 0,
    workers: int = 1,
    kernel_cache: FilePath | None = None,
    progress: Progress | None = None,
) -> Validation:
    """Measure how well each model predicts the captured follow-ups of a session.

    Tables, figures, report and validation.json go into the folder ``out``. After an interruption,
    the same call goes on with the kernels already trained.

    Parameters
    ----------
    session
        With textures or charts at two or more heights.
    psf
        psf.json of the camera, best calibrated for the centre of the frame.
    out
        Folder for the results.
    models
        In any order; by default all but ``gaussian-kernelgan``, KernelGAN if PyTorch is installed.
    transfer
        Which PSF of the file: the ``best`` it has, the ``gaussian`` or the ``measured`` one.
    references
        Reference poses per target, the nearest first.
    steps, seed, workers, kernel_cache
        For models that learn: training steps, seed, processes, folder of trained kernels.
    progress
        Who watches.

    Returns
    -------
    Validation
        All pairs with their metrics, Tables I and II, and what was excluded.

    Raises
    ------
    ArgumentError
        If a model is unknown.
    AnalysisError, ApplicationError, CalibrationError, SessionError
        If the captures cannot be validated, or a file cannot be read or written.

    Examples
    --------
    >>> models = ["bicubic", "matched"]
    >>> tables = standoff.validate("session", "psf.json", "validation", models=models)
    >>> error = {name: row.mse_dn2 for name, row in tables.means("as-in-paper").items()}
    >>> error["matched"] < error["bicubic"]
    True
    """
    call = Call("validate", progress)
    chosen = default_models(call) if models is None else _ordered(tuple(models))
    settings = ValidationSettings(
        models=chosen,
        kernels=KernelBook(
            folder=default_cache_folder() if kernel_cache is None else Path(kernel_cache),
            steps=steps,
            seed=seed,
        ),
        references=references,
        workers=workers,
        calibration=calibration_of(path_of(psf, "psf")),
    )
    path = path_of(psf, "psf")
    camera = camera_psf(call, path, transfer)
    folder = path_of(out, "out")
    return run_validation(call, folder, opened_session(session), camera, str(path), settings)


def _ordered(models: tuple[ValidationModel, ...]) -> tuple[ValidationModel, ...]:
    unknown = [name for name in models if name not in VALIDATION_MODELS]
    if unknown:
        raise ArgumentError(
            f"unknown model {unknown[0]!r}; the models are {', '.join(VALIDATION_MODELS)}"
        )
    return tuple(model for model in VALIDATION_MODELS if model in models)


def default_models(call: Call) -> tuple[ValidationModel, ...]:
    """Return the paper's models and ours; KernelGAN only if PyTorch is installed."""
    models = [model for model in VALIDATION_MODELS if model != "gaussian-kernelgan"]
    if find_spec("torch") is None:
        call.note(
            "PyTorch is not installed: model kernelgan is left out; "
            "pip install standoff[kernelgan] adds it"
        )
        models = [model for model in models if not is_learned(model)]
    return tuple(models)


def run_validation(
    call: Call, out: Path, session: Session, psf: Psf, psf_name: str, settings: ValidationSettings
) -> Validation:
    """Validate a session, and write tables, figures, report and JSON into the folder ``out``."""
    if any(map(is_learned, settings.models)) and find_spec("torch") is None:
        raise ApplicationError(
            "the learned models need PyTorch: pip install standoff[kernelgan], or leave them out "
            "with --models"
        )
    make_folder(out)
    validation = _validated(call, session, psf, psf_name, settings)
    shown = shown_pairs(session, validation, psf, settings.kernels)
    with written_together(out / _FILE) as folder:
        _write_tables(folder, validation)
        for name, figure in (
            ("figure_2", plot_images(shown)),
            ("figure_3", plot_curves(validation)),
        ):
            write_file(folder / f"{name}.png", png_bytes(figure))
            write_file(folder / f"{name}.svg", svg_bytes(figure))
        write_page(folder / _PAGE, render_validation(session, validation, shown))
        write_results(folder / _FILE, validation)
    return validation


def session_validation(
    call: Call,
    session: Session,
    psf: Psf,
    psf_name: str,
    calibration: PsfCalibration | None = None,
) -> Validation:
    """Return the validation among a session's results, after making it if needed.

    An existing one is used if it has this PSF and the session's captures have not changed since. A
    new one has the models that need no training, and its tables are written beside it.

    Raises
    ------
    AnalysisError, ApplicationError, SessionError
        If the captures cannot be validated, or a file cannot be read or written.
    """
    stored = _stored_validation(call, session, psf)
    if stored is not None:
        return stored
    settings = ValidationSettings(calibration=calibration)
    validation = _validated(call, session, psf, psf_name, settings)
    results = make_results_folder(session.path)
    with written_together(results / _FILE) as folder:
        _write_tables(folder, validation)
        write_results(folder / _FILE, validation)
    return validation


def _stored_validation(call: Call, session: Session, psf: Psf) -> Validation | None:
    path = session.path / RESULTS_FOLDER / _FILE
    if not path.is_file():
        return None
    try:
        stored = read_validation(path)
    except ResultsFileError as error:
        call.note(f"{error}; the captures are compared again")
        return None
    is_older = _is_older(path, stored, session.changed_utc)
    if stored.is_of(psf) and not is_older:
        return stored
    reason = (
        "older than the last change of the session's captures" if is_older else "of another PSF"
    )
    call.note(f"{path} is {reason}: the captures are compared again")
    return None


def _is_older(path: Path, stored: Validation, changed_utc: str) -> bool:
    """Whether a validation was written before a moment.

    A copy of the file may be newer than what it says of itself, which is known to the second.
    """
    written = utc_text(datetime.fromtimestamp(path.stat().st_mtime, UTC))
    created = written if stored.provenance is None else stored.provenance.created
    return written < changed_utc or created < changed_utc.partition(".")[0]


def _validated(
    call: Call, session: Session, psf: Psf, psf_name: str, settings: ValidationSettings
) -> Validation:
    provenance = call.provenance_of(session, Path(psf_name))
    total = registrations_at_most(session, settings.references)
    with call.bar("aligning", total) as advance_to:
        screening = screen(session, psf, references=settings.references, progress=advance_to)
    for one in screening.excluded:
        call.note(f"excluded: {one.text}")
    for remark in screening.remarks:
        call.note(remark)
    needed = trainings_needed(session, screening.pairs, settings.models, settings.kernels)
    if needed:
        with call.bar("training kernels", len(needed)) as advance_to:
            settings.kernels.train_all(session, needed, settings.workers, advance_to)
    with call.bar("comparing", len(screening.pairs)) as advance_to:
        validation = validated(
            session,
            psf,
            settings,
            screening=screening,
            psf_name=psf_name,
            progress=advance_to,
        )
    return validation.model_copy(update={"provenance": provenance})


def _write_tables(out: Path, validation: Validation) -> None:
    for table in both_tables(validation):
        for suffix, text in (
            (".txt", table.text()),
            (".csv", table.csv()),
            (".tex", table.latex()),
        ):
            write_file(out / f"{table.name}{suffix}", text.encode("utf-8"))
    write_file(out / "curves.csv", curves_csv(validation).encode("utf-8"))
