"""Finds what changed between two photograph files, and writes maps of the changes."""

from pathlib import Path
from threading import Lock

import numpy as np

from analysis.changes import ChangeOptions, ChangeResult, ChangeSummary, find_changes
from analysis.errors import AnalysisError
from analysis.reports import plot_changes
from analysis.results_file import write_results
from calibration.errors import CalibrationError
from simulation import Psf, PsfField
from simulation.arrays import FloatArray
from simulation.choices import PsfShape
from standoff.photographs import Inputs
from standoff.workflows.figure_files import write_figure
from standoff.workflows.image_files import write_float_tiff, write_mask
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
    "changes.json",
)
"""Files that a comparison writes; the last one last."""

_DRAWING = Lock()
"""Matplotlib's style is one for all threads, of which a Dask worker may have several."""


def find_changes_of_files(
    reference: Path,
    followup: Path,
    psf: Path,
    options: ChangeOptions,
    inputs: Inputs,
    transfer: PsfShape = "best",
) -> ChangeResult:
    """Align two photographs and compare them; ``psf`` is the psf.json of the camera.

    Raises
    ------
    ImageFileError
        If a photograph cannot be read.
    AnalysisError, CalibrationError
        If they cannot be compared or aligned; the message names the follow-up.
    """
    near, far = inputs.grey(reference), inputs.grey(followup)
    frame = (near.shape[1], near.shape[0]) if near.shape == far.shape else None
    return compared(near, far, frame_psf(psf, frame, "matched", transfer), options, followup)


def compared(
    near: FloatArray, far: FloatArray, psf: Psf | PsfField, options: ChangeOptions, followup: Path
) -> ChangeResult:
    """Align and compare the grey levels of two photographs; errors name the follow-up.

    Raises
    ------
    AnalysisError, CalibrationError
        If they cannot be compared or aligned.
    """
    try:
        return find_changes(near, far, psf, options)
    except CalibrationError as error:
        raise CalibrationError(f"{followup}: {error}") from error
    except AnalysisError as error:
        raise AnalysisError(f"{followup}: {error}") from error


def write_changes(out: Path, name: str, found: ChangeResult, summary: ChangeSummary) -> None:
    """Write maps, figure and changes.json into the folder ``out``; ``name`` is the follow-up's.

    Raises
    ------
    ApplicationError, ResultsFileError
        If a file cannot be written.
    """
    error_dn = np.where(found.valid, np.sqrt(found.variance_dn2), 0.0)
    for kind, image in (
        ("difference", found.difference_dn),
        ("plain-difference", found.plain_difference_dn),
        ("pose-difference", found.pose_difference_dn),
        ("uncertainty", error_dn),
        ("significance", found.significance),
    ):
        description = f"standoff changes: {kind} of {name}"
        write_float_tiff(out / f"{kind}.tif", image.astype(np.float32), description)
    write_mask(out / "changes.png", found.is_change)
    write_mask(out / "compared.png", found.valid)
    with _DRAWING:
        write_figure(out / "changes-figure.png", plot_changes(found))
    write_results(out / "changes.json", summary)
