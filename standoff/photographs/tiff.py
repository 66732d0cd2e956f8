"""TIFF and BigTIFF: any compression and layout that tifffile and imagecodecs decode."""

import logging
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

from acquisition.errors import SessionError
from acquisition.session import parse_capture
from acquisition.untrusted import TIFF_DAMAGE
from calibration.choices import Pattern
from standoff.photographs.encoding import LINEAR, SRGB, Encoding
from standoff.photographs.exif import PhotographFacts, is_srgb
from standoff.photographs.guard import refuse_giant
from standoff.photographs.icc import read_profile
from standoff.photographs.stored import DecodingError, StoredImage, decoding

MOST_PAGES = 10_000
_WITHOUT_LUMA = {
    4: "a mask",
    5: "CMYK",
    8: "CIE L*a*b*",
    9: "ICC L*a*b*",
    10: "ITU L*a*b*",
}
_MIN_IS_WHITE, _PALETTE, _CFA = 0, 3, 32803
_JPEG = {6, 7, 33007, 34892}
_ICC_TAG, _EXIF_TAG = 34675, 34665
_REDUCED = 1
_PATTERNS: dict[bytes, Pattern] = {bytes((0, 1, 1, 2)): "RGGB", bytes((1, 0, 2, 1)): "GRBG",
             bytes((1, 2, 0, 1)): "GBRG", bytes((2, 1, 1, 0)): "BGGR"}  # fmt: skip


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
        tiff = _opened(data)
        capture = _capture(data, tiff)
        if capture is not None:
            return capture
        stack = _stack(tiff, len(data))
        first = stack.first
        tags = _tags(first)
    return StoredImage(
        format="TIFF",
        count=stack.count,
        page=stack.page,
        marked=partial(_marked, first, tags),
        unmarked=(LINEAR, "TIFF"),
        facts=PhotographFacts.of_tags(tags, first.imagewidth),
        is_jpeg=int(first.compression) in _JPEG,
        pattern=_pattern(first),
    )


def tiff_facts(data: bytes) -> tuple[PhotographFacts, frozenset[int]]:
    """What the first directory says of the photograph, and the numbers of its tags.

    Of a damaged file nothing is said: whoever reads the pixels finds the damage.
    """
    try:
        first = _opened(data).pages.first
        facts = PhotographFacts.of_tags(_tags(first), 0)
        return facts, frozenset(tag.code for tag in first.tags)
    except TIFF_DAMAGE:
        return PhotographFacts(), frozenset()


def _opened(data: bytes) -> tifffile.TiffFile:
    logging.getLogger("tifffile").setLevel(logging.CRITICAL)
    return tifffile.TiffFile(BytesIO(data))


def _capture(data: bytes, tiff: tifffile.TiffFile) -> StoredImage | None:
    """The mean of a session's capture, whose second page is the variance; None for other files."""
    info = (tiff.imagej_metadata or {}).get("Info")
    if not isinstance(info, str) or not info.startswith("{"):
        return None
    try:
        capture = parse_capture(data, source="capture")
    except SessionError:
        return None
    variance = capture.variance_dn2
    return StoredImage(
        format="TIFF",
        count=1,
        page=lambda _: capture.mean_dn,
        marked=lambda: (LINEAR, "its record of the capture"),
        saturation_dn=capture.record.max_level_dn,
        variance_dn2=None if variance is None else variance.astype(np.float64),
        frames=capture.record.frames_used,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Stack:
    """The full-size images of a file: its pages, or those of one contiguous ImageJ stack."""

    pages: tuple[tifffile.TiffPage | tifffile.TiffFrame, ...]
    series: tifffile.TiffPageSeries | None
    count: int
    file_bytes: int

    @property
    def first(self) -> tifffile.TiffPage:
        page = self.pages[0]
        assert isinstance(page, tifffile.TiffPage)
        return page

    def page(self, index: int) -> NDArray[Any]:
        """Decode one image, from 0.

        Raises
        ------
        DecodingError
            If it is damaged or cut short.
        """
        with decoding("TIFF image"):
            if self.series is not None:
                whole = self.series.asarray()
                return np.asarray(whole.reshape(-1, *whole.shape[-2:])[index])
            page = self.pages[index]
            _refuse_giant(page, self.file_bytes)
            pixels = page.asarray()
            if pixels.shape != page.shape:
                raise DecodingError(f"cut short: {pixels.shape} of {page.shape} pixels")
            return _as_shown(pixels, self.first)


def _stack(tiff: tifffile.TiffFile, file_bytes: int) -> _Stack:
    if len(tiff.pages) > MOST_PAGES:
        raise DecodingError(f"a TIFF of more than {MOST_PAGES} pages")
    pages = [page for page in tiff.pages if not _is_reduced(page)]
    if not pages:  # a thumbnail first, the image in a directory below it
        below = tiff.pages.first.pages or ()
        pages = [page for page in below if not _is_reduced(page)] or list(tiff.pages)
    first = pages[0]
    if not isinstance(first, tifffile.TiffPage):
        first = first.aspage()
    without_luma = _WITHOUT_LUMA.get(int(first.photometric))
    if without_luma is not None:
        raise DecodingError(f"its colours are {without_luma}; convert it to RGB or grey")
    _refuse_giant(first, file_bytes)
    series = None
    count = len(pages)
    if count == 1 and tiff.is_imagej and tiff.series:
        # ImageJ writes one directory for a stack of more than 4 GB, and some programs always.
        whole = tiff.series[0]
        frames = int(np.prod(whole.shape[:-2], dtype=np.int64)) if first.samplesperpixel == 1 else 1
        if frames > 1:
            _refuse_giant(first, file_bytes, frames)
            series, count = whole, frames
    return _Stack(pages=(first, *pages[1:]), series=series, count=count, file_bytes=file_bytes)


def _is_reduced(page: tifffile.TiffPage | tifffile.TiffFrame) -> bool:
    return bool(int(getattr(page, "subfiletype", 0) or 0) & _REDUCED)


def _refuse_giant(
    page: tifffile.TiffPage | tifffile.TiffFrame, file_bytes: int, frames: int = 1
) -> None:
    """Check the size of a page, or of a contiguous stack of that many, before it is decoded."""
    key = page.keyframe
    if key is None or key.dtype is None:
        raise DecodingError("a TIFF of a type of numbers that is not read")
    if int(key.imagedepth) != 1:
        raise DecodingError("a volume, not an image")
    shape = (frames * int(key.imagelength), int(key.imagewidth), int(key.samplesperpixel))
    refuse_giant(shape, key.dtype.itemsize, file_bytes)


def _as_shown(pixels: NDArray[Any], key: tifffile.TiffPage) -> NDArray[Any]:
    """Rows, columns, channels; black at 0; a palette replaced by its colours."""
    if pixels.ndim == 3 and int(key.planarconfig) == 2 and pixels.shape[0] == key.samplesperpixel:
        pixels = np.moveaxis(pixels, 0, -1)
    photometric = int(key.photometric)
    if photometric == _MIN_IS_WHITE and pixels.dtype.kind == "u":
        return np.asarray(np.iinfo(pixels.dtype).max - pixels)
    if photometric == _PALETTE and key.colormap is not None:
        return np.asarray(np.moveaxis(key.colormap, 0, -1)[pixels])
    return pixels


def _tags(page: tifffile.TiffPage) -> dict[int, object]:
    """The tags of the page and of its Exif directory by number."""
    tags: dict[int, object] = {}
    for tag in page.tags:
        if tag.code < 0x0200 or tag.code > 0x8000:
            tags.setdefault(tag.code, tag.value)
    exif = tags.get(_EXIF_TAG)
    if isinstance(exif, dict):
        codes = tifffile.TIFF.EXIF_TAGS
        for name, value in exif.items():
            tags.setdefault(int(codes[name]), value)
    return tags


def _marked(page: tifffile.TiffPage, tags: dict[int, object]) -> tuple[Encoding, str] | None:
    tag = page.tags.get(_ICC_TAG)
    if tag is not None and isinstance(tag.value, bytes):
        profile = read_profile(tag.value)
        return profile.encoding, f"its ICC profile {profile.name}".rstrip()
    return (SRGB, "its Exif") if is_srgb(tags) else None


def _pattern(page: tifffile.TiffPage) -> Pattern | None:
    if int(page.photometric) != _CFA:
        return None
    tag = page.tags.get("CFAPattern")
    found = _PATTERNS.get(bytes(tag.value)) if tag is not None else None
    if found is None:
        raise DecodingError("a raw mosaic whose pattern of colours is not 2 x 2 of a Bayer filter")
    return found
