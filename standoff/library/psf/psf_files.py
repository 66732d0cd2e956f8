"""The PSF that a call needs, of what the caller gives, with a note on what it does not use."""

from os import PathLike
from pathlib import Path

from calibration.files import read_psf
from calibration.psf import PsfCalibration
from simulation import GaussianPsf, MeasuredPsf, Model, Psf, PsfField, SeparablePsf
from simulation.choices import POSE_MODELS, PsfShape
from standoff.library.call import Call
from standoff.library.inputs import PsfLike, kind_of


def camera_psf(call: Call, psf: PsfLike, shape: PsfShape = "best") -> Psf:
    """Return the total PSF (optics and pixel), one for the whole frame.

    Parameters
    ----------
    call
        Takes the notes.
    psf
        A PSF, a calibration or the path of a psf.json.
    shape
        ``best`` takes the measured shape where the file has one, ``gaussian`` the Gaussian,
        ``measured`` nothing but a measured one.

    Raises
    ------
    PsfFileError
        If the file cannot be read, lacks a width, or has no measured PSF where one is asked for.
    """
    if isinstance(psf, GaussianPsf | MeasuredPsf | SeparablePsf):
        return psf
    return _psf(call, *_calibration(psf), shape)


def frame_psf(
    call: Call, psf: PsfLike, frame: tuple[int, int] | None, model: Model, shape: PsfShape = "best"
) -> Psf | PsfField:
    """Return the PSF: its field if the model and the frames allow it.

    Parameters
    ----------
    call
        Takes the notes.
    psf
        A PSF, a calibration or the path of a psf.json.
    frame
        Width and height in px of photograph and follow-up; None if they differ.
    model
        The capture model that takes the PSF.
    shape
        As in ``camera_psf``.

    Raises
    ------
    PsfFileError
        As ``camera_psf``.
    """
    if isinstance(psf, GaussianPsf | MeasuredPsf | SeparablePsf):
        return psf
    stored, path = _calibration(psf)
    field = _field(call, stored, path, model, shape)
    if field is None:
        return _psf(call, stored, path, shape)
    if frame != (field.width_px, field.height_px):
        call.note(
            f"{path}: its field belongs to frames of {field.width_px} x {field.height_px} px; "
            "one PSF for the whole frame is used"
        )
    else:
        return field
    return _psf(call, stored, path, shape)


def psf_and_field(
    call: Call, psf: PsfLike, model: Model, shape: PsfShape = "best"
) -> tuple[Psf, PsfField | None]:
    """Return the PSF, and its field if it has one and the model takes it.

    Parameters
    ----------
    call
        Takes the notes.
    psf
        A PSF, a calibration or the path of a psf.json.
    model
        The capture model that takes the PSF.
    shape
        As in ``camera_psf``.

    Raises
    ------
    PsfFileError
        As ``camera_psf``.
    """
    if isinstance(psf, GaussianPsf | MeasuredPsf | SeparablePsf):
        return psf, None
    stored, path = _calibration(psf)
    return _psf(call, stored, path, shape), _field(call, stored, path, model, shape)


def calibration_of(psf: PsfLike) -> PsfCalibration | None:
    """Return the calibration that is given or lies in a file; None for a bare PSF.

    Raises
    ------
    PsfFileError
        If the file cannot be read.
    """
    if isinstance(psf, GaussianPsf | MeasuredPsf | SeparablePsf):
        return None
    return _calibration(psf)[0]


def _field(
    call: Call, stored: PsfCalibration, path: str, model: Model, shape: PsfShape
) -> PsfField | None:
    field = stored.total_field(path, is_measured=shape != "gaussian")
    if field is not None and model not in POSE_MODELS:
        call.note(f"{path}: model {model} uses one PSF for the whole frame, not the field")
        return None
    return field


def _psf(call: Call, stored: PsfCalibration, path: str, shape: PsfShape) -> Psf:
    if shape == "measured":
        return stored.measured_psf(path)
    if shape == "best":
        best = stored.best_psf(path)
        if not isinstance(best, GaussianPsf):
            return best
    total = stored.total_psf(path)
    if stored.rho is None:
        call.note(f"{path}: rho is null (no diagonal edges); taken as 0 (an axis-aligned PSF)")
    return total


def _calibration(psf: PsfCalibration | str | PathLike[str]) -> tuple[PsfCalibration, str]:
    """The calibration and what to call it."""
    if isinstance(psf, PsfCalibration):
        return psf, "psf"
    if isinstance(psf, str | PathLike):
        return read_psf(Path(psf)), str(psf)
    raise TypeError(
        f"psf: expected a PSF, a PSF calibration or the path of a psf.json, got {kind_of(psf)}"
    )
