"""Decode the bytes of a GigE Vision image block into an image.

Mono12Packed and BayerXX12Packed put two pixels in three bytes: the high eight bits of the first,
a byte with the low four bits of both (the first pixel's in the low nibble), the high eight bits
of the second. Pixels follow each other across the ends of rows; the last of an odd number takes
two bytes. Everything else is one byte, or two bytes little-endian with the value in the low bits.

References
----------
AIA, GigE Vision, version 2.0 (2011), section "Pixel layouts", GVSP_PIX_MONO12_PACKED.
"""

import re
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from acquisition.devices import FrameImage

_WIRE_WORD = np.dtype("<u2")
_FORMAT = re.compile(r"(?:Mono|Bayer(?:RG|GR|GB|BG))(8|10|12|14|16|12Packed)")


def can_decode(pixel_format: str) -> bool:
    """Whether `decode_pixels` supports the PFNC name."""
    return _FORMAT.fullmatch(pixel_format) is not None


def encoded_bytes(pixel_format: str, shape: tuple[int, int]) -> int:
    """Number of bytes that an image of ``(rows, cols)`` takes on the wire.

    Raises
    ------
    ValueError
        If the pixel format is not supported.
    """
    pixels = shape[0] * shape[1]
    depth = _depth(pixel_format)
    if depth == "12Packed":
        return (3 * pixels + 1) // 2
    return pixels if depth == "8" else 2 * pixels


def decode_pixels(
    data: bytes | memoryview, pixel_format: str, shape: tuple[int, int]
) -> FrameImage:
    """Decode ``data`` to levels in DN of the pixel format; colour mosaics stay mosaics.

    Parameters
    ----------
    data
        At least as long as the image; what follows it is ignored.
    pixel_format
        PFNC name: Mono or BayerXX with 8, 10, 12, 14, 16 or 12Packed.
    shape
        ``(rows, cols)``.

    Returns
    -------
    ndarray of uint8 or uint16, shape ``shape``
        Read-only where it shares the memory of ``data``, as all but the packed formats do.

    Raises
    ------
    ValueError
        If the pixel format is not supported or ``data`` is too short.
    """
    size = encoded_bytes(pixel_format, shape)
    if len(data) < size:
        raise ValueError(
            f"a {pixel_format} image of {shape[1]}x{shape[0]} takes {size} bytes, got {len(data)}"
        )
    depth = _depth(pixel_format)
    if depth == "8":
        return np.frombuffer(data, np.uint8, size).reshape(shape)
    if depth == "12Packed":
        pixels_dn = np.empty(shape, np.uint16)
        _unpack_12(np.frombuffer(data, np.uint8, size), pixels_dn.reshape(-1))
        return pixels_dn
    wire = np.frombuffer(data, _WIRE_WORD, size // 2).reshape(shape)
    return wire.astype(np.uint16, copy=False)


@cache
def _depth(pixel_format: str) -> str:
    match = _FORMAT.fullmatch(pixel_format)
    if match is None:
        raise ValueError(f"pixel format {pixel_format!r} cannot be decoded")
    return match[1]


@njit(cache=True)
def _unpack_12(packed: NDArray[np.uint8], pixels_dn: NDArray[np.uint16]) -> None:
    for pair in range(pixels_dn.size // 2):
        nibbles = np.uint16(packed[3 * pair + 1])
        pixels_dn[2 * pair] = (np.uint16(packed[3 * pair]) << 4) | (nibbles & 15)
        pixels_dn[2 * pair + 1] = (np.uint16(packed[3 * pair + 2]) << 4) | (nibbles >> 4)
    if pixels_dn.size % 2:
        pixels_dn[-1] = (np.uint16(packed[-2]) << 4) | (packed[-1] & 15)
