"""TIFF and BigTIFF, of any compression that tifffile and imagecodecs decode, and camera raw files.

The chain of directories is walked before a library believes what they say: TIFF 6.0, section 2;
BigTIFF (Aware Systems, 2011). A file of a megabyte can hold thousands of directories whose tags all
point at the same megabyte. Of camera raw files LibRaw gives the mosaic as the sensor delivered it,
never developed; the thumbnail that such a file holds, often as its first image, is not looked at.
"""

import logging
import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import PurePath
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from acquisition.choices import PATTERNS, Pattern
from acquisition.errors import SessionError
from acquisition.photographs._decoding import (
    DecodingError,
    decoding,
    refuse_giant,
    refuse_many_scans,
)
from acquisition.photographs._encoding import LINEAR, SRGB, Encoding, read_profile
from acquisition.photographs._stored_image import FACT_TAGS, PhotographFacts, StoredImage, is_srgb
from acquisition.photographs._unread import unread_kind
from acquisition.session import CaptureRecord, parse_capture

_MIN_IS_WHITE, _PALETTE, _YCBCR, _CFA, _LINEAR_RAW = 0, 3, 6, 32803, 34892
_WITH_LUMA = {_MIN_IS_WHITE, 1, 2, _PALETTE, _YCBCR, _CFA, _LINEAR_RAW}
_COLOURS = {4: "a mask", 5: "CMYK", 8: "CIE L*a*b*", 9: "ICC L*a*b*", 10: "ITU L*a*b*"}
_JPEG = {7, 33007, 34892}
_WITH_A_SIZE = {*_JPEG, 33003, 33004, 33005, 34712, 34933, 50001}
_WITHOUT_A_SIZE = {1, 2, 3, 4, 5, 8, 32771, 32773, 32946, 34925, 50000}
_ICC_TAG, _EXIF_TAG, _CFA_REPEAT_TAG, _CFA_PATTERN_TAG = 34675, 34665, 33421, 33422
_BLACK_REPEAT_TAG, _SUB_DIRECTORIES_TAG = 50713, 330
_SMALL_PX = 1 << 16
_ZERO_OF_SIGNED = -32768
_REDUCED_OR_MASK = 1 | 4
_OPACITY = {1, 2}
"""Of a further sample, with the colours multiplied by it or not: TIFF 6.0, section 18."""
_PATTERNS: dict[object, Pattern] = {(0, 1, 1, 2): "RGGB", (1, 0, 2, 1): "GRBG",
                                    (1, 2, 0, 1): "GBRG", (2, 1, 1, 0): "BGGR"}  # fmt: skip


def is_tiff(data: bytes) -> bool:
    """Whether bytes begin as a TIFF or BigTIFF file of either byte order."""
    return data[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def read_tiff_image(data: bytes) -> StoredImage:
    """Read what a TIFF says of itself; its pages are decoded when they are asked for."""
    with decoding("TIFF image"):
        _refuse_overlapping_directories(data)
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
        white_dn=None if stack.is_signed else _white_dn(first),
        pattern=_pattern(first),
        has_opacity=bool(_OPACITY.intersection(map(int, first.extrasamples))),
    )


def tiff_facts(data: bytes) -> tuple[PhotographFacts, frozenset[int]]:
    """What the first directory says of the photograph, and its tags; nothing if it is damaged."""
    try:
        with decoding("TIFF image"):
            first = _opened(data).pages.first
            facts = PhotographFacts.of_tags(_tags(first), 0)
            return facts, frozenset(tag.code for tag in first.tags)
    except DecodingError:
        return PhotographFacts(), frozenset()


def _black_repeat_px(data: bytes) -> int:
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
    is_signed: bool

    @property
    def first(self) -> tifffile.TiffPage:
        return self.pages[0]

    @property
    def count(self) -> int:
        return self.frames or len(self.pages)

    def page(self, index: int) -> NDArray[Any]:
        """Decode one image, from 0."""
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
            if self.is_signed and pixels.dtype.kind == "u" and pixels.dtype.itemsize == 2:
                return (pixels.astype(np.int32) + _ZERO_OF_SIGNED).astype(np.int16)
            return _as_shown(pixels, page)


def _stack(tiff: tifffile.TiffFile, data: bytes) -> _Stack:
    pages = _full_size(tiff.pages)
    if not pages:  # a thumbnail first, the image in a directory below it
        pages = _full_size(tiff.pages.first.pages or ())
        if not pages and _SUB_DIRECTORIES_TAG in tiff.pages.first.tags:
            raise DecodingError(
                "its first image is a thumbnail, and the image below it cannot be read; save that "
                "image as a TIFF of its own"
            )
        pages = pages or [tiff.pages.first]
    _refuse_unread(pages[0])
    _refuse_giant(pages[0], data)
    frames = None
    if len(pages) == 1 and (tiff.is_imagej or tiff.is_shaped) and tiff.series:
        # ImageJ writes one directory for a stack of more than 4 GB, and some programs always.
        found = math.prod(tiff.series[0].shape) // pages[0].size
        frames = found if found > 1 and pages[0].is_contiguous else None
    return _Stack(data=data, pages=tuple(pages), frames=frames, is_signed=_is_signed(tiff))


def _is_signed(tiff: tifffile.TiffFile) -> bool:
    """Whether ImageJ moved signed levels up by 32768, as it says in its calibration."""
    known = tiff.imagej_metadata or {}
    try:
        return float(known.get("c0", 0)) == _ZERO_OF_SIGNED and float(known.get("c1", 0)) == 1
    except (TypeError, ValueError):
        return False


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
        raise DecodingError("a TIFF whose type of numbers is not supported")
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
            raise DecodingError("white is 0, but its levels are not unsigned integers; invert them")
        return np.asarray(pixels.dtype.type(2 ** int(page.bitspersample) - 1) - pixels)
    if photometric == _PALETTE and page.colormap is not None:
        return _in_colours(pixels, np.moveaxis(page.colormap, 0, -1))
    return pixels


def _in_colours(pixels: NDArray[Any], colours: NDArray[Any]) -> NDArray[Any]:
    """The colour of each pixel; opacity stands behind the number of the colour and is not read."""
    numbers = pixels[..., 0] if pixels.ndim == 3 else pixels
    if numbers.dtype.kind != "u" or numbers.max() >= len(colours):
        raise DecodingError(
            f"its palette has {len(colours)} colours, but its pixels use others; save it as RGB"
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
        raise DecodingError("a raw mosaic whose colour pattern is not that of a 2 x 2 Bayer filter")
    return found


_MOST_PAGES = 10_000
_SMALL_BYTES = 16 << 20
_LARGEST_RATIO = 8  # of all values of tags to the file
_TYPE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4,
               16: 8, 17: 8, 18: 8}  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class _Layout:
    """The numbers of a directory: its count, one entry, and the offset of the next."""

    count: struct.Struct
    entry: struct.Struct
    next: struct.Struct
    first_at: int


def _refuse_overlapping_directories(data: bytes) -> None:
    """Check the number of pages, and that their tags are not far larger than the file."""
    layout = _layout(data)
    (at,) = layout.next.unpack_from(data, layout.first_at)
    values_bytes = pages = 0
    while at and at < len(data):
        pages += 1
        if pages > _MOST_PAGES:
            raise DecodingError(f"a TIFF of more than {_MOST_PAGES} pages")
        (entries,) = layout.count.unpack_from(data, at)
        at += layout.count.size
        end = at + entries * layout.entry.size
        for _, kind, count in layout.entry.iter_unpack(data[at:end]):
            values_bytes += min(count * _TYPE_BYTES.get(kind, 1), len(data))
        if values_bytes > max(_SMALL_BYTES, _LARGEST_RATIO * len(data)):
            raise DecodingError("a TIFF whose tags describe more data than the file can contain")
        (at,) = layout.next.unpack_from(data, end)


def _layout(data: bytes) -> _Layout:
    order = "<" if data[:2] == b"II" else ">"
    if data[2:4] in (b"+\0", b"\0+"):
        return _Layout(
            count=struct.Struct(f"{order}Q"),
            entry=struct.Struct(f"{order}HHQ8x"),
            next=struct.Struct(f"{order}Q"),
            first_at=8,
        )
    return _Layout(
        count=struct.Struct(f"{order}H"),
        entry=struct.Struct(f"{order}HHI4x"),
        next=struct.Struct(f"{order}I"),
        first_at=4,
    )


RAW_SUFFIXES = frozenset(
    """.3fr .arw .cr2 .cr3 .crw .dcr .dng .erf .fff .iiq .k25 .kdc .mef .mos .mrw .nef .nrw .orf
    .pef .raf .raw .rw2 .rwl .sr2 .srf .srw .x3f""".split()  # noqa: SIM905 - a list is longer
)
_SIGNATURES = (b"IIU\0", b"IIRO", b"IIRS", b"MMOR", b"FUJIFILMCCD-RAW", b"\0MRM", b"FOVb")
_DNG_VERSION = 50706
_LARGEST_REPEAT_PX = 2  # LibRaw keeps more to itself
_EXTRA = 'install the reader: pip install "standoff[raw]"'


def is_camera_raw(data: bytes, path: PurePath, tiff_tags: frozenset[int]) -> bool:
    """Whether a file is for LibRaw: by its first bytes, its suffix, or the tags of a TIFF."""
    return (
        data.startswith(_SIGNATURES)
        or data[8:12] == b"CR\x02\0"
        or data[4:12] == b"ftypcrx "
        or _DNG_VERSION in tiff_tags
        or path.suffix.lower() in RAW_SUFFIXES
    )


def read_camera_raw(data: bytes, facts: PhotographFacts) -> StoredImage:
    """Read the mosaic of a camera raw file, with its black level taken off."""
    try:
        import rawpy
    except ImportError as error:
        raise DecodingError(f"a camera raw file; {_EXTRA}") from error
    if _black_repeat_px(data) > _LARGEST_REPEAT_PX:
        raise DecodingError(
            "black levels that differ within more than 2 x 2 pixels are not read; "
            "convert it to a linear TIFF"
        )
    with (
        decoding("camera raw file", rawpy.LibRawError),
        _opened_raw(data, rawpy) as raw,
    ):
        sizes = raw.sizes
        refuse_giant((sizes.raw_height, sizes.raw_width), 2, len(data))
        is_mosaic = raw.raw_type == rawpy.RawType.Flat
        pattern = _raw_pattern(raw) if is_mosaic else None
        # A copy: the array of LibRaw is gone once the file is closed.
        visible = raw.raw_image_visible
        levels = (visible if is_mosaic else visible[..., :3]).astype(np.float32)
        black_dn = _black_levels(raw, is_mosaic=is_mosaic)
        white_dn = float(raw.white_level or 65535)
    levels -= black_dn
    white = white_dn - float(black_dn.max())
    if not white > 0:
        raise DecodingError(f"its white level {white_dn:g} is not above its black level")
    return StoredImage(
        count=1,
        page=lambda _: levels,
        marked=lambda: (LINEAR, "camera raw"),
        facts=facts,
        white_dn=white,
        saturation_dn=white,
        pattern=pattern,
    )


def _opened_raw(data: bytes, rawpy: Any) -> Any:  # noqa: ANN401 - rawpy has no types
    """Open a raw file, or say why LibRaw does not take it."""
    try:
        return rawpy.imread(BytesIO(data))
    except rawpy.LibRawFileUnsupportedError as error:
        kind = unread_kind(data)
        if kind is not None:
            raise DecodingError(kind) from error
        if is_tiff(data) or data.startswith(_SIGNATURES):
            release = ".".join(map(str, rawpy.libraw_version))
            raise DecodingError(
                f"a raw file from a camera, or with a compression, that LibRaw {release} does not "
                "know; convert it to DNG"
            ) from error
        raise DecodingError(
            "not a camera raw file: it states neither its size nor its type, as when a program "
            "writes only the numbers; save a TIFF, or read it with numpy and give the array in "
            "Python"
        ) from error


def _raw_pattern(raw: Any) -> Pattern | None:  # noqa: ANN401 - rawpy has no types
    """Colours of the first two by two visible pixels; None for a sensor without colours."""
    if raw.raw_pattern is None or raw.num_colors == 1:
        return None
    cells = raw.raw_colors_visible[:2, :2].ravel()
    found = "".join(chr(raw.color_desc[cell]) for cell in cells)
    if raw.raw_pattern.shape != (2, 2) or found not in PATTERNS:
        raise DecodingError(
            "a raw file whose sensor has no Bayer filter; convert it to a linear TIFF"
        )
    return found


def _black_levels(raw: Any, *, is_mosaic: bool) -> NDArray[np.float32]:  # noqa: ANN401
    levels = np.asarray(raw.black_level_per_channel, dtype=np.float32)
    if not is_mosaic:
        return levels[:3]
    if raw.raw_pattern is None or len(set(levels.tolist())) == 1:
        return levels[:1]
    return np.asarray(levels[raw.raw_colors_visible])
