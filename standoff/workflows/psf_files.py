"""Reads the PSF that a command needs from a psf.json, with a note on what it does not use."""

from pathlib import Path

from calibration.files import read_psf
from calibration.psf import PsfCalibration
from simulation import GaussianPsf, Model, Psf, PsfField
from simulation.choices import POSE_MODELS, PsfShape
from standoff.terminal import note


def read_camera_psf(path: Path, shape: PsfShape = "best") -> Psf:
    """Read the total PSF of a psf.json, one for the whole frame.

    Parameters
    ----------
    path
        The file.
    shape
        ``best`` takes the measured shape where the file has one, ``gaussian`` the Gaussian,
        ``measured`` nothing but a measured one.

    Raises
    ------
    PsfFileError
        If the file cannot be read, lacks a width, or has no measured PSF where one is asked for.
    """
    return _psf(read_psf(path), path, shape)


def frame_psf(
    path: Path, frame: tuple[int, int] | None, model: Model, shape: PsfShape = "best"
) -> Psf | PsfField:
    """Read the PSF of a psf.json: its field if the model and the frames allow it.

    Parameters
    ----------
    path
        The file.
    frame
        Width and height in px of photograph and follow-up; None if they differ.
    model
        The capture model that takes the PSF.
    shape
        As in ``read_camera_psf``.

    Raises
    ------
    PsfFileError
        As ``read_camera_psf``.
    """
    stored = read_psf(path)
    field = _field(stored, path, model, shape)
    if field is None:
        return _psf(stored, path, shape)
    if frame != (field.width_px, field.height_px):
        note(
            f"{path}: its field belongs to frames of {field.width_px} x {field.height_px} px; "
            "one PSF for the whole frame is used"
        )
    else:
        return field
    return _psf(stored, path, shape)


def psf_and_field(
    path: Path, model: Model, shape: PsfShape = "best"
) -> tuple[Psf, PsfField | None]:
    """Read the PSF of a psf.json, and its field if it has one and the model takes it.

    Parameters
    ----------
    path
        The file.
    model
        The capture model that takes the PSF.
    shape
        As in ``read_camera_psf``.

    Raises
    ------
    PsfFileError
        As ``read_camera_psf``.
    """
    stored = read_psf(path)
    return _psf(stored, path, shape), _field(stored, path, model, shape)


def _field(stored: PsfCalibration, path: Path, model: Model, shape: PsfShape) -> PsfField | None:
    field = stored.total_field(str(path), is_measured=shape != "gaussian")
    if field is not None and model not in POSE_MODELS:
        note(f"{path}: model {model} uses one PSF for the whole frame, not the field")
        return None
    return field


def _psf(stored: PsfCalibration, path: Path, shape: PsfShape) -> Psf:
    if shape == "measured":
        return stored.measured_psf(str(path))
    if shape == "best":
        best = stored.best_psf(str(path))
        if not isinstance(best, GaussianPsf):
            return best
    total = stored.total_psf(str(path))
    if stored.rho is None:
        note(f"{path}: rho is null (no diagonal edges); taken as 0 (an axis-aligned PSF)")
    return total
