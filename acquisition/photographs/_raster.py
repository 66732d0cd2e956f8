"""PNG, JPEG and the other formats that Pillow reads, OpenEXR and FITS; and images written.

Each with the encoding that it states. Only formats without programs or scripts inside are tried: an
EPS by another name stays unread. OpenEXR and FITS hold linear levels in floating point, and are
read where their library is installed.
"""

import re
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import imagecodecs
import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from PIL.JpegImagePlugin import JpegImageFile

from acquisition.choices import PATTERNS, Pattern
from acquisition.errors import ImageFileError
from acquisition.photographs._decoding import (
    TOO_LARGE,
    DecodingError,
    decoding,
    refuse_giant,
    refuse_many_scans,
)
from acquisition.photographs._encoding import LINEAR, SRGB, Encoding, read_profile
from acquisition.photographs._stored_image import (
    TOP_TO_BOTTOM,
    JpegCoding,
    PhotographFacts,
    StoredImage,
    is_srgb,
)
from acquisition.photographs._unread import unread_kind
from acquisition.session import write_shared
from simulation.arrays import BoolArray, Float32Array, FloatArray

_FORMATS = ("PNG", "JPEG", "BMP", "DIB", "GIF", "PPM", "WEBP", "JPEG2000", "AVIF")
_EXIF_IFD = 0x8769
_WIDE_GREY = "I;16"  # of 16-bit PNG, Pillow keeps all bits of grey
_WITHOUT_LUMA = {"CMYK": "CMYK", "LAB": "CIE L*a*b*", "HSV": "HSV"}
_WITH_A_PALETTE = ("P", "PA", "YCbCr")
_PNG_TRANSFER = {  # ITU-T H.273 in the cICP chunk
    4: Encoding(name="gamma:2.2"),
    5: Encoding(name="gamma:2.8"),
    8: LINEAR,
    13: SRGB,
}
_UNSPECIFIED = 2
_IDS_OF_RGB = tuple(b"RGB")  # what libjpeg takes for RGB where no marker tells
_CODESTREAM = b"\xff\x4f\xff\x51"
_JPEG_2000 = (_CODESTREAM, b"\0\0\0\x0cjP  ")
_BLANK = rb"(?:\s|#[^\n]*\n)+"
_PPM_HEADER = re.compile(rb"P[2356]" + 2 * (_BLANK + rb"\d+") + _BLANK + rb"(\d{1,5})\s")
_PNG_GAMMA_OF_SRGB = 45455
_PNG_AFTER_HEADER = 33  # signature and IHDR


def read_raster_image(data: bytes) -> StoredImage:
    """Read what a file says of itself; its further pages are decoded when they are asked for."""
    with decoding("image", cv2.error):
        image = _opened(data)
        _refuse_without_luma(image)
        refuse_giant((image.height, image.width, len(image.getbands())), 1, len(data))
        is_jpeg = image.format in ("JPEG", "MPO")
        if is_jpeg:
            refuse_many_scans(data)
        image.load()
        white_dn = _wide_white_dn(data)
        pages = _Pages(data=data, image=image, is_wide=white_dn is not None)
        is_deep = pages.is_wide or image.mode.startswith(("I", "F"))
        tags = _tags(image)
        name = "JPEG" if is_jpeg else str(image.format)
        depth = "" if is_jpeg else "16-bit " if is_deep else "8-bit "
        return StoredImage(
            count=pages.count,
            page=pages.page,
            marked=partial(_marked, image.info.get("icc_profile"), tags, data),
            unmarked=(LINEAR if is_deep else SRGB, f"{depth}{name}"),
            facts=PhotographFacts.of_tags(tags, image.width),
            is_jpeg=is_jpeg,
            luma_steps=_luma_steps(image) if is_jpeg else None,
            jpeg_coding=JpegCoding.of(image) if is_jpeg else None,
            white_dn=white_dn,
            has_opacity=True,
        )


def stored_picture(image: Image.Image) -> StoredImage:
    """Take a picture of Pillow as its file would be read: the frame that it shows."""
    with decoding("image"):
        _refuse_without_luma(image)
        image.load()
        pixels = image.convert("RGB") if image.mode in _WITH_A_PALETTE else image
        is_jpeg = image.format in ("JPEG", "MPO")
        is_linear = image.mode.startswith(("I", "F")) or image.format == "TIFF"
        levels = np.asarray(pixels)
        return StoredImage(
            count=1,
            page=lambda _: levels,
            marked=partial(_marked, image.info.get("icc_profile"), _tags(image), b""),
            unmarked=(LINEAR if is_linear else SRGB, "pictures of Pillow"),
            facts=PhotographFacts.of_tags(_tags(image), image.width),
            is_jpeg=is_jpeg,
            luma_steps=_luma_steps(image) if is_jpeg else None,
            jpeg_coding=JpegCoding.of(image) if is_jpeg else None,
            has_opacity=True,
        )


def _refuse_without_luma(image: Image.Image) -> None:
    if image.mode in _WITHOUT_LUMA:
        raise DecodingError(
            f"its colours are {_WITHOUT_LUMA[image.mode]}; convert it to RGB or grey"
        )


def _opened(data: bytes) -> Image.Image:
    Image.init()  # else the formats are unknown by name
    try:
        return Image.open(BytesIO(data), formats=_FORMATS)
    except UnidentifiedImageError as error:
        raise DecodingError(_unknown(data)) from error
    except Image.DecompressionBombError as error:
        raise DecodingError(TOO_LARGE) from error


@dataclass(frozen=True, slots=True, kw_only=True)
class _Pages:
    """The images of a file that stays open: the next frame of many builds on the one before."""

    data: bytes
    image: Image.Image
    is_wide: bool

    @property
    def count(self) -> int:
        """How many photographs there are; more in a phone's JPEG are depth maps and previews."""
        return 1 if self.image.format == "MPO" else int(getattr(self.image, "n_frames", 1))

    def page(self, index: int) -> NDArray[Any]:
        """Decode one image, from 0."""
        with decoding("image", cv2.error):
            if self.is_wide:
                if index > 0:
                    raise DecodingError("an animated 16-bit PNG; save its frames one by one")
                if (self.image.format, self.image.mode) == ("PNG", _WIDE_GREY) and self.count == 1:
                    return np.asarray(self.image)  # decoded already, whole
                return _wide(self.data)
            if self.count > 1:
                self.image.seek(index)
            self.image.load()
            if self.count > 1 or self.image.mode in _WITH_A_PALETTE:
                return np.asarray(self.image.convert("RGB"))
            return np.asarray(self.image)


def _luma_steps(image: Image.Image) -> FloatArray | None:
    """The quantisation table of a JPEG's luma (ITU-T T.871, 6.1); None where there is none."""
    if not isinstance(image, JpegImageFile) or image.mode not in ("L", "RGB"):
        return None
    ids, rows, cols, tables = zip(*image.layer, strict=True)
    is_rgb = image.info.get("adobe_transform") == 0 or ids == _IDS_OF_RGB
    if (image.mode == "RGB" and is_rgb) or rows[0] < max(rows) or cols[0] < max(cols):
        return None
    # Pillow has taken the file's zigzag apart: rows follow each other.
    return np.array(image.quantization[tables[0]], dtype=np.float64).reshape(8, 8)


def _wide_white_dn(data: bytes) -> float | None:
    """White of 16-bit levels that Pillow would cut down to 8, or widen to 32; None for others."""
    if _png_depth(data) == 16:
        return 65535.0
    if data.startswith(_JPEG_2000):
        # ITU-T T.800, A.5.1: the depth of the first component, less one, with its sign before it.
        depth = data[data.index(_CODESTREAM) + 42] % 128 + 1
        return float(2**depth - 1) if depth > 8 else None
    found = _PPM_HEADER.match(data)
    return float(found[1]) if found is not None and int(found[1]) > 255 else None


def _wide(data: bytes) -> NDArray[Any]:
    if data.startswith(_JPEG_2000):
        # The container may say another size than the codestream in it.
        cols, rows = struct.unpack_from(">II", data, data.index(_CODESTREAM) + 8)
        refuse_giant((rows, cols, 1), 2, len(data))
        return np.asarray(imagecodecs.jpeg2k_decode(data))
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise DecodingError("not a complete image")
    return np.asarray(pixels if pixels.ndim == 2 else pixels[:, :, [2, 1, 0, 3][: pixels.shape[2]]])


def _tags(image: Image.Image) -> dict[int, object]:
    """The Exif tags of the main directory and of Exif's own; none where they are damaged."""
    try:
        with decoding("Exif"):
            exif = image.getexif()
            return {**exif, **exif.get_ifd(_EXIF_IFD)}
    except DecodingError:
        return {}  # Exif is a remark; without it the pixels are as good


def _marked(
    profile: bytes | None, tags: dict[int, object], data: bytes
) -> tuple[Encoding, str] | None:
    """The encoding a file states: by cICP, a profile, PNG's sRGB and gAMA, or Exif, in this order.

    The order is that of the PNG specification, third edition, 4.3.
    """
    points = _chunk(data, b"cICP")
    if points is not None and len(points) == 4 and points[1] != _UNSPECIFIED:
        if points[1] not in _PNG_TRANSFER:
            raise DecodingError(
                f"its cICP chunk names transfer {points[1]}, which is not read; "
                "say with --encoding what its levels are"
            )
        return _PNG_TRANSFER[points[1]], "its cICP chunk"
    if profile:
        found = read_profile(bytes(profile))
        return found.encoding, f"its ICC profile {found.name}".rstrip()
    if _chunk(data, b"sRGB") is not None:
        return SRGB, "its sRGB chunk"
    power = _chunk(data, b"gAMA")
    if power is not None and len(power) == 4:
        encoding = _gamma_encoding(int.from_bytes(power, "big"))
        if encoding is not None:
            return encoding, "its gAMA chunk"
    if is_srgb(tags):
        return SRGB, "its Exif"
    return None


def marked_png(data: bytes, encoding: Encoding) -> bytes:
    """Return a PNG file that states its encoding, unless that is a profile's own curve.

    PNG specification, third edition, 11.3.2: gAMA and sRGB.
    """
    if encoding.name == "srgb":
        name, content = b"sRGB", b"\0"
    elif encoding.is_linear or encoding.gamma is not None:
        name, content = b"gAMA", round(100_000 / (encoding.gamma or 1.0)).to_bytes(4, "big")
    else:
        return data
    chunk = name + content
    whole = len(content).to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big")
    return data[:_PNG_AFTER_HEADER] + whole + data[_PNG_AFTER_HEADER:]


def _gamma_encoding(hundred_thousandths: int) -> Encoding | None:
    if hundred_thousandths == _PNG_GAMMA_OF_SRGB:
        return SRGB  # written as 1/2.2 by all who mean sRGB
    if abs(hundred_thousandths - 100_000) < 500:
        return LINEAR
    if not 10_000 <= hundred_thousandths <= 500_000:
        return None
    return Encoding(name=f"gamma:{100_000 / hundred_thousandths:.4g}")


def _chunk(data: bytes, name: bytes) -> bytes | None:
    """The content of the first chunk of a name before the pixels of a PNG."""
    if not data.startswith(b"\x89PNG\r\n\x1a\n"):
        return None
    at = 8
    while at + 8 <= len(data):
        length, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        if kind == name:
            return data[at + 8 : at + 8 + length]
        if kind in (b"IDAT", b"IEND"):
            return None
        at += 12 + length
    return None


def _png_depth(data: bytes) -> int | None:
    """Bits of a channel, where it is a PNG."""
    header = _chunk(data, b"IHDR")
    return None if header is None or len(header) < 9 else header[8]


def _unknown(data: bytes) -> str:
    """What a file is that none of the readers reads."""
    return unread_kind(data) or "not an image (TIFF, PNG, JPEG, camera raw, EXR or FITS expected)"


_EXR = b"\x76\x2f\x31\x01"
_FITS = b"SIMPLE  ="
_EXTRA = 'install the reader: pip install "standoff[formats]"'
_COLOURS = ("R", "G", "B")
_GREY = "Y"
_CAMERA, _EXPOSURES = "INSTRUME", ("EXPTIME", "EXPOSURE")
"""Instrument, and exposure in s, as FITS programs write them."""
_BAYER, _BAYER_OFFSETS = ("BAYERPAT", "COLORTYP"), ("XBAYROFF", "YBAYROFF")
_NO_PATTERN = ("NONE", "MONO", "RGB", "FALSE")
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
    """Read the RGB, or the luminance, of an OpenEXR file."""
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
            part, other_parts = _only_part(
                [(each.name(), set(each.channels)) for each in file.parts]
            )
            planes = {name: np.array(each.pixels) for name, each in file.channels(part).items()}
        pixels, others = _colours_or_grey(planes)
    others = " and ".join(each for each in (others, other_parts) if each)
    return replace(_linear(pixels[np.newaxis], "OpenEXR"), left_out=others)


def _only_part(parts: Sequence[tuple[str, set[str]]]) -> tuple[int, str]:
    """The part of a file that is a picture, by its number, and the others in words."""
    if len(parts) == 1:
        return 0, ""
    pictures = [n for n, (_, held) in enumerate(parts) if held >= {*_COLOURS} or _GREY in held]
    if len(pictures) != 1:
        names = ", ".join(name or str(number) for number, (name, _) in enumerate(parts))
        held = f"{len(pictures)} of its {len(parts)} parts" if pictures else "none of its parts"
        raise DecodingError(
            f"{held} ({names}) {'is' if len(pictures) == 0 else 'are'} RGB or grey; "
            "save the picture that you want as a file of its own"
        )
    others = [name or str(n) for n, (name, _) in enumerate(parts) if n != pictures[0]]
    return pictures[0], f"the contents of its parts {', '.join(others)}"


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
    return pixels, f"the contents of its channels {', '.join(others)}" if others else ""


def read_fits_image(data: bytes) -> StoredImage:
    """Read the image of a FITS file; a cube is a stack."""
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
        pattern = _fits_pattern(found.header, len(cube))
        facts = PhotographFacts(
            camera=str(found.header.get(_CAMERA, "")).strip() or None,
            exposure_s=_exposure_s(found.header),
            orientation=None if is_shown_upright else TOP_TO_BOTTOM,
        )
    return replace(_linear(cube, "FITS", facts), pattern=pattern)


def _fits_pattern(header: Any, pages: int) -> Pattern | None:  # noqa: ANN401 - no types
    """The Bayer pattern of the first two by two pixels of the file, as astronomers' cameras state.

    Three planes are the colours that were made of the mosaic, whose pattern programs leave there.
    """
    stated = next((str(header[key]) for key in _BAYER if header.get(key)), "").strip().upper()
    if not stated or stated in _NO_PATTERN or pages == len(_COLOURS):
        return None
    if stated not in PATTERNS:
        raise DecodingError(
            f"a raw mosaic of pattern {stated[:16]}, which is not that of a 2 x 2 Bayer filter"
        )
    right, down = (int(header.get(key) or 0) % 2 for key in _BAYER_OFFSETS)
    cells = np.roll(np.array(list(stated)).reshape(2, 2), (-down, -right), axis=(0, 1))
    return next(each for each in PATTERNS if each == "".join(cells.ravel()))


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
            f"a FITS file of {len(images)} images ({names}); save the one that you want as a file "
            "of its own"
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


def write_float_tiff(path: Path, image: Float32Array, description: str) -> None:
    """Write a float32 TIFF, whole or not at all."""
    _write_image(path, tiff_bytes(image, description))


def write_mask(path: Path, mask: BoolArray) -> None:
    """Write a mask as a PNG of 0 and 255, whole or not at all."""
    _write_image(path, cv2.imencode(".png", mask.astype(np.uint8) * np.uint8(255))[1].tobytes())


def _write_image(path: Path, data: bytes) -> None:
    try:
        write_shared(path, data)
    except OSError as error:
        raise ImageFileError(f"cannot write {path}: {error.strerror}") from error


def tiff_bytes(image: Float32Array, description: str) -> bytes:
    """Return a float32 TIFF, grey or RGB, as the bytes of its file."""
    buffer = BytesIO()
    tifffile.imwrite(
        buffer,
        np.ascontiguousarray(image, dtype=np.float32),
        photometric="rgb" if image.ndim == 3 else "minisblack",
        # TIFF has no other letters, though names of files do.
        description=description.encode("ascii", "backslashreplace").decode("ascii"),
        metadata=None,
    )
    return buffer.getvalue()
