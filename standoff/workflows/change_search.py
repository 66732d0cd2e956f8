"""Finds what changed between two photograph files, and writes the maps of it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.changes import ChangeResult, find_changes
from analysis.errors import AnalysisError
from analysis.reports import plot_changes
from calibration.errors import CalibrationError
from calibration.registration import DistortedRegistration, register_distorted
from simulation import GaussianPsf
from simulation.capture_noise import CaptureNoise
from standoff.workflows.figure_files import write_figure
from standoff.workflows.image_files import read_grey, write_float_tiff, write_mask

__all__ = ["FoundChanges", "find_changes_of_files", "write_change_pictures"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FoundChanges:
    """The changes, the pose they were found at, and the follow-up's grey levels."""

    followup_dn: NDArray[np.float64]
    aligned: DistortedRegistration
    found: ChangeResult


def find_changes_of_files(
    reference: Path,
    followup: Path,
    psf: GaussianPsf,
    noise: CaptureNoise | None,
    false_alarms: float,
) -> FoundChanges:
    """Align two photographs and compare them.

    Raises
    ------
    ImageFileError
        If a photograph cannot be read.
    AnalysisError, CalibrationError
        If they cannot be compared or aligned; the message names the follow-up.
    """
    near, far = read_grey(reference), read_grey(followup)
    try:
        aligned = register_distorted(near, far, psf)
        found = find_changes(
            near,
            far,
            aligned.pose.matrix,
            psf,
            noise,
            distortion_k1=aligned.pose.k1,
            false_alarms=false_alarms,
        )
    except CalibrationError as error:
        raise CalibrationError(f"{followup}: {error}") from error
    except AnalysisError as error:
        raise AnalysisError(f"{followup}: {error}") from error
    return FoundChanges(followup_dn=far, aligned=aligned, found=found)


def write_change_pictures(out: Path, name: str, result: FoundChanges) -> None:
    """Write the maps and the figure into the folder ``out``; ``name`` is the follow-up's.

    Raises
    ------
    ApplicationError
        If a file cannot be written.
    """
    found = result.found
    error_dn = np.where(found.valid, np.sqrt(found.uncertainty.variance_dn2), 0.0)
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
    write_figure(out / "changes-figure.png", plot_changes(result.followup_dn, found))
