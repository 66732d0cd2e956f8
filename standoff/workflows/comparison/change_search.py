"""Finds what changed between two photograph files, and writes a list and maps of the changes."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from io import StringIO
from pathlib import Path
from threading import Lock

import numpy as np

from analysis.changes import Change, ChangeOptions, ChangeResult, ChangeSummary, find_changes
from analysis.errors import AnalysisError
from analysis.reports import plot_changes
from analysis.results_file import write_results
from calibration.errors import CalibrationError
from simulation import Psf, PsfField
from simulation.arrays import BoolArray, Float32Array
from simulation.choices import PsfShape
from standoff.photographs import Inputs, Photograph
from standoff.workflows.comparison.alignment_hints import AlignmentHints, white_level_dn
from standoff.workflows.comparison.change_page import page_of_changes
from standoff.workflows.figure_files import write_figure
from standoff.workflows.image_files import write_float_tiff, write_mask
from standoff.workflows.output_files import write_file
from standoff.workflows.psf_files import frame_psf

CHANGE_FILES = (
    "difference.tif",
    "plain-difference.tif",
    "pose-difference.tif",
    "uncertainty.tif",
    "significance.tif",
    "changes.png",
    "compared.png",
    "changes-figure.png",
    "changes.csv",
    "report.html",
    "changes.json",
)
"""Files that a comparison writes; the last one last."""

_DRAWING = Lock()
"""Matplotlib's style is one for all threads, of which a Dask worker may have several."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ComparisonRequest:
    """How two photographs are compared.

    Parameters
    ----------
    psf
        psf.json of the camera, if there is one.
    transfer
        Which PSF of the file.
    options
        Noise and the rate of false alarms; poses and masks come from ``hints``.
    hints
        What the operator knows of the pose, and pixels that do not count.
    white_level
        Level of the files at which they are clipped; None takes the files' own.
    """

    psf: Path | None = None
    transfer: PsfShape = "best"
    options: ChangeOptions = field(default_factory=ChangeOptions)
    hints: AlignmentHints = field(default_factory=AlignmentHints)
    white_level: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ComparedPair:
    """Two photographs and what changed between them; ``left_out`` is the operator's mask."""

    reference: Photograph
    followup: Photograph
    found: ChangeResult
    left_out: BoolArray | None

    def page(self, summary: ChangeSummary) -> str:
        """Return the report as one HTML document; the summary has names and provenance."""
        return page_of_changes(self.reference, self.followup, self.found, summary, self.left_out)


def find_changes_of_files(
    reference: Path, followup: Path, request: ComparisonRequest, inputs: Inputs
) -> ComparedPair:
    """Align two photographs and compare them.

    Raises
    ------
    ApplicationError
        If a photograph cannot be read, or a hint does not belong to it.
    AnalysisError, CalibrationError
        If they cannot be compared or aligned; the message names the follow-up.
    """
    near, far = inputs.photograph(reference), inputs.photograph(followup)
    psf = None
    if request.psf is not None:
        rows, cols = far.stored.shape[:2]
        frame = (cols, rows) if near.stored.shape[:2] == (rows, cols) else None
        psf = frame_psf(request.psf, frame, "matched", request.transfer)
    return compared(near, far, psf, request)


def compared(
    near: Photograph, far: Photograph, psf: Psf | PsfField | None, request: ComparisonRequest
) -> ComparedPair:
    """Align and compare two photographs; errors name the follow-up.

    Raises
    ------
    AnalysisError, CalibrationError
        If they cannot be compared or aligned.
    ApplicationError
        If a hint does not belong to them.
    """
    stated, hints = request.white_level, request.hints
    options = replace(
        request.options,
        hints=hints.of_pair(near.stored.shape[:2], far.stored.shape[:2], far.name),
        left_out=hints.left_out,
        white_level_dn=(white_level_dn(near, stated), white_level_dn(far, stated)),
        variance_dn2=(_variance_dn2(near), _variance_dn2(far)),
    )
    try:
        found = find_changes(near.grey_dn, far.grey_dn, psf, options)
    except CalibrationError as error:
        raise CalibrationError(f"{far.path}: {error}") from error
    except AnalysisError as error:
        raise AnalysisError(f"{far.path}: {error}") from error
    return ComparedPair(reference=near, followup=far, found=found, left_out=hints.left_out)


def _variance_dn2(photograph: Photograph) -> Float32Array | None:
    """Variance of each level of a bracket; a sample of a few frames is too rough to judge one."""
    variance = photograph.grey_variance_dn2
    if variance is None or not photograph.has_modelled_variance:
        return None
    return (variance / photograph.frames).astype(np.float32)


def write_changes(out: Path, pair: ComparedPair, summary: ChangeSummary) -> None:
    """Write maps, figure, list, report page and changes.json into the folder ``out``.

    Raises
    ------
    ApplicationError, ResultsFileError
        If a file cannot be written.
    """
    found = pair.found
    error_dn = np.where(found.valid, np.sqrt(found.variance_dn2), 0.0)
    for kind, image in (
        ("difference", found.difference_dn),
        ("plain-difference", found.plain_difference_dn),
        ("pose-difference", found.pose_difference_dn),
        ("uncertainty", error_dn),
        ("significance", found.significance),
    ):
        description = f"standoff changes: {kind} of {pair.followup.path.name}"
        write_float_tiff(out / f"{kind}.tif", image.astype(np.float32), description)
    write_mask(out / "changes.png", found.is_change)
    write_mask(out / "compared.png", found.valid)
    with _DRAWING:
        write_figure(out / "changes-figure.png", plot_changes(found))
    write_file(out / "changes.csv", change_table(summary.changes))
    write_file(out / "report.html", pair.page(summary).encode("utf-8"))
    write_results(out / "changes.json", summary)


def change_table(changes: Sequence[Change]) -> bytes:
    """Return the list of changes as CSV, a line a change."""
    text = StringIO(newline="")
    writer = csv.DictWriter(text, list(Change.model_fields), lineterminator="\n")
    writer.writeheader()
    writer.writerows(change.model_dump() for change in changes)
    return text.getvalue().encode("utf-8")
