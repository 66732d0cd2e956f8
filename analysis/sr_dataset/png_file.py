"""PNG files in a hurry: one filter for all rows, and the fastest compressor that is at hand.

Compression is the largest part of making a pair. libdeflate takes 55-85 % of the time of OpenCV's
fastest setting, for files of 95-108 % of the size (``benchmarks/speed/sr_pairs.py``).
"""

import struct
import zlib
from typing import Any

import imagecodecs
import numpy as np
from numpy.typing import NDArray

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_GREY, _RGB = 0, 2
_SUB_FILTER = 1
_LEVEL = 1


def png_bytes(levels: NDArray[Any]) -> bytes:
    """Return the bytes of a PNG file, without a mark of the encoding.

    Parameters
    ----------
    levels
        Shape ``(rows, cols)`` or, red first, ``(rows, cols, 3)``; uint8 or uint16.

    Raises
    ------
    ValueError
        If it is of another kind.

    References
    ----------
    Portable Network Graphics (PNG) Specification, third edition, W3C 2025, sections 5, 9, 11.
    """
    is_colour = levels.ndim == 3 and levels.shape[2] == 3
    if levels.dtype not in (np.uint8, np.uint16) or not (is_colour or levels.ndim == 2):
        raise ValueError(f"no PNG holds {levels.dtype} of shape {levels.shape}")
    rows, cols = levels.shape[:2]
    big_endian = np.ascontiguousarray(levels, dtype=levels.dtype.newbyteorder(">"))
    samples = big_endian.view(np.uint8).reshape(rows, -1)
    pixel_bytes = samples.shape[1] // cols
    filtered = np.empty((rows, 1 + samples.shape[1]), np.uint8)
    filtered[:, 0] = _SUB_FILTER
    filtered[:, 1 : 1 + pixel_bytes] = samples[:, :pixel_bytes]
    np.subtract(
        samples[:, pixel_bytes:], samples[:, :-pixel_bytes], out=filtered[:, 1 + pixel_bytes :]
    )
    depth, kind = 8 * levels.dtype.itemsize, _RGB if is_colour else _GREY
    return b"".join(
        (
            _SIGNATURE,
            _chunk(b"IHDR", struct.pack(">IIBBBBB", cols, rows, depth, kind, 0, 0, 0)),
            _chunk(b"IDAT", bytes(imagecodecs.deflate_encode(filtered.tobytes(), level=_LEVEL))),
            _chunk(b"IEND", b""),
        )
    )


def _chunk(kind: bytes, content: bytes) -> bytes:
    checked = kind + content
    return struct.pack(">I", len(content)) + checked + struct.pack(">I", zlib.crc32(checked))
