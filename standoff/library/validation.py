"""A session's predictions held against its photographs, and the report on a session."""

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.util import find_spec
from os.path import lexists
from pathlib import Path
from typing import Any

from acquisition.files import (
    PAGES,
    RESULTS_FOLDER,
    make_folder,
    make_results_folder,
    require_writable,
    write_file,
    write_page,
    written_together,
)
from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from acquisition.session import Session, utc_text, verify
from analysis.changes import read_changes
from analysis.choices import PAPER_TRAINING_STEPS, VALIDATION_MODELS, ValidationModel
from analysis.errors import AnalysisError, ResultsFileError
from analysis.pose import read_pose
from analysis.reports import (
    ReportSection,
    SessionNotes,
    plot_curves,
    plot_images,
    png_bytes,
    psf_remarks,
    session_report,
    stored_changes_section,
    stored_pose_section,
    svg_bytes,
    validation_report,
)
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
    validated,
)
from calibration.errors import PsfFileError
from calibration.files import read_psf
from calibration.psf import PsfCalibration
from simulation import Psf
from simulation.arguments import checked
from simulation.choices import PsfShape
from simulation.notebook import Shown
from standoff.errors import ApplicationError, ArgumentError
from standoff.library.call import Call, FilePath, Progress, opened_session, output_path, path_of
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
        A session, or its folder, with textures or charts at two or more heights.
    psf
        Path of the camera's psf.json, preferably calibrated on the centre of the frame.
    out
        Folder for the results.
    models
        Models to validate, in any order; by default all but ``gaussian-kernelgan``, and
        ``kernelgan`` only if PyTorch is installed.
    transfer
        Which PSF of the file to use: ``measured``, ``gaussian``, or ``best``: the measured one if
        the file has it, else the Gaussian.
    references
        Number of reference poses per target; the nearest poses are taken.
    steps, seed, workers, kernel_cache
        For models that learn: number of training steps, random seed, number of processes, and
        folder in which trained kernels are kept.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

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
        write_page(folder / _PAGE, validation_report(session, validation, shown).html())
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


_DEPTHS = ("*/", "*/*/", "*/*/*/")
"""Folders below the results in which comparisons are looked for: changes, target, capture."""

_SHOWN = 12


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class WrittenReport(Shown):
    """A report on a session, and remarks on it in ``notes``."""

    session: Path
    report: Path
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the paths as ``standoff report --json`` prints them."""
        return {"session": str(self.session), "report": str(self.report)}


@checked
def write_report(
    session: Session | FilePath, out: FilePath | None = None, *, progress: Progress | None = None
) -> WrittenReport:
    """Write a report on a session and the results obtained from it so far.

    Parameters
    ----------
    session
        A session or its folder.
    out
        Path of the report, HTML or PDF; by default ``results/report.html`` in the session.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    WrittenReport
        The folder of the session, the path of the report, and remarks.

    Raises
    ------
    ApplicationError
        If a file cannot be written.
    CalibrationError, SessionError
        If the results or captures cannot be read.

    Examples
    --------
    >>> standoff.write_report("session").report.name
    'report.html'
    """
    call, opened = Call("write_report", progress), opened_session(session)
    results = make_results_folder(opened.path)
    page = results / "report.html" if out is None else output_path(out, "out", PAGES)
    require_writable([page])
    if not lexists(results / "psf.json"):
        call.note(
            f"{results / 'psf.json'} is missing: the report shows no PSF; standoff calibrate "
            f"--session {opened.path} --out {results / 'psf.json'} writes it"
        )
    spoilt = [
        check
        for check in verify(opened.path).files
        if check.state in ("missing", "changed") and not check.is_superseded
    ]
    if spoilt:
        call.note(
            f"{len(spoilt)} files of the session are missing or changed, the first "
            f"{spoilt[0].file}; standoff verify {opened.path} lists them"
        )
    write_session_report(call, opened, page)
    return WrittenReport(session=opened.path, report=page, notes=call.notes)


def write_session_report(
    call: Call, session: Session, path: Path, more: tuple[ReportSection, ...] = ()
) -> None:
    """Write the report of a session, from the contents of its results folder, and ``more``.

    If the PSF is known and a target was captured at several heights, the captures are compared
    with their simulations, using ``results/validation.json``, which is written if it is missing
    or out of date.
    """
    psf_path = session.path / RESULTS_FOLDER / "psf.json"
    psf = read_psf(psf_path) if lexists(psf_path) else None
    # All that is shown is read before anything is written.
    comparisons = _comparisons(call, session.path / RESULTS_FOLDER)
    if psf is not None and psf.edges:
        for remark in psf_remarks(psf):
            call.note(remark)
    validation = None
    remarks: tuple[str, ...] = ()
    if psf is not None and registrations_at_most(session, 1):
        try:
            validation = _validation(call, session, psf, psf_path)
        except (AnalysisError, PsfFileError) as error:
            remarks = (f"No comparison of captured with simulated follow-ups: {error}.",)
            call.note(f"the report leaves out the comparison of heights: {error}")
    origin = call.provenance_of(session, None if psf is None else psf_path)
    notes = SessionNotes(
        remarks=remarks,
        warnings=call.notes,
        comparisons=(*comparisons, *more),
        origin=origin,
    )
    write_page(path, session_report(session, psf, validation, notes).html())


def _validation(call: Call, session: Session, psf: PsfCalibration, psf_path: Path) -> Validation:
    name = str(psf_path)
    return session_validation(call, session, psf.best_psf(name), name, psf)


def _comparisons(call: Call, results: Path) -> tuple[ReportSection, ...]:
    """A section for each changes.json and pose.json of the results; of very many, the first."""
    poses, changes = (_found(results, name) for name in ("pose.json", "changes.json"))
    sections = [
        stored_pose_section(_name(path, results), read_pose(path)) for path in poses[:_SHOWN]
    ]
    for path in changes[:_SHOWN]:
        figure = path.with_name("changes-figure.png")
        picture = read_regular_file(figure, LARGEST_IMAGE_BYTES) if figure.is_file() else None
        sections.append(stored_changes_section(_name(path, results), read_changes(path), picture))
    left_out = max(len(poses) - _SHOWN, 0) + max(len(changes) - _SHOWN, 0)
    if left_out:
        call.note(f"the report shows {len(sections)} comparisons, {left_out} more are in {results}")
    return tuple(sections)


def _found(results: Path, name: str) -> list[Path]:
    folders = [results, *(folder for depth in _DEPTHS for folder in results.glob(depth))]
    return sorted(path for folder in folders if lexists(path := folder / name))


def _name(path: Path, results: Path) -> str:
    folder = path.parent.relative_to(results)
    return str(folder) if folder.parts else path.name
