"""TIFF and BigTIFF: any compression and layout that tifffile and imagecodecs decode."""

import logging
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from acquisition.errors import SessionError
from acquisition.session import CaptureRecord, parse_capture
from calibration.choices import Pattern
from standoff.photographs.encoding import LINEAR, SRGB, Encoding
from standoff.photographs.exif import FACT_TAGS, PhotographFacts, is_srgb
from standoff.photographs.guard import refuse_giant, refuse_many_scans
from standoff.photographs.icc import read_profile
from standoff.photographs.stored import DecodingError, StoredImage, decoding
from standoff.photographs.tiff_directories import refuse_overlapping_directories

_MIN_IS_WHITE, _PALETTE, _YCBCR, _CFA, _LINEAR_RAW = 0, 3, 6, 32803, 34892
_WITH_LUMA = {_MIN_IS_WHITE, 1, 2, _PALETTE, _YCBCR, _CFA, _LINEAR_RAW}
_COLOURS = {4: "a mask", 5: "CMYK", 8: "CIE L*a*b*", 9: "ICC L*a*b*", 10: "ITU L*a*b*"}
_JPEG = {7, 33007, 34892}
_WITH_A_SIZE = {*_JPEG, 33003, 33004, 33005, 34712, 34933, 50001}
_WITHOUT_A_SIZE = {1, 2, 3, 4, 5, 8, 32771, 32773, 32946, 34925, 50000}
_ICC_TAG, _EXIF_TAG, _CFA_REPEAT_TAG, _CFA_PATTERN_TAG = 34675, 34665, 33421, 33422
_BLACK_REPEAT_TAG, _SUB_DIRECTORIES_TAG = 50713, 330
_SMALL_PX = 1 << 16
_REDUCED_OR_MASK = 1 | 4
_OPACITY = {1, 2}
"""Of a further sample, with the colours multiplied by it or not: TIFF 6.0, section 18."""
_PATTERNS: dict[object, Pattern] = {(0, 1, 1, 2): "RGGB", (1, 0, 2, 1): "GRBG",
                                    (1, 2, 0, 1): "GBRG", (2, 1, 1, 0): "BGGR"}  # fmt: skip


def is_tiff(data: bytes) -> bool:
    """Whether bytes begin as a TIFF or BigTIFF file of either byte order."""
    return data[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def read_tiff_image(data: bytes) -> StoredImage:
    """Read what a TIFF says of itself; its pages are decoded when they are asked for.

    Raises
    ------
    DecodingError
        If it is damaged, or holds colours without a luma.
    """
    with decoding("TIFF image"):
        refuse_overlapping_directories(data)
        tiff = _opened(data)
        capture = _capture(data, tiff)
        if capture is not None:
            return capture
        stack = _stack(tiff, data)
        first = stack.first
        tags = _tags(first)
    return StoredImage(
        count=stack.count,
        page=stack.page,
        marked=partial(_marked, first, tags),
        unmarked=(LINEAR, "TIFF"),
        facts=PhotographFacts.of_tags(tags, first.imagewidth),
        is_jpeg=int(first.compression) in _JPEG,
        white_dn=_white_dn(first),
        pattern=_pattern(first),
        has_opacity=bool(_OPACITY.intersection(map(int, first.extrasamples))),
    )


def tiff_facts(data: bytes) -> tuple[PhotographFacts, frozenset[int]]:
    """What the first directory says of the photograph, and the numbers of its tags.

    Of a damaged file nothing is said: whoever reads the pixels finds the damage.
    """
    try:
        with decoding("TIFF image"):
            first = _opened(data).pages.first
            facts = PhotographFacts.of_tags(_tags(first), 0)
            return facts, frozenset(tag.code for tag in first.tags)
    except DecodingError:
        return PhotographFacts(), frozenset()


def black_repeat_px(data: bytes) -> int:
    """Period of the black levels that a DNG states, along its longer side; 1 where it has none."""
    try:
        with decoding("DNG"):
            first = _opened(data).pages.first
            stated = [
                page.tags.valueof(_BLACK_REPEAT_TAG) for page in (first, *(first.pages or ()))
            ]
            return max((max(sides) for sides in stated if sides), default=1)
    except DecodingError:
        return 1


def _opened(data: bytes) -> tifffile.TiffFile:
    logging.getLogger("tifffile").setLevel(logging.CRITICAL)
    return tifffile.TiffFile(BytesIO(data))


def _capture(data: bytes, tiff: tifffile.TiffFile) -> StoredImage | None:
    """The mean of a session's capture, whose second page is the variance; None for other files."""
    info = (tiff.imagej_metadata or {}).get("Info")
    if not isinstance(info, str) or not info.startswith("{"):
        return None
    for page in tiff.pages:
        _refuse_giant(page, data)
    try:
        capture = parse_capture(data, source="capture")
    except SessionError:
        return None
    variance = capture.variance_dn2
    return StoredImage(
        count=1,
        page=lambda _: capture.mean_dn,
        marked=lambda: (LINEAR, "its record of the capture"),
        saturation_dn=capture.record.max_level_dn,
        variance_dn2=None if variance is None else variance.astype(np.float64),
        frames=capture.record.frames_used,
        facts=PhotographFacts(taken=_taken(capture.record)),
        has_modelled_variance=capture.record.bracket is not None,
    )


def _taken(record: CaptureRecord) -> str | None:
    """When a capture was begun, as Exif writes times; None for a photograph that was imported."""
    if record.first_timestamp_ns is None:
        return None  # its times are those of the import
    day, time = record.started_utc[:19].split("T")
    return f"{day.replace('-', ':')} {time} UTC"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Stack:
    """The full-size images of a file: its pages, or ``frames`` of them behind one directory."""

    data: bytes
    pages: tuple[tifffile.TiffPage, ...]
    frames: int | None

    @property
    def first(self) -> tifffile.TiffPage:
        return self.pages[0]

    @property
    def count(self) -> int:
        return self.frames or len(self.pages)

    def page(self, index: int) -> NDArray[Any]:
        """Decode one image, from 0.

        Raises
        ------
        DecodingError
            If it is damaged or cut short, too large, or holds colours without a luma.
        """
        with decoding("TIFF image"):
            page = self.first if self.frames else self.pages[index]
            _refuse_unread(page)
            _refuse_giant(page, self.data)
            if self.frames:
                # The frames follow each other without compression.
                at = page.dataoffsets[0] + index * page.nbytes
                levels = np.dtype(page.dtype).newbyteorder(page.parent.byteorder)
                pixels = np.frombuffer(self.data, levels, page.size, at).reshape(page.shape)
            else:
                _refuse_missing_segments(page, self.data)
                pixels = page.asarray()
            if pixels.shape != page.shape:
                raise DecodingError(f"cut short: {pixels.shape} of {page.shape} pixels")
            return _as_shown(pixels, page)


def _stack(tiff: tifffile.TiffFile, data: bytes) -> _Stack:
    pages = _full_size(tiff.pages)
    if not pages:  # a thumbnail first, the image in a directory below it
        pages = _full_size(tiff.pages.first.pages or ())
        if not pages and _SUB_DIRECTORIES_TAG in tiff.pages.first.tags:
            raise DecodingError(
                "its first image is a thumbnail, and the picture below it is not read; save the "
                "picture as a TIFF of its own"
            )
        pages = pages or [tiff.pages.first]
    _refuse_unread(pages[0])
    _refuse_giant(pages[0], data)
    frames = None
    if len(pages) == 1 and (tiff.is_imagej or tiff.is_shaped) and tiff.series:
        # ImageJ writes one directory for a stack of more than 4 GB, and some programs always.
        found = math.prod(tiff.series[0].shape) // pages[0].size
        frames = found if found > 1 and pages[0].is_contiguous else None
    return _Stack(data=data, pages=tuple(pages), frames=frames)


def _full_size(pages: Iterable[tifffile.TiffPage | tifffile.TiffFrame]) -> list[tifffile.TiffPage]:
    whole = [page if isinstance(page, tifffile.TiffPage) else page.aspage() for page in pages]
    return [page for page in whole if not page.subfiletype & _REDUCED_OR_MASK]


def _refuse_unread(page: tifffile.TiffPage) -> None:
    """Check that colours have a luma, and that a compression cannot hold more than it says."""
    photometric, compression = page.photometric, int(page.compression)
    is_luma_in_levels = photometric == _YCBCR and compression not in _WITH_A_SIZE
    if int(photometric) not in _WITH_LUMA or is_luma_in_levels:
        name = _COLOURS.get(int(photometric), getattr(photometric, "name", str(photometric)))
        raise DecodingError(f"its colours are {name}; convert it to RGB or grey")
    if compression not in _WITH_A_SIZE | _WITHOUT_A_SIZE:
        name = getattr(page.compression, "name", str(page.compression))
        raise DecodingError(f"its compression {name} is not read; save it with deflate or LZW")


def _refuse_giant(page: tifffile.TiffPage | tifffile.TiffFrame, data: bytes) -> None:
    """Check the size of a page and of the parts that it is compressed in, before decoding."""
    key = page.keyframe
    if key is None or key.dtype is None:
        raise DecodingError("a TIFF of a type of numbers that is not read")
    if int(key.imagedepth) != 1:
        raise DecodingError("a volume, not an image")
    samples, level_bytes = int(key.samplesperpixel), key.dtype.itemsize
    rows, cols = int(key.imagelength), int(key.imagewidth)
    refuse_giant((rows, cols, samples), level_bytes, len(data))
    if key.is_tiled:
        rows, cols = int(key.tilelength), int(key.tilewidth)
        refuse_giant((rows, cols, samples), level_bytes, len(data))
    if int(key.compression) not in _WITH_A_SIZE:
        return
    for at, size in zip(page.dataoffsets, page.databytecounts, strict=True):
        part = data[at : at + size]
        if int(key.compression) in _JPEG:
            refuse_many_scans(part)
        with Image.open(BytesIO(part), formats=("JPEG", "JPEG2000", "WEBP")) as own:
            if own.width * own.height > 2 * rows * cols + _SMALL_PX:
                raise DecodingError(
                    f"a part of {own.width} x {own.height} pixels in {cols} x {rows}"
                )


def _refuse_missing_segments(page: tifffile.TiffPage, data: bytes) -> None:
    """Check that every strip or tile is there: tifffile fills the others with zeros."""
    ends = [at + size for at, size in zip(page.dataoffsets, page.databytecounts, strict=True)]
    is_whole = len(ends) >= math.prod(page.chunked) and all(page.databytecounts)
    if not is_whole or max(ends) > len(data):
        raise DecodingError("cut short: some of its strips or tiles are missing")


def _as_shown(pixels: NDArray[Any], page: tifffile.TiffPage) -> NDArray[Any]:
    """Rows, columns, channels; black at 0; a palette replaced by its colours."""
    if pixels.ndim == 3 and int(page.planarconfig) == 2 and pixels.shape[0] == page.samplesperpixel:
        pixels = np.moveaxis(pixels, 0, -1)
    photometric = int(page.photometric)
    if photometric == _MIN_IS_WHITE:
        if pixels.dtype.kind == "b":
            return np.asarray(~pixels)
        if pixels.dtype.kind != "u":
            raise DecodingError("levels whose white is 0, but no unsigned integers; turn them over")
        return np.asarray(pixels.dtype.type(2 ** int(page.bitspersample) - 1) - pixels)
    if photometric == _PALETTE and page.colormap is not None:
        return _in_colours(pixels, np.moveaxis(page.colormap, 0, -1))
    return pixels


def _in_colours(pixels: NDArray[Any], colours: NDArray[Any]) -> NDArray[Any]:
    """The colour of each pixel; opacity stands behind the number of the colour and is not read."""
    numbers = pixels[..., 0] if pixels.ndim == 3 else pixels
    if numbers.dtype.kind != "u" or numbers.max() >= len(colours):
        raise DecodingError(
            f"its palette has {len(colours)} colours, and its pixels name others; save it in RGB"
        )
    return np.asarray(colours[numbers])


def _white_dn(page: tifffile.TiffPage) -> float | None:
    """White of samples that are packed to fewer bits than their type in memory has."""
    bits = page.bitspersample
    is_packed = np.dtype(page.dtype).kind == "u" and page.photometric != _PALETTE and bits % 8
    return float(2**bits - 1) if is_packed else None


def _tags(page: tifffile.TiffPage) -> dict[int, object]:
    """The tags of the page and of its Exif directory by number, as far as facts are in them."""
    tags: dict[int, object] = {tag.code: tag.value for tag in page.tags if tag.code in FACT_TAGS}
    exif = page.tags.valueof(_EXIF_TAG)
    if isinstance(exif, dict):
        codes = {name: code for code, name in tifffile.TIFF.EXIF_TAGS.items()}
        for name, value in exif.items():
            tags.setdefault(codes.get(name, -1), value)
    return tags


def _marked(page: tifffile.TiffPage, tags: dict[int, object]) -> tuple[Encoding, str] | None:
    profile = page.tags.valueof(_ICC_TAG)
    if isinstance(profile, bytes):
        found = read_profile(profile)
        return found.encoding, f"its ICC profile {found.name}".rstrip()
    return (SRGB, "its Exif") if is_srgb(tags) else None


def _pattern(page: tifffile.TiffPage) -> Pattern | None:
    if int(page.photometric) != _CFA:
        return None
    cells = page.tags.valueof(_CFA_PATTERN_TAG)
    found = _PATTERNS.get(tuple(cells)) if isinstance(cells, bytes | tuple) else None
    if found is None or page.tags.valueof(_CFA_REPEAT_TAG) != (2, 2):
        raise DecodingError("a raw mosaic whose pattern of colours is not 2 x 2 of a Bayer filter")
    return found
