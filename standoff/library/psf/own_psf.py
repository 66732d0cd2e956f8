"""A PSF of one's own in a file: a kernel, a table of contrast, or a description of a lens."""

from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from acquisition.regular_files import read_regular_file
from acquisition.untrusted import TiffDamageError, read_tiff
from acquisition.written_files import (
    WrittenTable,
    read_toml,
    validate_written,
    validation_lines,
)
from calibration.errors import PsfFileError
from simulation import TabulatedPsf

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
    """Read a PSF that was not calibrated here.

    Parameters
    ----------
    path
        A kernel (.npy, .fits, .tif), contrast by frequency (.csv with the columns
        ``freq_cy_per_px`` and ``mtf``), or a .toml that describes one of them, a pupil or Zernike
        coefficients. The header of a FITS file may give ``OVERSAMP`` (samples per pixel) or
        ``PSF_SAMP`` (pixels per sample) and ``HASPIXEL``.
    say
        Called with what was assumed, and with what is left out.

    Raises
    ------
    PsfFileError
        If it cannot be read, or is no PSF.
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
            "; it is not symmetric about its centroid, and what is not, "
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
