"""A frame as it is sent to a page: a short header and one byte per pixel."""

import struct
from threading import Lock

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.devices import FrameImage
from standoff.console.devices.frame_broadcaster import LiveFrame

HEADER = struct.Struct("<4sIdHH4x")
"""Magic, sequence, time of arrival in ms since 1970, columns, rows; then the pixels row by row."""

MAGIC = b"SOF1"

SATURATED = 255
"""A pixel at the largest level; every other pixel is at most one less."""


def levels_8bit(image_dn: FrameImage, max_level_dn: int) -> NDArray[np.uint8]:
    """Scale levels to 0 to 254, with 255 for saturated pixels; the shape is kept."""
    scaled = cv2.convertScaleAbs(image_dn, alpha=(SATURATED - 1) / max_level_dn)
    shown = np.minimum(scaled, SATURATED - 1, dtype=np.uint8)
    np.putmask(shown, image_dn >= max_level_dn, SATURATED)
    return shown


class PictureEncoder:
    """Encodes each frame once, for however many viewers."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._sequence = 0
        self._data = b""

    def encode(self, frame: LiveFrame) -> bytes:
        """Return header and pixels of a frame."""
        with self._lock:
            if frame.sequence != self._sequence:
                rows, cols = frame.image_dn.shape
                header = HEADER.pack(
                    MAGIC, frame.sequence & 0xFFFFFFFF, 1e3 * frame.received_s, cols, rows
                )
                pixels = levels_8bit(frame.image_dn, frame.settings.max_level_dn)
                self._data = header + pixels.tobytes()
                self._sequence = frame.sequence
            return self._data
