"""Pixel formats as a GigE Vision camera sends them: from 12-bit levels to bytes on the wire.

References
----------
Pixel Format Naming Convention (PFNC) 2.1, EMVA, 2016, and its list of 32-bit values; the packed
formats are the older ones of GigE Vision 1.2, section 26: three bytes hold two pixels.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil_mocks.scene import MONO8_SHIFT

MONO16_SHIFT = 4
"""Mono16 holds the 12 bits in its upper bits."""

BAYER_ORDERS = ("GR", "RG", "GB", "BG")


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelLayout:
    """Memory layout of the levels of one pixel format."""

    code: int
    significant_bits: int
    is_packed: bool = False

    @property
    def bits_per_pixel(self) -> int:
        """Bits of a pixel on the wire, as contained in the code (PFNC)."""
        return self.code >> 16 & 0xFF


def _layouts() -> dict[str, PixelLayout]:
    layouts = {
        "Mono8": PixelLayout(code=0x01080001, significant_bits=8),
        "Mono12": PixelLayout(code=0x01100005, significant_bits=12),
        "Mono12Packed": PixelLayout(code=0x010C0006, significant_bits=12, is_packed=True),
        "Mono16": PixelLayout(code=0x01100007, significant_bits=16),
    }
    for index, order in enumerate(BAYER_ORDERS):
        layouts |= {
            f"Bayer{order}8": PixelLayout(code=0x01080008 + index, significant_bits=8),
            f"Bayer{order}12": PixelLayout(code=0x01100010 + index, significant_bits=12),
            f"Bayer{order}12Packed": PixelLayout(
                code=0x010C002A + index, significant_bits=12, is_packed=True
            ),
        }
    return layouts


PIXEL_LAYOUTS = _layouts()
"""Every pixel format by its name."""


def pixel_formats_of(bayer_order: str | None) -> tuple[str, ...]:
    """Names that a camera offers: the mono ones, and those of its colour filter if it has one."""
    mono = ("Mono8", "Mono12", "Mono12Packed", "Mono16")
    if bayer_order is None:
        return mono
    return (*mono, *(f"Bayer{bayer_order}{depth}" for depth in ("8", "12", "12Packed")))


def image_of_levels(
    level_dn: NDArray[np.uint16], layout: PixelLayout
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Convert 12-bit levels to those of a pixel format, unpacked as a client reads them."""
    if layout.significant_bits == 8:
        return (level_dn >> MONO8_SHIFT).astype(np.uint8)
    if layout.significant_bits == 16:
        return (level_dn << MONO16_SHIFT).astype(np.uint16, copy=False)
    return level_dn


def wire_bytes(level_dn: NDArray[np.uint16], layout: PixelLayout) -> NDArray[np.uint8]:
    """Bytes of an image of 12-bit levels in a pixel format, shape ``(n,)``.

    Raises
    ------
    ValueError
        If a packed format has an odd number of pixels.
    """
    image = np.ascontiguousarray(image_of_levels(level_dn, layout)).ravel()
    if not layout.is_packed:
        return image.astype(image.dtype.newbyteorder("<"), copy=False).view(np.uint8)
    if image.size % 2:
        raise ValueError(f"a packed image needs an even number of pixels, got {image.size}")
    pairs = np.ascontiguousarray(image).view("<u4")
    # One pair is 0x0BBB0AAA; its bytes are A >> 4, then both low nibbles (A's below), then B >> 4.
    packed = np.empty((pairs.size, 3), np.uint8)
    packed[:, 0] = pairs >> 4
    packed[:, 1] = (pairs & 0x0F) | (pairs >> 12 & 0xF0)
    packed[:, 2] = pairs >> 20
    return packed.ravel()
