"""Image files of the tests, made in memory by libraries that the reader does not use for it.

Colour profiles are written byte by byte as ICC.1:2022 lays them out, and DNG files with a thumbnail
in the first directory and the mosaic in one below it: Adobe, "Digital Negative (DNG)
Specification", version 1.4.0.0.
"""

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from acquisition.photographs._photograph import Photograph
from acquisition.photographs._reader import ReadOptions, read_photograph

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
    return read_photograph(path, options or ReadOptions())


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


S15 = 65536.0


def curve_of(*entries: int) -> bytes:
    """curveType (10.6): nothing is linear, one entry a gamma in u8Fixed8, more a table."""
    return struct.pack(f">4s4xI{len(entries)}H", b"curv", len(entries), *entries)


def gamma_curve(gamma: float) -> bytes:
    return curve_of(round(gamma * 256))


def parametric(kind: int, *parameters: float) -> bytes:
    """parametricCurveType (10.18)."""
    numbers = [round(value * S15) for value in parameters]
    return struct.pack(f">4s4xHxx{len(numbers)}i", b"para", kind, *numbers)


def profile(*curves: bytes, space: bytes = b"RGB ", name: str = "made") -> bytes:
    """A profile with these curves: one for all of red, green and blue, one each, or one of grey."""
    names = (b"kTRC",) if space == b"GRAY" else (b"rTRC", b"gTRC", b"bTRC")
    tags = {b"desc": struct.pack(f">4s4xI{len(name) + 1}s", b"desc", len(name) + 1, name.encode())}
    if curves:
        tags |= {tag: curves[i % len(curves)] for i, tag in enumerate(names)}
    at = 132 + 12 * len(tags)
    table, content = struct.pack(">I", len(tags)), b""
    for tag, value in tags.items():
        value += bytes(-len(value) % 4)
        table += struct.pack(">4sII", tag, at + len(content), len(value))
        content += value
    head = struct.pack(">I8x4s4s4s12x4s88x", at + len(content), b"mntr", space, b"XYZ ", b"acsp")
    # Version 4.4 in bytes 8 to 11.
    return head[:8] + b"\4\x40\0\0" + head[12:] + table + content


SRGB_CURVE = parametric(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
DISPLAY_P3 = profile(SRGB_CURVE, name="Display P3")


CELLS = {"RGGB": (0, 1, 1, 2), "GRBG": (1, 0, 2, 1), "GBRG": (1, 2, 0, 1), "BGGR": (2, 1, 1, 0)}
THUMBNAIL_LEVEL = 200
CFA, LINEAR_RAW = 32803, 34892


def byte_tag(number: int, *values: int) -> Tag:
    return number, 1, len(values), bytes(values)


@dataclass(frozen=True, kw_only=True)
class Dng:
    """A camera raw file of 16-bit levels.

    ``black`` holds one level, or one for each channel, or for each pixel of a block of
    ``black_repeat`` rows and columns; ``table`` is the linearisation table.
    """

    levels: NDArray[np.uint16]
    cells: Sequence[int] = CELLS["RGGB"]
    black: Sequence[int] = (64,)
    black_repeat: tuple[int, int] = (1, 1)
    white: int = 4000
    table: NDArray[np.uint16] | None = None
    model: str = "T1"

    def to_bytes(self) -> bytes:
        rows, cols = self.levels.shape[:2]
        thumbnail = bytes([THUMBNAIL_LEVEL]) * (16 * 24 * 3)
        pixels = self.levels.astype("<u2").tobytes()
        thumbnail_at = 8
        pixels_at = thumbnail_at + len(thumbnail)
        first_at = pixels_at + len(pixels)
        size = len(directory(self._first_tags(thumbnail_at, 0), first_at))
        first = directory(self._first_tags(thumbnail_at, first_at + size), first_at)
        below = directory(self._raw_tags(rows, cols, pixels_at), first_at + size)
        head = b"II*\0" + struct.pack("<I", first_at)
        return head + thumbnail + pixels + first + below

    def _first_tags(self, at: int, below: int) -> list[Tag]:
        neutral = [1, 1] * 3
        diagonal = [1 if i % 4 == 0 else 0 for i in range(9)]
        matrix = struct.pack("<18i", *(part for value in diagonal for part in (value, 1)))
        return [
            *_strip(16, 24, at, samples=3, bits=8, photometric=2),
            long_tag(254, 1),  # a reduced image
            ascii_tag(271, "Testmaker"),
            ascii_tag(272, self.model),
            long_tag(330, below),
            byte_tag(50706, 1, 4, 0, 0),
            byte_tag(50707, 1, 1, 0, 0),
            ascii_tag(50708, f"Testmaker {self.model}"),
            (50721, 10, 9, matrix),
            ratio_tag(50728, *neutral),
            short_tag(50778, 21),
        ]

    def _raw_tags(self, rows: int, cols: int, at: int) -> list[Tag]:
        samples = 1 if self.levels.ndim == 2 else self.levels.shape[2]
        kind = CFA if samples == 1 else LINEAR_RAW
        tags = [
            *_strip(rows, cols, at, samples=samples, bits=16, photometric=kind),
            long_tag(254, 0),
            short_tag(50714, *self.black),
            short_tag(50717, *[self.white] * samples),
        ]
        if samples == 1:
            side = round(len(self.cells) ** 0.5)
            tags += [short_tag(33421, side, side), byte_tag(33422, *self.cells)]
        if self.black_repeat != (1, 1):
            tags.append(short_tag(50713, *self.black_repeat))
        if self.table is not None:
            tags.append(short_tag(50712, *self.table.tolist()))
        return tags


def _strip(
    rows: int, cols: int, at: int, *, samples: int, bits: int, photometric: int
) -> list[Tag]:
    return [
        long_tag(256, cols),
        long_tag(257, rows),
        short_tag(258, *[bits] * samples),
        short_tag(259, 1),
        short_tag(262, photometric),
        long_tag(273, at),
        short_tag(277, samples),
        long_tag(278, rows),
        long_tag(279, rows * cols * samples * bits // 8),
        short_tag(284, 1),
    ]
