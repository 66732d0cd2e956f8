"""Image files of the tests, made in memory by libraries that the reader does not use for it."""

import struct
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from acquisition.photographs.photograph import Photograph
from acquisition.photographs.reader import ReadOptions, read_image

Pixels = NDArray[Any]
RNG = np.random.default_rng(4)
GREY = RNG.integers(0, 256, (40, 52)).astype(np.uint8)
COLOUR = RNG.integers(0, 256, (40, 52, 3)).astype(np.uint8)
GREY_16 = RNG.integers(0, 65536, (40, 52)).astype(np.uint16)
COLOUR_16 = RNG.integers(0, 65536, (40, 52, 3)).astype(np.uint16)


def pillow(pixels: Pixels | Image.Image, kind: str, **options: Any) -> bytes:
    image = pixels if isinstance(pixels, Image.Image) else Image.fromarray(pixels)
    buffer = BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()


def tiff(pixels: Pixels, **options: Any) -> bytes:
    buffer = BytesIO()
    tifffile.imwrite(buffer, pixels, **options)
    return buffer.getvalue()


def png(pixels: Pixels, *chunks: tuple[bytes, bytes]) -> bytes:
    """A PNG of 8 or 16 bits with these chunks before its pixels, by the specification."""
    rows, cols, *channels = pixels.shape
    colours = {(): 0, (2,): 4, (3,): 2, (4,): 6}[tuple(channels)]
    head = struct.pack(">IIBBBBB", cols, rows, 8 * pixels.dtype.itemsize, colours, 0, 0, 0)
    wide = pixels.astype(pixels.dtype.newbyteorder(">")).reshape(rows, -1)
    lines = b"".join(b"\0" + line.tobytes() for line in wide)
    every = ((b"IHDR", head), *chunks, (b"IDAT", zlib.compress(lines)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(content))
        + name
        + content
        + struct.pack(">I", zlib.crc32(name + content))
        for name, content in every
    )


def icc_chunk(profile: bytes) -> tuple[bytes, bytes]:
    return b"iCCP", b"made\0\0" + zlib.compress(profile)


def read(
    folder: Path, data: bytes, options: ReadOptions | None = None, name: str = "image.dat"
) -> Photograph:
    path = folder / name
    path.write_bytes(data)
    return read_image(path, options or ReadOptions())


Tag = tuple[int, int, int, bytes]
"""Number, type, count and value of a tag, little-endian."""


def ascii_tag(number: int, text: str) -> Tag:
    return number, 2, len(text) + 1, text.encode() + b"\0"


def short_tag(number: int, *values: int) -> Tag:
    return number, 3, len(values), struct.pack(f"<{len(values)}H", *values)


def long_tag(number: int, *values: int) -> Tag:
    return number, 4, len(values), struct.pack(f"<{len(values)}I", *values)


def ratio_tag(number: int, *values: int) -> Tag:
    return number, 5, len(values) // 2, struct.pack(f"<{len(values)}I", *values)


def directory(tags: list[Tag], at: int, following: int = 0) -> bytes:
    """One directory of a little-endian TIFF that starts at ``at``, its long values behind it."""
    tags = sorted(tags)
    values_at = at + 2 + 12 * len(tags) + 4
    entries, values = b"", b""
    for number, kind, count, value in tags:
        inline = value.ljust(4, b"\0")
        if len(value) > 4:
            inline = struct.pack("<I", values_at + len(values))
            values += value + bytes(len(value) % 2)
        entries += struct.pack("<HHI", number, kind, count) + inline
    return struct.pack("<H", len(tags)) + entries + struct.pack("<I", following) + values


def grey_tags(
    rows: int, cols: int, at: int, *, bits: int = 8, size: int | None = None
) -> list[Tag]:
    """The tags of an uncompressed grey image in one strip at ``at``."""
    return [
        long_tag(256, cols),
        long_tag(257, rows),
        short_tag(258, bits),
        short_tag(259, 1),
        short_tag(262, 1),
        long_tag(273, at),
        short_tag(277, 1),
        long_tag(278, rows),
        long_tag(279, rows * cols * bits // 8 if size is None else size),
    ]


def tiff_with_exif(main: list[Tag], exif: list[Tag]) -> bytes:
    """A grey TIFF of ``GREY`` with tags of its own and of an Exif directory."""
    data = b"II*\0" + struct.pack("<I", 8 + GREY.size) + GREY.tobytes()
    tags = [*grey_tags(40, 52, 8), *main]
    size = len(directory([*tags, long_tag(34665, 0)], 0))
    below = 8 + GREY.size + size
    return data + directory([*tags, long_tag(34665, below)], below - size) + directory(exif, below)
