"""Removes where a JPEG was taken, and nothing of its pixels.

Sources: Exif 3.0 (CIPA DC-008-2023), section 4.5.4; ITU-T T.81 (1992), annex B.
"""

import struct

from PIL import Image

from acquisition.errors import ImageFileError

_GPS = 0x8825
_EXIF = b"Exif\0\0"
_SCAN, _END, _COMMENT = 0xDA, 0xD9, 0xFE
_APPS = range(0xE0, 0xF0)
_KEPT = {0xE0: b"JFIF", 0xE2: b"ICC_PROFILE", 0xEE: b"Adobe"}
"""Segments of applications that say how the pixels are read; all others may name a place."""


def without_location(data: bytes) -> bytes:
    """Return a JPEG file without its GPS tags, and without all else that may name the place.

    The coded pixels, the profile and Exif's other tags stay; what follows the image (previews,
    films) goes, for it has tags of its own.

    Raises
    ------
    ImageFileError
        If it is not a whole JPEG file.
    """
    parts = [b"\xff\xd8"]
    at = 2
    try:
        if data[:2] != parts[0]:
            raise ImageFileError("the location can be removed from JPEG files alone")
        while True:
            if data[at] != 0xFF:
                raise ImageFileError("the photograph is damaged: its headers are cut off")
            marker = data[at + 1]
            if marker == 0xFF:  # a fill byte
                at += 1
                continue
            (length,) = struct.unpack_from(">H", data, at + 2)
            segment = data[at : at + 2 + length]
            if marker == _SCAN:
                return b"".join([*parts, data[at : _end_of_image(data, at)]])
            body = segment[4:]
            if marker == 0xE1 and body.startswith(_EXIF):
                parts.append(_exif_segment(body))
            elif _is_kept(marker, body):
                parts.append(segment)
            at += 2 + length
    except (IndexError, struct.error) as error:
        raise ImageFileError("the photograph is damaged: its headers are cut off") from error


def _is_kept(marker: int, body: bytes) -> bool:
    """Whether a segment, Exif's apart, cannot name the place."""
    if marker in _APPS:
        return marker in _KEPT and body.startswith(_KEPT[marker])
    return marker != _COMMENT


def _exif_segment(body: bytes) -> bytes:
    """Exif's tags without those of the place, as a segment; empty if they cannot be read."""
    exif = Image.Exif()
    try:
        exif.load(body)
        if _GPS in exif:
            del exif[_GPS]
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
            raise ImageFileError("the photograph is damaged: it ends within its pixels")
        marker = data[at + 1]
        if marker == _END:
            return at + 2
        if marker == 0 or marker == 0xFF or 0xD0 <= marker <= 0xD7:
            at += 1 if marker == 0xFF else 2
            continue
        at += 2 + int(struct.unpack_from(">H", data, at + 2)[0])
