"""The one reader of image files: of every format, with the encoding of its levels found."""

from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np

from acquisition.printable import on_one_line
from simulation.arrays import AnyArray, FloatArray
from standoff.errors import ImageFileError
from standoff.photographs.camera_raw import RAW_SUFFIXES, is_camera_raw, read_camera_raw
from standoff.photographs.encoding import Encoding
from standoff.photographs.exif import PhotographFacts
from standoff.photographs.guard import is_swollen, read_file, refuse_unusable
from standoff.photographs.photograph import (
    Photograph,
    as_numbers,
    full_scale_dn,
    saturation_dn,
    without_opacity,
)
from standoff.photographs.raster import read_raster_image
from standoff.photographs.scientific import is_exr, is_fits, read_exr_image, read_fits_image
from standoff.photographs.stored import DecodingError, StoredImage
from standoff.photographs.tiff import is_tiff, read_tiff_image, tiff_facts

IMAGE_SUFFIXES = frozenset(
    """.avif .bmp .exr .fit .fits .fts .gif .jp2 .jpeg .jpg .pgm .png .ppm .tif .tiff
    .webp""".split()  # noqa: SIM905 - a list is longer
) | (RAW_SUFFIXES - {".raw"})
"""Of the files of a folder that are taken for photographs."""

_WHITE_OF_FLOATS = 1.5  # encoded floats run from 0 to 1, and little beyond


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadOptions:
    """How files are read.

    Parameters
    ----------
    encoding
        Taken for every file; None for what each states, or what is usual for its format.
    page
        Which image of a stack, from 1.
    is_mean
        Whether a stack is one capture: its mean, with the temporal variance.
    """

    encoding: Encoding | None = None
    page: int | None = None
    is_mean: bool = False

    def __str__(self) -> str:
        encoding = "auto" if self.encoding is None else self.encoding.name
        return f"encoding {encoding}, page {self.page}, mean {self.is_mean}"

    def __post_init__(self) -> None:
        if self.page is not None and self.is_mean:
            raise ValueError("a page or the mean of all pages, not both")
        if self.page is not None and self.page < 1:
            raise ValueError(f"pages count from 1, got {self.page}")


_AS_STATED = ReadOptions()


def read_image(path: Path, options: ReadOptions = _AS_STATED) -> Photograph:
    """Read a photograph: TIFF, PNG, JPEG, camera raw, OpenEXR, FITS and what else Pillow opens.

    Raises
    ------
    ImageFileError
        If the file is missing, no image, damaged, too large, a stack of which no page is chosen,
        or holds levels that cannot be calculated with.
    """
    data = read_file(path)
    shown = on_one_line(path)
    try:
        stored = _stored(data, path)
        number = _page_number(stored, options)
        pixels = _levels(stored, number, shown)
        encoding, encoding_from, is_stated = _encoding(stored, options)
        _refuse_other_channels(encoding, pixels)
        white = stored.white_dn or full_scale_dn(pixels)
        if white is None and not encoding.is_linear:
            _refuse_levels_beyond_white(float(pixels.max()), encoding)
        saturation = stored.saturation_dn or saturation_dn(pixels, white)
        variance, frames = stored.variance_dn2, stored.frames
        if options.is_mean and stored.count > 1:
            _refuse_swollen_stack(stored.count, pixels.nbytes, len(data))
            mean, variance = _mean(stored, encoding, white or 1.0, shown)
            frames, pixels = stored.count, encoding.encode(mean, white or 1.0)
    except DecodingError as error:
        raise ImageFileError(f"{shown}: {on_one_line(error)}") from error
    if saturation is not None and white is not None:
        top = np.full((1, 1, max(len(encoding.curves), 1)), saturation)
        saturation = float(encoding.decode(top, white).max())
    return Photograph(
        path=path,
        stored=pixels,
        encoding=encoding,
        encoding_from=encoding_from,
        is_encoding_stated=is_stated,
        full_scale_dn=white,
        saturation_dn=saturation,
        is_jpeg=stored.is_jpeg,
        luma_steps=stored.luma_steps,
        jpeg_coding=stored.jpeg_coding,
        pattern=stored.pattern,
        facts=stored.facts,
        variance_dn2=variance,
        frames=frames,
        has_modelled_variance=stored.has_modelled_variance and encoding.is_linear,
        sha256=sha256(data).hexdigest(),
    )


def _stored(data: bytes, path: Path) -> StoredImage:
    if is_tiff(data):
        facts, tags = tiff_facts(data)
        if is_camera_raw(data, path, tags):
            return read_camera_raw(data, facts)
        return read_tiff_image(data)
    if is_exr(data):
        return read_exr_image(data)
    if is_fits(data):
        return read_fits_image(data)
    if is_camera_raw(data, path, frozenset()):
        return read_camera_raw(data, PhotographFacts())
    return read_raster_image(data)


def _levels(stored: StoredImage, number: int, shown: str) -> AnyArray:
    pixels = as_numbers(stored.page(number))
    refuse_unusable(pixels, shown)
    return without_opacity(pixels)


def _refuse_swollen_stack(count: int, page_bytes: int, file_bytes: int) -> None:
    if is_swollen(count * page_bytes, file_bytes):
        raise DecodingError(
            f"{count} pages in a file of {file_bytes} bytes are no photographs; "
            "choose one with --page N"
        )


def _refuse_other_channels(encoding: Encoding, pixels: AnyArray) -> None:
    if len(encoding.curves) > 1 and pixels.ndim == 2:
        raise DecodingError(
            "its colour profile is for RGB and its pixels are grey; "
            "say with --encoding what its levels are"
        )


def _refuse_levels_beyond_white(highest: float, encoding: Encoding) -> None:
    if highest > _WHITE_OF_FLOATS:
        raise DecodingError(
            f"{encoding.name} levels in floating point run from 0 to 1, these to {highest:.3g}: "
            "give --encoding linear, or scale them"
        )


def _page_number(stored: StoredImage, options: ReadOptions) -> int:
    """The page that is asked for, from 0; the first one of several where their mean is."""
    if options.page is not None and options.page > stored.count:
        pages = "page" if stored.count == 1 else "pages"
        raise DecodingError(f"--page {options.page} of a file of {stored.count} {pages}")
    if stored.count > 1 and options.page is None and not options.is_mean:
        raise DecodingError(
            f"a stack of {stored.count} pages; choose one with --page N, or --mean if they are "
            "frames of one scene"
        )
    return (options.page or 1) - 1


def _mean(
    stored: StoredImage, encoding: Encoding, white_dn: float, shown: str
) -> tuple[FloatArray, FloatArray]:
    """Mean and unbiased variance of the linear levels of all pages, one page in memory at a time.

    Welford, "Note on a method for calculating corrected sums of squares and products",
    Technometrics 4 (1962) 419.
    """
    mean = encoding.decode(_levels(stored, 0, shown), white_dn)
    squares = np.zeros_like(mean)
    for count in range(2, stored.count + 1):
        page = encoding.decode(_levels(stored, count - 1, shown), white_dn)
        if page.shape != mean.shape:
            raise DecodingError(
                f"pages of {mean.shape} and {page.shape} pixels have no mean; choose one with "
                "--page N"
            )
        deviation = page - mean
        mean = mean + deviation / count
        squares += deviation * (page - mean)
    return mean, squares / (stored.count - 1)


def _encoding(stored: StoredImage, options: ReadOptions) -> tuple[Encoding, str, bool]:
    """The encoding, what decided it, and whether anybody states it."""
    if options.encoding is not None:
        return options.encoding, "--encoding", True
    marked = stored.marked()
    if marked is not None:
        return *marked, True
    encoding, kind = stored.unmarked
    return encoding, f"usual for {kind} without a mark", False
