"""Image files that are damaged, hostile, or hold what no camera gives."""

import struct
import zlib
from collections.abc import Callable, Iterator
from functools import cache
from io import BytesIO
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from PIL import Image

from tests.acquisition.photographs.made import png, tiff
from tests.fuzz.commands.odd_file import OddFile, cut_short, of_bytes, with_flipped_bits
from tests.fuzz.photograph_targets import RASTERS, RAWS, TIFFS

RNG = np.random.default_rng(8)
SHAPE = (64, 64)
GREY_16 = RNG.integers(0, 4000, SHAPE).astype(np.uint16)
GREY_8 = (GREY_16 >> 4).astype(np.uint8)
COLOUR = np.dstack([GREY_8] * 3)

LEVELS = (1e300, -1e300, 3e38, -3e38, 1e30, 1e19, 1e-310, 0.0, -5.0, np.nan, np.inf, -np.inf)
COMPRESSIONS = (
    *("zstd", "lzw", "deflate", "packbits", "lzma", "webp", "jpeg", "jpeg2000", "jpegxl", "png"),
    *("lerc", "none"),
)
TAG_VALUES = (0, 1, 0x7FFFFFFF, 0xFFFFFFFF)


def odd_images() -> Iterator[OddFile]:
    """All cases, beside those of places."""
    yield from _levels()
    yield from _shapes_and_types()
    yield from _compressions()
    yield from _tags()
    yield from _formats()
    yield from _bombs()
    yield from _no_images()


def _levels() -> Iterator[OddFile]:
    """Levels beyond any camera: all of them, or one pixel."""
    kinds: tuple[Any, ...] = (np.float64, np.float32)
    for level, kind in product(LEVELS, kinds):
        with np.errstate(over="ignore"):
            value = kind(level)
        one = GREY_16.astype(kind)
        one[20, 30] = value
        is_refused = not abs(value) <= 1e9
        for name, pixels in (("all", np.full(SHAPE, value, kind)), ("one", one)):
            yield _tiff(f"{name} of {level:g}", f"{kind.__name__}", pixels, is_refused=is_refused)


def _shapes_and_types() -> Iterator[OddFile]:
    for kind in ("c8", "c16", "i1", "i2", "i4", "i8", "u4", "u8", "f2"):
        yield _tiff(
            f"levels of type {kind}", "all", GREY_16.astype(kind), is_refused=kind[0] == "c"
        )
    shapes = (
        (1, 1),
        (1, 64),
        (64, 1),
        (2, 2),
        (3, 3),
        (5, 5),
        (8, 8),
        (9, 64),
        (64, 9),
        (1, 30000),
    )
    for shape in shapes:
        yield _tiff(f"{shape[0]} x {shape[1]} px", "noise", RNG.integers(0, 9999, shape, np.uint16))
    for level in (0, 7, 65535):
        yield _tiff(f"a constant of {level}", "16 bit", np.full(SHAPE, level, np.uint16))
    for pages in (2, 3, 40):
        stack = RNG.integers(0, 4000, (pages, *SHAPE), np.uint16)
        yield _tiff(f"a stack of {pages}", "16 bit", stack, photometric="minisblack")
    for channels in (2, 5, 7):
        yield _tiff(
            f"{channels} channels",
            "8 bit",
            np.dstack([GREY_8] * channels),
            is_refused=channels > 4,
            photometric="minisblack",
            planarconfig="contig",
        )
    for mode in ("CMYK", "LAB", "YCbCr", "RGBA", "LA", "P", "1"):
        yield OddFile(kind=f"colours {mode}", name="Pillow", make=_saver(mode))


def _saver(mode: str) -> Callable[[Path], object]:
    image = Image.fromarray(COLOUR)
    converted = image.convert("L").convert("LA") if mode == "LA" else image.convert(mode)
    return lambda path: converted.save(path, "TIFF")


def _tiff(kind: str, name: str, pixels: Any, *, is_refused: bool = False, **how: Any) -> OddFile:
    return of_bytes(kind, name, tiff(pixels, **how), is_refused=is_refused)


@cache
def compressed(compression: str) -> bytes:
    """A sound TIFF in tiles, in colour where that compression knows nothing else."""
    is_colour = compression in ("webp", "jpeg")
    return tiff(
        COLOUR if is_colour else GREY_16,
        compression=None if compression == "none" else compression,
        photometric="rgb" if is_colour else "minisblack",
        tile=(32, 32),
    )


def _compressions() -> Iterator[OddFile]:
    for name in COMPRESSIONS:
        data, kind = compressed(name), f"TIFF by {name}"
        yield of_bytes(f"{kind}, sound", name, data)
        yield from cut_short(kind, name, data, 4)
        yield from with_flipped_bits(kind, name, data, 4)


def _tags() -> Iterator[OddFile]:
    """Each tag of a TIFF with another type, count or value."""
    data = tiff(GREY_16, compression="deflate", rowsperstrip=16)
    first = struct.unpack_from("<I", data, 4)[0]
    for index in range(struct.unpack_from("<H", data, first)[0]):
        entry = first + 2 + 12 * index
        number = struct.unpack_from("<H", data, entry)[0]
        for field, form, values in (
            ("type", "<H", (0, 2, 12, 255)),
            ("count", "<I", TAG_VALUES),
            ("value", "<I", TAG_VALUES),
        ):
            at = entry + {"type": 2, "count": 4, "value": 8}[field]
            for value in values:
                damaged = bytearray(data)
                struct.pack_into(form, damaged, at, value)
                yield of_bytes(
                    f"TIFF tag of another {field}", f"tag {number}, {value}", bytes(damaged)
                )
    for name, offset in (
        ("itself", first),
        ("the head", 0),
        ("the end", len(data)),
        ("-1", 2**32 - 1),
    ):
        damaged = bytearray(data)
        after = first + 2 + 12 * struct.unpack_from("<H", data, first)[0]
        struct.pack_into("<I", damaged, after, offset)
        yield of_bytes("TIFF directory after the last", name, bytes(damaged))


def _formats() -> Iterator[OddFile]:
    """Every other format that is read: cut short, and with wrong bits."""
    names = ("JPEG", "PNG", "PNG of 16 bit", "PNG with opacity", "GIF", "BMP", "WebP")
    rasters = zip((*names, "JPEG 2000", "PPM", "AVIF", "PGM"), RASTERS, strict=True)
    raws = zip(("raw mosaic", "raw of three planes"), RAWS, strict=True)
    others = zip(("TIFF with a profile", "TIFF of a session"), (TIFFS[0], TIFFS[5]), strict=True)
    for name, data in (*rasters, *raws, *others):
        yield from cut_short(name, name, data, 4)
        yield from with_flipped_bits(name, name, data, 5)


def _bombs() -> Iterator[OddFile]:
    """Little files of much: pixels, pages, directories, scans, frames, text."""
    yield _bomb("a PNG of 900 million pixels", png_of(30_000, 30_000))
    yield _bomb("a PNG of 2^31 columns", png_of(2**31 - 1, 1))
    yield _bomb("a PNG of no columns", png_of(0, 5))
    text = b"zTXt" + b"a\0\0" + zlib.compress(bytes(50_000_000), 9)
    yield of_bytes("a bomb", "a PNG with 50 MB of text", png(GREY_8, (text[:4], text[4:])))
    profile = b"p\0\0" + zlib.compress(bytes(100_000_000), 9)
    yield of_bytes("a bomb", "a PNG with a profile of 100 MB", png(GREY_8, (b"iCCP", profile)))
    for compression in ("zstd", "deflate", "lzw", "lzma"):
        yield _bomb(f"{compression}, 400 million px", _grown(compression, 20_000))
        yield _bomb(f"{compression}, 144 million px", _grown(compression, 12_000))
    yield _bomb("a TIFF of 60 000 x 60 000 px", _grown("none", 60_000))
    for name, data in _endless_heads():
        yield _bomb(name, data)
    small = tiff(GREY_16[:16, :16], compression="deflate")
    yield of_bytes("a bomb", "500 pages", b"".join(_pages(small, 500)))
    frames = [Image.fromarray(GREY_8)] * 300
    buffer = BytesIO()
    frames[0].save(buffer, "GIF", save_all=True, append_images=frames[1:])
    yield of_bytes("a bomb", "300 frames of a GIF", buffer.getvalue())


def _bomb(name: str, data: bytes) -> OddFile:
    return of_bytes("a bomb", name, data, is_refused=True)


@cache
def png_of(cols: int, rows: int) -> bytes:
    """A PNG of black pixels, as far as they go into a megabyte."""
    packed = zlib.compressobj(9)
    line = b"\0" * min(cols + 1, 30_001)
    data = b"".join(packed.compress(line) for _ in range(rows)) + packed.flush()
    head = struct.pack(">IIBBBBB", cols, rows, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(content))
        + name
        + content
        + struct.pack(">I", zlib.crc32(name + content))
        for name, content in ((b"IHDR", head), (b"IDAT", data), (b"IEND", b""))
    )


def _grown(compression: str, side: int) -> bytes:
    """A TIFF of one strip whose directory claims another size than it was written with.

    The strip holds 4 million zeros: what is decoded of it is soon known to be too little.
    """
    data = bytearray(
        tiff(
            np.zeros((2000, 2000), np.uint8),
            compression=None if compression == "none" else compression,
            rowsperstrip=2000,
        )
    )
    with tifffile.TiffFile(BytesIO(bytes(data))) as file:
        tags = file.pages.first.tags
        for name in ("ImageWidth", "ImageLength", "RowsPerStrip"):
            form = {3: "<H", 4: "<I"}[int(tags[name].dtype)]
            struct.pack_into(form, data, tags[name].valueoffset, side)
    return bytes(data)


def _pages(page: bytes, count: int) -> Iterator[bytes]:
    """The bytes of a TIFF whose directory is repeated ``count`` times, of the same pixels."""
    first = struct.unpack_from("<I", page, 4)[0]
    entries = struct.unpack_from("<H", page, first)[0]
    directory = page[first : first + 2 + 12 * entries]
    yield page[:4] + struct.pack("<I", len(page)) + page[8:]
    for index in range(count):
        at = len(page) + index * (len(directory) + 4)
        after = at + len(directory) + 4 if index + 1 < count else 0
        yield directory + struct.pack("<I", after)


def _endless_heads() -> Iterator[tuple[str, bytes]]:
    """Heads that promise more than any file holds."""
    yield "a PPM of 100 000 x 100 000 px", b"P6 100000 100000 255\n" + bytes(99)
    yield "a PGM of 10^30 columns", b"P5 " + b"9" * 30 + b" 1 255\n" + bytes(99)
    yield (
        "a BMP of 2^31 columns",
        b"BM"
        + struct.pack(
            "<IHHIIiiHHIIiiII", 99, 0, 0, 54, 40, 2**31 - 1, 2**31 - 1, 1, 24, 0, 0, 0, 0, 0, 0
        ),
    )
    yield "a JPEG of 65 500 x 65 500 px", _resized_jpeg()
    cards = ("SIMPLE  =                    T", "BITPIX  =                   16")
    sides = ("NAXIS   =                    2", "NAXIS1  =              9999999")
    lines = (*cards, *sides, "NAXIS2  =              9999999", "END")
    yield "a FITS file of 10^14 px", "".join(f"{line:80}" for line in lines).encode().ljust(2880)
    yield "an OpenEXR file without end", b"v/1\x01" + struct.pack("<I", 2) + b"a" * 5000
    yield "a GIF of nothing", b"GIF89a" + struct.pack("<HHBBB", 65535, 65535, 0, 0, 0) + b";"


def _resized_jpeg() -> bytes:
    buffer = BytesIO()
    Image.fromarray(COLOUR).save(buffer, "JPEG")
    data = bytearray(buffer.getvalue())
    struct.pack_into(">HH", data, data.index(b"\xff\xc0") + 5, 65_500, 65_500)
    return bytes(data)


def _no_images() -> Iterator[OddFile]:
    """Other files by the name of an image."""
    contents = {
        "text": b"This is no image.\n" * 99,
        "HTML": b"<!doctype html><html><body><h1>404</h1></body></html>",
        "PDF": b"%PDF-1.7\n%\xe2\xe3\xcf\xd3\n1 0 obj\n<<>>\nendobj\n",
        "PostScript": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\nshowpage\n",
        "SVG": b'<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9"/>',
        "a zip file": b"PK\3\4" + bytes(60),
        "a pickle": b"\x80\4\x95\x10\0\0\0\0\0\0\0\x8c\2os\x94\x8c\6system\x94\x93\x94.",
        "a NumPy array": b"\x93NUMPY\1\0v\0{'descr': '|O', 'fortran_order': False, 'shape': (9,)}",
        "an icon": b"\0\0\1\0\1\0" + bytes(60),
        "a MIFF of ImageMagick": b"id=ImageMagick\nclass=DirectClass\n\f\n:\x1a",
        "a Photoshop file": b"8BPS\0\1" + bytes(20),
        "an HDF5 file": b"\x89HDF\r\n\x1a\n" + bytes(90),
        "zeros": bytes(5000),
        "ones": b"\xff" * 5000,
        "the head of a TIFF": b"II*\0",
        "the head of a BigTIFF": b"II+\0\x08\0\0\0" + b"\xff" * 8,
        "the head of a PNG": b"\x89PNG\r\n\x1a\n",
        "the head of a JPEG": b"\xff\xd8\xff\xe0",
        "the head of a FITS file": b"SIMPLE  =                    T",
        "the head of an OpenEXR file": b"v/1\x01",
    }
    for name, data in contents.items():
        yield of_bytes("no image", name, data, is_refused=True)
