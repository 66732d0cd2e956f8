"""OpenEXR and FITS: linear levels in floating point, read where their library is installed."""

from dataclasses import replace
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from standoff.photographs.encoding import LINEAR
from standoff.photographs.exif import TOP_TO_BOTTOM, PhotographFacts
from standoff.photographs.guard import refuse_giant
from standoff.photographs.stored import DecodingError, StoredImage, decoding

_EXR = b"\x76\x2f\x31\x01"
_FITS = b"SIMPLE  ="
_EXTRA = 'install the reader: pip install "standoff[formats]"'
_COLOURS = ("R", "G", "B")
_GREY = "Y"
_CAMERA, _EXPOSURES = "INSTRUME", ("EXPTIME", "EXPOSURE")
"""Instrument, and exposure in s, as FITS programs write them."""
_ROW_ORDER = "ROWORDER"
"""By which some programs say that the first row is the upper one; FITS 4.0 fixes no order, and the
usual viewers show the first row at the bottom."""


def is_exr(data: bytes) -> bool:
    """Whether bytes begin as an OpenEXR file."""
    return data.startswith(_EXR)


def is_fits(data: bytes) -> bool:
    """Whether bytes begin as a FITS file."""
    return data.startswith(_FITS)


def read_exr_image(data: bytes) -> StoredImage:
    """Read the RGB, or the luminance, of an OpenEXR file.

    Raises
    ------
    DecodingError
        If OpenEXR is not installed, the file is damaged, or holds neither.
    """
    try:
        import OpenEXR
    except ImportError as error:
        raise DecodingError(f"an OpenEXR file; {_EXTRA}") from error
    with decoding("OpenEXR image"):
        with OpenEXR.File(BytesIO(data), header_only=True) as head:
            for part in head.parts:
                (left, top), (right, bottom) = part.header["dataWindow"]
                shape = (int(bottom - top) + 1, int(right - left) + 1, len(part.header["channels"]))
                refuse_giant(shape, 4, len(data))
        with OpenEXR.File(BytesIO(data), separate_channels=True) as file:
            planes = {name: np.array(each.pixels) for name, each in file.channels().items()}
        pixels, others = _colours_or_grey(planes)
    return replace(_linear(pixels[np.newaxis], "OpenEXR"), left_out=others)


def _colours_or_grey(planes: dict[str, NDArray[Any]]) -> tuple[NDArray[Any], str]:
    """The light of a file's channels, and the others in words."""
    light: tuple[str, ...] = (_GREY,)
    if all(name in planes for name in _COLOURS):
        light = _COLOURS
    if len(planes) == 1:
        light = tuple(planes)
    if not all(name in planes for name in light):
        raise DecodingError(f"its channels {', '.join(planes)} are neither RGB nor grey")
    others = sorted(planes.keys() - set(light))
    pixels = planes[light[0]] if len(light) == 1 else np.stack([planes[n] for n in light], axis=2)
    return pixels, f"what its channels {', '.join(others)} hold" if others else ""


def read_fits_image(data: bytes) -> StoredImage:
    """Read the image of a FITS file; a cube is a stack.

    Raises
    ------
    DecodingError
        If astropy is not installed, the file is damaged, or holds no image or several.
    """
    try:
        from astropy.io import fits
    except ImportError as error:
        raise DecodingError(f"a FITS file; {_EXTRA}") from error
    with (
        decoding("FITS image", fits.VerifyError),
        fits.open(BytesIO(data), memmap=False) as units,
    ):
        found = _only_image(units)
        is_shown_upright = str(found.header.get(_ROW_ORDER, "")).strip().upper() == "TOP-DOWN"
        cube = _cube(found, len(data))
        facts = PhotographFacts(
            camera=str(found.header.get(_CAMERA, "")).strip() or None,
            exposure_s=_exposure_s(found.header),
            orientation=None if is_shown_upright else TOP_TO_BOTTOM,
        )
    return _linear(cube, "FITS", facts)


def _exposure_s(header: Any) -> float | None:  # noqa: ANN401 - no types
    for key in _EXPOSURES:
        value = header.get(key)
        if isinstance(value, int | float) and value > 0:
            return float(value)
    return None


def _only_image(units: Any) -> Any:  # noqa: ANN401 - no types
    """The unit of a file that holds an image or a stack."""
    images = [each for each in units if each.is_image and each.shape]
    found = next(iter(images), None)
    if found is None or len(found.shape) not in (2, 3):
        raise DecodingError("a FITS file without an image of two axes")
    if len(images) > 1:
        names = ", ".join(each.name or str(number) for number, each in enumerate(images))
        raise DecodingError(
            f"a FITS file of {len(images)} images ({names}); save the one that is meant by itself"
        )
    return found


def _cube(found: Any, file_bytes: int) -> NDArray[Any]:  # noqa: ANN401 - no types
    """Its images, shape ``(pages, rows, cols)``, with the rows in the file's order."""
    rows, cols = found.shape[-2:]
    refuse_giant((rows * (found.shape[0] if len(found.shape) == 3 else 1), cols), 8, file_bytes)
    return np.asarray(found.data).reshape(-1, rows, cols)


def _linear(pages: NDArray[Any], name: str, facts: PhotographFacts | None = None) -> StoredImage:
    return StoredImage(
        count=len(pages),
        page=lambda index: np.asarray(pages[index]),
        unmarked=(LINEAR, name),
        facts=facts or PhotographFacts(),
    )
