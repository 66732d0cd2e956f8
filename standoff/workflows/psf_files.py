"""Reads what a command needs from a psf.json, with a note on what it does not use."""

from pathlib import Path

from calibration.files import read_psf
from calibration.psf import PsfCalibration
from simulation import GaussianPsf, Model, PsfField
from standoff.terminal import note


def read_total_psf(path: Path) -> GaussianPsf:
    """Read the total PSF of a psf.json, with a note if its correlation is taken as 0.

    Raises
    ------
    PsfFileError
        If the file cannot be read or lacks a width.
    """
    return _total_psf(read_psf(path), path)


def frame_psf(path: Path, frame: tuple[int, int] | None, model: Model) -> GaussianPsf | PsfField:
    """Read the PSF of a psf.json: its field if the model and the frames allow it.

    Parameters
    ----------
    path
        The file.
    frame
        Width and height in px of photograph and follow-up; None if they differ.
    model
        The capture model that takes the PSF.

    Raises
    ------
    PsfFileError
        If the file cannot be read or lacks a width.
    """
    stored = read_psf(path)
    field = stored.total_field(str(path))
    if field is None:
        return _total_psf(stored, path)
    if model != "matched":
        note(f"{path}: model {model} uses one PSF for the whole frame, not the field")
    elif frame != (field.width_px, field.height_px):
        note(
            f"{path}: its field belongs to frames of {field.width_px} x {field.height_px} px; "
            "one PSF for the whole frame is used"
        )
    else:
        return field
    return _total_psf(stored, path)


def _total_psf(stored: PsfCalibration, path: Path) -> GaussianPsf:
    total = stored.total_psf(str(path))
    if stored.rho is None:
        note(f"{path}: rho is null (no diagonal edges); taken as 0 (an axis-aligned PSF)")
    return total
