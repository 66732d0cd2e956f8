"""DNG files byte by byte: a thumbnail in the first directory, the mosaic in one below it.

Adobe, "Digital Negative (DNG) Specification", version 1.4.0.0.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.acquisition.photographs.made import (
    Tag,
    ascii_tag,
    directory,
    long_tag,
    ratio_tag,
    short_tag,
)

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
