"""The PSF that a call needs, of what the caller gives, with a note on what it does not use."""

from os import PathLike
from pathlib import Path

from calibration.files import read_psf
from calibration.psf import PsfCalibration
from simulation import GaussianPsf, MeasuredPsf, Model, Psf, PsfField, SeparablePsf
from simulation.arguments import ArgumentTypeError, kind_of
from simulation.arrays import AnyArray
from simulation.choices import POSE_MODELS, PsfShape
from standoff.library.call import Call
from standoff.library.inputs import BarePsf, PsfLike
from standoff.library.psf.own_psf import is_own_psf, read_own_psf

_COLOURS = ("red", "green", "blue")


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
    bare = _bare(psf, call, shape)
    return _psf(call, *_calibration(psf), shape) if bare is None else bare


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
    bare = _bare(psf, call, shape)
    if bare is not None:
        return bare
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
    bare = _bare(psf, call, shape)
    if bare is not None:
        return bare, None
    stored, path = _calibration(psf)
    return _psf(call, stored, path, shape), _field(call, stored, path, model, shape)


def calibration_of(psf: PsfLike) -> PsfCalibration | None:
    """Return the calibration that is given or lies in a file; None for a bare PSF.

    Raises
    ------
    PsfFileError
        If the file cannot be read.
    """
    if _is_bare(psf):
        return None
    return _calibration(psf)[0]


def opened_psf(psf: PsfLike) -> PsfCalibration | BarePsf:
    """Return what is given, or what its file holds.

    Raises
    ------
    PsfFileError
        If the file cannot be read.
    """
    bare = _bare(psf, Call("opened_psf"), "best")
    return _calibration(psf)[0] if bare is None else bare


def channel_psfs(
    call: Call, psf: PsfLike, image: AnyArray, known: Psf | PsfField
) -> tuple[Psf, Psf, Psf] | None:
    """Return the PSFs of red, green and blue; None where one PSF is for all of an image.

    A calibration has the Gaussian of each colour of a mosaic. A shape that was measured is that of
    one colour, and is stretched to the widths of the others.

    Parameters
    ----------
    call
        Takes the notes.
    psf
        What is known of the camera.
    image
        Shape ``(rows, cols)`` or ``(rows, cols, channels)``.
    known
        The PSF that was found in it for the whole image.
    """
    if _is_bare(psf):
        return None
    stored, name = _calibration(psf)
    if stored.channels is None or image.ndim != 3 or image.shape[2] != len(_COLOURS):
        return None
    red, green, blue = (_of_colour(stored, colour, known) for colour in _COLOURS)
    if red is None or green is None or blue is None:
        call.note(f"{name}: one PSF is used for all colours; it has none for each that serves here")
        return None
    call.note(f"{name}: red, green and blue have a PSF each")
    return red, green, blue


def _is_bare(psf: PsfLike) -> bool:
    """Whether it is a PSF or a file of one's own, without a calibration."""
    if isinstance(psf, str | PathLike):
        return is_own_psf(Path(psf))
    return isinstance(psf, BarePsf)


def _bare(psf: PsfLike, call: Call, shape: PsfShape) -> BarePsf | None:
    """A PSF that is given as such, or read from a file of one's own; None for a calibration."""
    known: BarePsf | None = None
    if isinstance(psf, BarePsf):
        known = psf
    elif isinstance(psf, str | PathLike) and is_own_psf(Path(psf)):
        known = read_own_psf(Path(psf), call.note)
    return known.gaussian if known is not None and shape == "gaussian" else known


def _of_colour(stored: PsfCalibration, colour: str, known: Psf | PsfField) -> Psf | None:
    """The PSF of one colour; None if its widths, or a shape of them, are not known."""
    widths = (stored.channels or {}).get(colour)
    if widths is None or isinstance(known, PsfField | SeparablePsf):
        return None
    if colour == stored.channel:
        return known
    if widths.sigma_x_px is None or widths.sigma_y_px is None:
        return None
    gaussian = GaussianPsf(
        sigma_x_px=widths.sigma_x_px, sigma_y_px=widths.sigma_y_px, rho=widths.rho or 0.0
    )
    return known.stretched_to(gaussian) if isinstance(known, MeasuredPsf) else gaussian


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


def _calibration(psf: PsfLike) -> tuple[PsfCalibration, str]:
    """The calibration and what to call it."""
    if isinstance(psf, PsfCalibration):
        return psf, "psf"
    if isinstance(psf, str | PathLike):
        return read_psf(Path(psf)), str(psf)
    raise ArgumentTypeError(
        f"expected a PSF, a PSF calibration or the path of a psf.json, got {kind_of(psf)}",
        argument="psf",
    )
