"""JPEG files as phones send them: their size before they are decoded, and no place in them.

Sources: Exif 3.0 (CIPA DC-008-2023), section 4.5.4; ITU-T T.81 (1992), annex B.
"""

import struct
import warnings
from collections.abc import Iterator

from PIL import Image

from acquisition.errors import ImageFileError

_START = b"\xff\xd8"
_GPS, _ORIENTATION = 0x8825, 0x0112
_TEXTS = (0x010D, 0x010E, 0x9C9B, 0x9C9C, 0x9C9D, 0x9C9E, 0x9C9F, 0x02BC, 0x83BB, 0x8649)
"""Document's name, description, Windows' title, comment, author, keywords and subject, and the XMP,
IPTC and Photoshop blocks that Exif has as tags: each may name the place."""

_EXIF_IFD = 0x8769
_EXIF_TEXTS = (0x927C, 0x9286)
"""The maker's note and the user's comment."""
_EXIF = b"Exif\0\0"
_SCAN, _END, _COMMENT = 0xDA, 0xD9, 0xFE
_EXIF_MARKER = 0xE1
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_FRAME_BYTES = 10
_NO_PIXELS = "the JPEG file is damaged: it ends within its pixels"
_APPS = range(0xE0, 0xF0)
_WITHOUT_LENGTH = frozenset((0x00, 0x01, *range(0xD0, 0xDA)))
"""Markers that stand alone, and the zero that is none; headers have none of them."""
_KEPT = {0xE0: b"JFIF", 0xE2: b"ICC_PROFILE", 0xEE: b"Adobe"}
"""Segments of applications that say how the pixels are read; all others may name a place."""


class JpegError(ImageFileError):
    """What was sent is not a whole JPEG file."""


def jpeg_size(data: bytes) -> tuple[int, int]:
    """Return ``(width, height)`` as a JPEG file states them; nothing is decoded.

    Raises
    ------
    JpegError
        If it is not a JPEG file.
    """
    for marker, segment, _ in _segments(data):
        if marker in _FRAMES and len(segment) >= _FRAME_BYTES:
            height, width = struct.unpack_from(">HH", segment, 5)
            return width, height
    raise JpegError("it is not a JPEG file that states its size")


def without_location(data: bytes) -> bytes:
    """Return a JPEG file without its GPS tags, and without all else that may name the place.

    The coded pixels, the profile and Exif's other tags stay; its texts and the maker's note go, and
    so does what follows the image (previews, films), which has tags of its own. Of Exif that cannot
    be read nothing stays.

    Raises
    ------
    JpegError
        If it is not a whole JPEG file.
    """
    parts = [_START]
    for marker, segment, at in _segments(data):
        if marker == _SCAN:
            return b"".join([*parts, data[at : _end_of_image(data, at)]])
        body = segment[4:]
        if marker == _EXIF_MARKER and body.startswith(_EXIF):
            parts.append(_exif_segment(body))
        elif _is_kept(marker, body):
            parts.append(segment)
    raise JpegError(_NO_PIXELS)


def _segments(data: bytes) -> Iterator[tuple[int, bytes, int]]:
    """Yield marker, bytes and place of the segments up to the first scan's."""
    at, marker = len(_START), 0
    if not data.startswith(_START):
        raise JpegError("it is not a JPEG file")
    while marker != _SCAN and at + 4 <= len(data):
        if data[at] != 0xFF:
            raise JpegError("the JPEG file is damaged: its headers are cut off")
        marker = data[at + 1]
        if marker == 0xFF:  # a fill byte
            at += 1
            continue
        if marker in _WITHOUT_LENGTH:  # decoders do not take what follows for a length
            raise JpegError("the JPEG file is damaged: its headers hold a marker of its pixels")
        end = at + 2 + int(struct.unpack_from(">H", data, at + 2)[0])
        yield marker, data[at:end], at
        at = end


def _is_kept(marker: int, body: bytes) -> bool:
    """Whether a segment, Exif's apart, cannot name the place."""
    if marker in _APPS:
        return marker in _KEPT and body.startswith(_KEPT[marker])
    return marker != _COMMENT


def _exif_segment(body: bytes) -> bytes:
    """Exif's tags without those of the place, as a segment; empty if they cannot be read."""
    exif = Image.Exif()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of damage that it can live with
            exif.load(body)
            within = exif.get_ifd(_EXIF_IFD)
            for tags, forgotten in ((exif, (_GPS, *_TEXTS)), (within, _EXIF_TEXTS)):
                for tag in forgotten:
                    if tag in tags:
                        del tags[tag]
            made = exif.tobytes()
    except (ValueError, SyntaxError, TypeError, KeyError, struct.error, OSError):
        return b""
    made = made if made.startswith(_EXIF) else _EXIF + made
    return b"\xff\xe1" + struct.pack(">H", len(made) + 2) + made if len(made) < 65_533 else b""


def _end_of_image(data: bytes, at: int) -> int:
    """Where the image ends whose first scan begins at a place."""
    while True:
        at = data.find(b"\xff", at)
        if at < 0 or at + 1 >= len(data):
            raise JpegError(_NO_PIXELS)
        marker = data[at + 1]
        if marker == _END:
            return at + 2
        if marker == 0 or marker == 0xFF or 0xD0 <= marker <= 0xD7:
            at += 1 if marker == 0xFF else 2
            continue
        if at + 4 > len(data):
            raise JpegError(_NO_PIXELS)
        at += 2 + int(struct.unpack_from(">H", data, at + 2)[0])
