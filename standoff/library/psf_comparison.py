"""Whether a PSF has changed: comparison of two calibrations, or of many over time."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from acquisition.dataframe import dataframe
from acquisition.files import PAGES, Provenance, require_folder, require_writable, write_page
from analysis.reports import (
    HistoryEntry,
    ReportSection,
    history_document,
    history_report,
    history_sections,
    ordered_history,
    plot_history,
)
from calibration.errors import CalibrationError
from calibration.files import read_psf
from calibration.psf import PsfCalibration, PsfChange, psf_change
from simulation.arguments import checked
from simulation.notebook import Shown, html_table, in_words, shortened
from standoff.errors import ApplicationError, ArgumentError
from standoff.library.call import Call, FilePath, Progress, output_path, path_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class PsfComparison(Shown, PsfChange):
    """Tests whether the parameters that two calibrations give have changed."""

    first: str
    second: str

    @property
    def notes(self) -> tuple[str, ...]:
        """Why the two may not be comparable, and what only one of them gives."""
        return self.remarks

    def __repr__(self) -> str:
        return f"<PsfComparison: {shortened(self.verdict, 170)}>"

    def _repr_html_(self) -> str:
        names = ("name", "first", "second", "z")
        return html_table(
            self.verdict,
            ("parameter", "first", "second", "z"),
            [[in_words(one.to_json().get(name)) for name in names] for one in self.parameters],
        )

    def to_dataframe(self) -> "DataFrame":
        """Return the parameters as a pandas table, one row per parameter.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return dataframe(one.to_json() for one in self.parameters)

    def to_json(self) -> dict[str, Any]:
        """Return the comparison as ``standoff compare --json`` prints it."""
        return {
            "first": self.first,
            "second": self.second,
            "is_changed": bool(self.changed),
            "verdict": self.verdict,
            "remarks": list(self.remarks),
            "shared_inputs": list(self.shared_inputs),
            "parameters": [one.to_json() for one in self.parameters],
        }


@checked
def compare_psfs(
    first: PsfCalibration | FilePath, second: PsfCalibration | FilePath
) -> PsfComparison:
    """Test whether the PSF has changed between two calibrations.

    Parameters
    ----------
    first, second
        Calibrations, or the paths of their psf.json.

    Returns
    -------
    PsfComparison
        A z-test of each parameter that both give. ``verdict`` is the result in one sentence;
        ``notes`` say what only one of them gives, and why the two may not be comparable.

    Raises
    ------
    CalibrationError
        If a file cannot be read, or the two share no width with standard errors.

    Examples
    --------
    >>> found = standoff.compare_psfs("psf.json", "lens-files/psf-vertical.json")
    >>> found.verdict.split(":")[0]
    'the PSF has changed'
    """
    names = tuple(
        "psf" if isinstance(one, PsfCalibration) else str(path_of(one, "psf"))
        for one in (first, second)
    )
    pair = [
        one if isinstance(one, PsfCalibration) else read_psf(Path(one)) for one in (first, second)
    ]
    try:
        change = psf_change(*pair)
    except CalibrationError as error:
        raise CalibrationError(f"{names[0]} and {names[1]}: {error}") from error
    return PsfComparison(
        first=names[0],
        second=names[1],
        parameters=change.parameters,
        remarks=change.remarks,
        shared_inputs=change.shared_inputs,
    )


@dataclass(frozen=True, kw_only=True, repr=False)
class PsfHistory(Shown):
    """Calibrations of each camera in order of time; ``notes`` say which files were left out."""

    calibrations: dict[str, list[HistoryEntry]]
    provenance: Provenance
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        counts = (f"{len(found)} of {serial}" for serial, found in self.calibrations.items())
        return f"<PsfHistory: {shortened(', '.join(counts), 170)}>"

    def _repr_html_(self) -> str:
        names = ("camera", "file", "captured_utc", "sigma_x_px", "sigma_y_px", "change")
        rows = [[in_words(row.get(name)) for name in names] for row in self._rows()]
        return html_table("calibrations by camera and time", names, rows)

    def _rows(self) -> Iterator[dict[str, Any]]:
        for camera in history_document(self.calibrations)["cameras"]:
            for row in camera["calibrations"]:
                yield {"camera": camera["serial"], **row}

    def to_dataframe(self) -> "DataFrame":
        """Return the calibrations as a pandas table, one row per calibration.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return dataframe(self._rows())

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of the total widths over time.

        Raises
        ------
        ArgumentError
            If fewer than two calibrations state when their photographs were taken.
        """
        found = plot_history([one for some in self.calibrations.values() for one in some], ax)
        if found is None:
            raise ArgumentError("fewer than two calibrations say when they were captured")
        return found

    @cached_property
    def sections(self) -> tuple[ReportSection, ...]:
        """Tables and figures, one section per camera."""
        return tuple(history_sections(self.calibrations))

    def to_json(self) -> dict[str, Any]:
        """Return the history as ``standoff compare --history --json`` prints it."""
        provenance = self.provenance.model_dump(mode="json")
        return {**history_document(self.calibrations), "provenance": provenance}

    def write_report(self, path: FilePath) -> None:
        """Write a report on the history, HTML or PDF.

        Raises
        ------
        ApplicationError
            If the file cannot be written.
        """
        out = output_path(path, "path", PAGES)
        require_writable([out])
        write_page(out, history_report(self.calibrations, self.provenance).html())


@checked
def psf_history(
    files: FilePath | Iterable[FilePath], *, progress: Progress | None = None
) -> PsfHistory:
    """Return calibrations by camera, each camera's in order of time.

    Parameters
    ----------
    files
        Paths of psf.json files, or of folders that are searched, with their subfolders, for files
        named ``*psf*.json``. A file found in a folder that cannot be read is left out, with a note.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    PsfHistory
        The calibrations of each camera in order of time.

    Raises
    ------
    CalibrationError
        If a file that was named cannot be read.
    ApplicationError
        If there is no psf.json, or a folder cannot be read.

    Examples
    --------
    >>> history = standoff.psf_history("lens-files")
    >>> history.write_report("history.html")
    """
    call = Call("psf_history", progress)
    paths = [Path(one) for one in ([files] if isinstance(files, str | PathLike) else files)]
    found = []
    for path in paths:
        if not path.is_dir():
            found.append((str(path), read_psf(path)))
            continue
        require_folder(path)
        for file in sorted(path.rglob("*psf*.json")):
            try:
                found.append((str(file), read_psf(file)))
            except CalibrationError as error:
                call.note(f"left out: {error}")
    if not found:
        raise ApplicationError(f"no psf.json in {', '.join(map(str, paths))}")
    for name, _ in found:
        call.inputs.add(Path(name))
    return PsfHistory(
        calibrations=ordered_history(found), provenance=call.provenance(), notes=call.notes
    )
