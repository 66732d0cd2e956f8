"""A frame as it is sent to a page: a short header, and its pixels as they are or compressed."""

import struct
from dataclasses import dataclass
from threading import Lock

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.devices import FrameImage
from standoff.console.devices.frame_broadcaster import LiveFrame

HEADER = struct.Struct("<4sIdHHI")
"""Magic, sequence, time of arrival in ms since 1970, columns, rows, bytes of the JPEG."""

EXACT, COMPRESSED = b"SOF1", b"SOF2"
"""Then follow the pixels row by row; or a JPEG, which may have fewer pixels, and a PNG of its size
whose white pixels are saturated, of no bytes where none are."""

SATURATED = 255
"""A pixel at the largest level; every other pixel is at most one less."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureForm:
    """How pixels are sent: each as it is where there is no ``quality``, which is JPEG's.

    One pixel is sent for each square of ``reduction`` pixels. Pictures of this form may come as
    seldom as every ``period_s``; where the link is slower, a smaller form serves better.
    ``bytes_per_px`` of the frame is the size to be expected before the first.
    """

    quality: int | None
    reduction: int
    period_s: float
    bytes_per_px: float


FORMS = (
    PictureForm(quality=None, reduction=1, period_s=0.1, bytes_per_px=1.0),
    PictureForm(quality=90, reduction=1, period_s=0.07, bytes_per_px=0.35),
    PictureForm(quality=70, reduction=1, period_s=0.07, bytes_per_px=0.2),
    PictureForm(quality=45, reduction=1, period_s=0.07, bytes_per_px=0.13),
    PictureForm(quality=70, reduction=2, period_s=0.25, bytes_per_px=0.05),
    PictureForm(quality=45, reduction=2, period_s=0.4, bytes_per_px=0.035),
    PictureForm(quality=45, reduction=4, period_s=0.5, bytes_per_px=0.01),
    PictureForm(quality=45, reduction=8, period_s=0.5, bytes_per_px=0.003),
)
"""From the best to the smallest."""


def levels_8bit(image_dn: FrameImage, max_level_dn: int) -> NDArray[np.uint8]:
    """Scale levels to 0 to 254, with 255 for saturated pixels; the shape is kept."""
    scaled = cv2.convertScaleAbs(image_dn, alpha=(SATURATED - 1) / max_level_dn)
    shown = np.minimum(scaled, SATURATED - 1, dtype=np.uint8)
    np.putmask(shown, image_dn >= max_level_dn, SATURATED)
    return shown


class PictureEncoder:
    """Encodes each frame once in each form, for however many viewers."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._sequence = 0
        self._pixels: NDArray[np.uint8] = np.empty((0, 0), np.uint8)
        self._encoded: dict[PictureForm, bytes] = {}
        self._bytes_per_px: dict[PictureForm, float] = {}
        self._detail = 1.0  # how much larger pictures are than was to be expected

    def encode(self, frame: LiveFrame, form: PictureForm = FORMS[0]) -> bytes:
        """Return header and pixels of a frame."""
        with self._lock:
            if frame.sequence != self._sequence:
                self._pixels = levels_8bit(frame.image_dn, frame.settings.max_level_dn)
                self._sequence, self._encoded = frame.sequence, {}
            if form not in self._encoded:
                data = _encoded(self._pixels, frame, form)
                self._encoded[form] = data
                self._bytes_per_px[form] = len(data) / self._pixels.size
                if form.quality is not None:
                    self._detail = self._bytes_per_px[form] / form.bytes_per_px
            return self._encoded[form]

    def size_bytes(self, frame: LiveFrame, form: PictureForm) -> float:
        """Size to be expected of a frame in a form, by the last one that was encoded so."""
        guess = form.bytes_per_px * (1.0 if form.quality is None else self._detail)
        return frame.image_dn.size * self._bytes_per_px.get(form, guess)


def _encoded(pixels: NDArray[np.uint8], frame: LiveFrame, form: PictureForm) -> bytes:
    rows, cols = pixels.shape
    facts = (frame.sequence & 0xFFFFFFFF, 1e3 * frame.received_s, cols, rows)
    if form.quality is None:
        return HEADER.pack(EXACT, *facts, 0) + pixels.tobytes()
    size = (-(-cols // form.reduction), -(-rows // form.reduction))
    reduced = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    picture = _file(".jpg", reduced, [cv2.IMWRITE_JPEG_QUALITY, form.quality])
    marks = b""
    is_saturated = pixels == SATURATED
    if is_saturated.any():
        share = cv2.resize(is_saturated.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        white = np.where(share > 0, SATURATED, 0).astype(np.uint8)  # where one is, the square is
        marks = _file(".png", white, [cv2.IMWRITE_PNG_BILEVEL, 1])
    return HEADER.pack(COMPRESSED, *facts, len(picture)) + picture + marks


def _file(suffix: str, pixels: cv2.typing.MatLike, options: list[int]) -> bytes:
    is_done, data = cv2.imencode(suffix, pixels, options)
    assert is_done
    return data.tobytes()
