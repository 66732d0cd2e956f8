"""The PSF that a call needs, from its argument: a calibration, a PSF, or a file of either."""

from collections.abc import Callable, Mapping
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from acquisition.regular_files import read_regular_file
from acquisition.untrusted import TiffDamageError, read_tiff
from acquisition.written_files import WrittenTable, read_toml, validate_written, validation_lines
from calibration.errors import PsfFileError
from calibration.files import read_psf
from calibration.psf import PsfCalibration
from simulation import GaussianPsf, MeasuredPsf, Model, Psf, PsfField, SeparablePsf, TabulatedPsf
from simulation.arguments import ArgumentTypeError, kind_of
from simulation.arrays import AnyArray
from simulation.choices import POSE_MODELS, PsfShape
from standoff.library.call import BarePsf, Call, PsfLike

_COLOURS = ("red", "green", "blue")


def camera_psf(call: Call, psf: PsfLike, shape: PsfShape = "best") -> Psf:
    """Return the total PSF (optics and pixel), one for the whole frame.

    With ``shape`` ``best`` it is the measured PSF if the calibration has one, else the Gaussian;
    with ``gaussian`` the Gaussian; with ``measured`` the measured one, or an error.
    """
    bare = _bare(psf, call, shape)
    return _psf(call, *_calibration(psf), shape) if bare is None else bare


def frame_psf(
    call: Call, psf: PsfLike, frame: tuple[int, int] | None, model: Model, shape: PsfShape = "best"
) -> Psf | PsfField:
    """Return the PSF, as a field if the model takes one and ``frame`` is the field's frame.

    ``frame`` is the ``(width, height)`` in px of both photographs; None if their sizes differ.
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
    """Return the PSF, and its field if it has one and the model takes it."""
    bare = _bare(psf, call, shape)
    if bare is not None:
        return bare, None
    stored, path = _calibration(psf)
    return _psf(call, stored, path, shape), _field(call, stored, path, model, shape)


def calibration_of(psf: PsfLike) -> PsfCalibration | None:
    """Return a calibration, read from its file if a path is given; None for a bare PSF."""
    if _is_bare(psf):
        return None
    return _calibration(psf)[0]


def opened_psf(psf: PsfLike) -> PsfCalibration | BarePsf:
    """Return a calibration or a PSF, read from its file if a path is given."""
    bare = _bare(psf, Call("opened_psf"), "best")
    return _calibration(psf)[0] if bare is None else bare


def channel_psfs(
    call: Call, psf: PsfLike, image: AnyArray, known: Psf | PsfField
) -> tuple[Psf, Psf, Psf] | None:
    """Return the PSFs of red, green and blue; None where one PSF serves the whole image.

    A calibration has a Gaussian for each colour of a mosaic. A measured PSF is that of one colour;
    it is stretched to the widths of the others. ``known`` is the PSF for the whole image.
    """
    if _is_bare(psf):
        return None
    stored, name = _calibration(psf)
    if stored.channels is None or image.ndim != 3 or image.shape[2] != len(_COLOURS):
        return None
    red, green, blue = (_of_colour(stored, colour, known) for colour in _COLOURS)
    if red is None or green is None or blue is None:
        call.note(f"{name}: one PSF is used for all colours; it has no usable PSF for each of them")
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


Positive = Annotated[float, Field(gt=0)]

_FITS = (".fits", ".fit", ".fts")
_TIFF = (".tif", ".tiff")
_WORTH_SAYING = 0.01  # of the transfer


class _LensFile(WrittenTable):
    """A TOML file that describes a PSF; files in it lie beside it."""

    kernel: str | None = None
    samples_per_px: Positive = 1.0
    mtf: str | None = None
    has_pixel: bool = True
    pupil: str | None = None
    zernike_waves: dict[int, float] | None = None
    obscured: Annotated[float, Field(ge=0, lt=1)] = 0.0
    cut_off_period_px: Positive | None = None

    @model_validator(mode="after")
    def _is_one(self) -> Self:
        given = [name for name in ("kernel", "mtf", "pupil") if getattr(self, name) is not None]
        if self.zernike_waves is not None or (not given and self.cut_off_period_px is not None):
            given.append("zernike_waves")
        if len(given) != 1:
            raise ValueError(
                "it must give one of kernel, mtf, pupil and zernike_waves, got "
                f"{' and '.join(given) or 'none'}"
            )
        if given[0] in ("pupil", "zernike_waves") and self.cut_off_period_px is None:
            raise ValueError(
                f"{given[0]} needs cut_off_period_px: wavelength times f-number over pixel pitch"
            )
        return self


def is_own_psf(path: Path) -> bool:
    """Whether a file holds a PSF in another form than psf.json, by its name."""
    return path.suffix.lower() in (*_FITS, *_TIFF, ".npy", ".csv", ".toml")


def read_own_psf(path: Path, say: Callable[[str], None] = lambda _: None) -> TabulatedPsf:
    """Read a PSF that standoff did not calibrate; ``say`` is called with what was assumed.

    The file is a kernel (.npy, .fits, .tif), contrast by frequency (.csv with the columns
    ``freq_cy_per_px`` and ``mtf``), or a .toml that describes one of them, a pupil or Zernike
    coefficients. The header of a FITS file may give ``OVERSAMP`` (samples per pixel) or
    ``PSF_SAMP`` (pixels per sample) and ``HASPIXEL``.
    """
    try:
        psf, taken_as = _read(path)
    except OSError as error:
        raise PsfFileError(f"cannot read {path}: {error.strerror}", source=str(path)) from error
    except ValidationError as error:
        lines = validation_lines(error, _LensFile)
        raise PsfFileError(f"{path}: {lines}", source=str(path)) from error
    except (ValueError, TiffDamageError) as error:
        raise PsfFileError(f"{path}: {error}", source=str(path)) from error
    left_out = ""
    if psf.asymmetry > _WORTH_SAYING:
        left_out = (
            "; it is not symmetric about its centroid, and the asymmetric part, "
            f"{100 * psf.asymmetry:.0f} % of its transfer, is left out"
        )
    say(f"{path}: {taken_as}{left_out}")
    return psf


def _read(path: Path) -> tuple[TabulatedPsf, str]:
    if path.suffix.lower() == ".toml":
        return _described(path, validate_written(_LensFile, read_toml(path)))
    if path.suffix.lower() == ".csv":
        return _by_contrast(path, has_pixel=True)
    kernel, header = _array(path)
    samples = header.get("OVERSAMP")
    if samples is None:
        samples = 1 / float(header.get("PSF_SAMP", 1.0))
    return _by_kernel(kernel, float(samples), has_pixel=bool(header.get("HASPIXEL", True)))


def _described(path: Path, lens: _LensFile) -> tuple[TabulatedPsf, str]:
    if lens.kernel is not None:
        kernel, _ = _array(path.parent / lens.kernel)
        return _by_kernel(kernel, lens.samples_per_px, has_pixel=lens.has_pixel)
    if lens.mtf is not None:
        return _by_contrast(path.parent / lens.mtf, has_pixel=lens.has_pixel)
    assert lens.cut_off_period_px is not None
    if lens.pupil is not None:
        pupil, _ = _array(path.parent / lens.pupil)
        psf = TabulatedPsf.from_pupil(pupil, cut_off_period_px=lens.cut_off_period_px)
        return psf, "the PSF of a pupil, over square pixels"
    psf = TabulatedPsf.from_zernike(
        lens.zernike_waves or {},
        cut_off_period_px=lens.cut_off_period_px,
        obscured=lens.obscured,
    )
    return psf, "the PSF of a wavefront, over square pixels"


def _by_kernel(
    kernel: NDArray[Any], samples_per_px: float, *, has_pixel: bool
) -> tuple[TabulatedPsf, str]:
    psf = TabulatedPsf.from_kernel(kernel, samples_per_px=samples_per_px, has_pixel=has_pixel)
    pixel = "taken to include the pixel" if has_pixel else "over square pixels"
    rows, cols = kernel.shape
    return psf, f"a kernel of {cols} x {rows} samples, {samples_per_px:g} per pixel, {pixel}"


def _by_contrast(path: Path, *, has_pixel: bool) -> tuple[TabulatedPsf, str]:
    text = read_regular_file(path).decode("utf-8-sig")
    rows = [line.split(",") for line in text.splitlines() if line.strip() and line[0] != "#"]
    if rows and not _is_number(rows[0][0]):
        rows = rows[1:]  # the names of the columns
    if not rows or any(len(row) < 2 for row in rows):
        raise ValueError("expected two columns, freq_cy_per_px and mtf")
    table = np.array([[float(cell) for cell in row[:2]] for row in rows])
    psf = TabulatedPsf.from_mtf(table[:, 0], table[:, 1], has_pixel=has_pixel)
    pixel = "taken to include the pixel" if has_pixel else "over square pixels"
    return psf, f"contrast up to {table[-1, 0]:g} cy/px, alike in all directions, {pixel}"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _array(path: Path) -> tuple[NDArray[Any], Mapping[str, Any]]:
    """The values of a file, and the header of one that has any."""
    data = read_regular_file(path)
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return np.load(BytesIO(data), allow_pickle=False), {}
    if suffix in _TIFF:
        return read_tiff(data, first_alone=True).images[0], {}
    if suffix not in _FITS:
        raise ValueError(f"{path.name}: expected a .npy, .fits or .tif file")
    try:
        from astropy.io import fits
    except ImportError as error:
        raise ValueError(
            'a FITS file; install the reader: pip install "standoff[formats]"'
        ) from error
    with fits.open(BytesIO(data), memmap=False) as units:
        found = next((each for each in units if each.is_image and each.shape), None)
        if found is None:
            raise ValueError("a FITS file without an image")
        return np.array(found.data), dict(found.header)
