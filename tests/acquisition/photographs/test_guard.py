"""Files that would hang, fill the memory or write on the terminal; read in a process of its own."""

import json
import os
import socket
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import pytest
import tifffile

from acquisition.photographs._decoding import (
    LARGEST_FILE_BYTES,
    GiantImageError,
    is_swollen,
    read_file,
    refuse_giant,
)
from acquisition.photographs._reader import photograph_of, read_photograph
from standoff.errors import ArgumentError, ImageFileError
from tests.acquisition.photographs.made import GREY, directory, grey_tags, pillow, png, tiff

LONGEST_S = 10.0
"""Of processor time: what a machine does beside it is no matter."""

MOST_BYTES = 1 << 30

IN_A_CHILD = """
import json, os, sys, time
from pathlib import Path
from standoff.errors import ImageFileError
from acquisition.photographs import ReadOptions, read_photograph
for path in json.loads(sys.stdin.read()):
    for options in (ReadOptions(), ReadOptions(page=1), ReadOptions(is_mean=True)):
        begun = time.process_time()
        try:
            read_photograph(Path(os.fsdecode(path.encode("latin-1"))), options)
            said = ""
        except ImageFileError as error:
            said = str(error)
        status = Path("/proc/self/status").read_text()  # getrusage counts the parent's memory
        peak = 1024 * int(status.partition("VmHWM:")[2].split()[0])
        print(json.dumps([path, said, time.process_time() - begun, peak]), flush=True)
"""


@dataclass(frozen=True, kw_only=True)
class Reading:
    said: str
    took_s: float
    peak_bytes: int


def read_in_a_child(*paths: Path) -> dict[str, list[Reading]]:
    """What reading each path said, by its name; a hang ends the child."""
    names = [os.fsencode(path).decode("latin-1") for path in paths]
    done = subprocess.run(
        [sys.executable, "-c", IN_A_CHILD],
        input=json.dumps(names),
        capture_output=True,
        text=True,
        timeout=30 * LONGEST_S * len(paths),
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""  # no warning of any library
    readings: dict[str, list[Reading]] = {}
    for line in done.stdout.splitlines():
        path, said, took_s, peak_bytes = json.loads(line)
        reading = Reading(said=said, took_s=took_s, peak_bytes=peak_bytes)
        readings.setdefault(Path(path).name, []).append(reading)
    return readings


def refused_cheaply(*paths: Path) -> None:
    for name, readings in read_in_a_child(*paths).items():
        for reading in readings:
            assert reading.said, name
            assert reading.said.isprintable(), name
            assert reading.took_s < LONGEST_S, name
            assert reading.peak_bytes < MOST_BYTES, name


@pytest.mark.slow
def test_what_is_no_regular_file_is_refused_without_a_wait(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    (tmp_path / "loop.png").symlink_to("loop.png")
    (tmp_path / "to-a-device.png").symlink_to("/dev/zero")
    (tmp_path / "folder.png").mkdir()
    with (tmp_path / "giant.tif").open("wb") as file:
        file.truncate(20 << 30)
    listening = socket.socket(socket.AF_UNIX)
    listening.bind(str(tmp_path / "socket.png"))
    missing = tmp_path / "missing.png"
    refused_cheaply(Path("/dev/zero"), Path("/dev/tty"), missing, *tmp_path.iterdir())
    listening.close()


@pytest.mark.parametrize(
    ("make", "noun"),
    [
        (lambda path: os.mkfifo(path), "pipe"),
        (lambda path: path.mkdir(), "folder"),
        (lambda path: path.symlink_to("/dev/null"), "device"),
    ],
)
def test_what_it_is_instead_is_said(
    tmp_path: Path, make: Callable[[Path], None], noun: str
) -> None:
    make(tmp_path / "a.png")
    with pytest.raises(ImageFileError) as refused:
        read_file(tmp_path / "a.png")
    assert noun in str(refused.value)


def test_a_name_with_a_zero_byte_is_no_name() -> None:
    with pytest.raises(ImageFileError):
        read_file(Path("a\0b.png"))


def zeros(compression: str, side: int = 30_000, *, pages: int = 1) -> bytes:
    """A TIFF whose strips are all the same few bytes."""
    rows = 1000
    content = bytes(rows * side)
    is_zstd = compression == "zstd"
    number = 50000 if is_zstd else 8
    strip = bytes(imagecodecs.zstd_encode(content)) if is_zstd else zlib.compress(content)
    count = side // rows
    packed = (
        struct.pack(f"<{count}I", *[8] * count),
        struct.pack(f"<{count}I", *[len(strip)] * count),
    )
    tags = [tag for tag in grey_tags(side, side, 8) if tag[0] not in (259, 273, 278, 279)]
    tags += [(259, 3, 1, struct.pack("<H", number)), (278, 4, 1, struct.pack("<I", rows))]
    tags += [(273, 4, count, packed[0]), (279, 4, count, packed[1])]
    data = b"II*\0" + struct.pack("<I", 8 + len(strip)) + strip
    at = len(data)
    for _ in range(pages - 1):
        size = len(directory(tags, at))
        data += directory(tags, at, at + size)
        at += size
    return data + directory(tags, at)


def png_of_zeros(rows: int, cols: int, colours: int) -> bytes:
    """An 8-bit PNG, compressed row by row."""
    packer = zlib.compressobj(9)
    row = bytes(1 + cols * (3 if colours == 2 else 1))
    lines = b"".join(packer.compress(row) for _ in range(rows)) + packer.flush()
    head = struct.pack(">IIBBBBB", cols, rows, 8, colours, 0, 0, 0)
    made = png(GREY)
    chunks = b"".join(
        struct.pack(">I", len(content)) + name + content
        + struct.pack(">I", zlib.crc32(name + content))
        for name, content in ((b"IHDR", head), (b"IDAT", lines), (b"IEND", b""))
    )  # fmt: skip
    return made[:8] + chunks


def tile_of_zeros() -> bytes:
    """Ten by ten pixels in a tile of 20,000 by 20,000."""
    tile = imagecodecs.zstd_encode(bytes(20_000 * 20_000))
    tags = [tag for tag in grey_tags(10, 10, 8) if tag[0] not in (259, 273, 278, 279)]
    longs = {259: 50000, 322: 20_000, 323: 20_000, 324: 8, 325: len(tile)}
    tags += [(number, 4, 1, struct.pack("<I", value)) for number, value in longs.items()]
    data = b"II*\0" + struct.pack("<I", 8 + len(tile)) + tile
    return data + directory(tags, len(data))


def jpeg_of_nothing(side: int) -> bytes:
    """A JPEG that says it is huge and ends after its header."""
    made = bytearray(pillow(GREY, "JPEG"))
    at = made.index(b"\xff\xc0") + 5
    made[at : at + 4] = struct.pack(">HH", side, side)
    return bytes(made)


def jpeg_of_nothing_in_a_tiff() -> bytes:
    huge = jpeg_of_nothing(60_000)
    tags = [tag for tag in grey_tags(40, 52, 8, size=len(huge)) if tag[0] != 259]
    tags.append((259, 3, 1, struct.pack("<H", 7)))
    data = b"II*\0" + struct.pack("<I", 8 + len(huge)) + huge
    return data + directory(tags, len(data))


@pytest.mark.slow
def test_bombs_of_a_megabyte_take_no_time_and_no_memory(tmp_path: Path) -> None:
    bombs = {
        "zstd.tif": zeros("zstd"),
        "deflate.tif": zeros("deflate", 12_000),
        "small-pages.tif": zeros("zstd", 4000, pages=3000),
        "tile.tif": tile_of_zeros(),
        "grey.png": png_of_zeros(30_000, 30_000, 0),
        "colour.png": png_of_zeros(8_000, 12_000, 2),
        "huge.jpg": jpeg_of_nothing(65_000),
        "large.jpg": jpeg_of_nothing(11_000),
        "huge-in-a-tiff.tif": jpeg_of_nothing_in_a_tiff(),
    }
    for name, data in bombs.items():
        assert len(data) <= 1 << 20, name
        (tmp_path / name).write_bytes(data)
    readings = read_in_a_child(*(tmp_path / name for name in bombs))
    for name, found in readings.items():
        for reading in found:
            # A single page of 16 million pixels is a photograph.
            assert reading.said or name == "small-pages.tif", name
            assert reading.said.isprintable() or not reading.said
            assert reading.took_s < LONGEST_S, name
            assert reading.peak_bytes < MOST_BYTES, name
    one, _, mean = readings["small-pages.tif"]
    assert "3000 pages" in one.said
    assert "3000 pages" in mean.said


def test_a_jpeg_of_a_thousand_scans_is_refused_and_one_of_a_camera_read(tmp_path: Path) -> None:
    # Each repeats the last refinement of all coefficients: half a minute of 140 kB once.
    sound = pillow(GREY, "JPEG", progressive=True)
    last = sound.rindex(b"\xff\xda")
    endless = sound[:-2] + 1000 * sound[last:-2] + sound[-2:]
    path = tmp_path / "a.jpg"
    path.write_bytes(sound)
    assert read_photograph(path).is_jpeg
    path.write_bytes(endless)
    with pytest.raises(ImageFileError) as refused:
        read_photograph(path)
    assert "scans" in str(refused.value)


def test_what_follows_a_jpeg_is_none_of_its_scans(tmp_path: Path) -> None:
    path = tmp_path / "with-a-film.jpg"
    path.write_bytes(pillow(GREY, "JPEG") + 1000 * b"\xff\xda\0\2")
    assert read_photograph(path).is_jpeg


@pytest.mark.slow
def test_thousands_of_pages_are_counted_quickly(tmp_path: Path) -> None:
    buffer = BytesIO()
    with tifffile.TiffWriter(buffer) as writer:
        for _ in range(2000):
            writer.write(GREY[:4, :4], metadata=None)
    path = tmp_path / "many.tif"
    path.write_bytes(buffer.getvalue())
    one, _, mean = read_in_a_child(path)["many.tif"]
    assert "2000 pages" in one.said
    assert mean.said == ""
    assert max(one.took_s, mean.took_s) < LONGEST_S


@pytest.mark.parametrize(
    "pixels",
    [
        np.full((9, 9), 1e300),
        np.full((9, 9), 3e38, np.float32),
        np.full((9, 9), -3e38, np.float32),
        np.full((9, 9), np.nan),
        np.full((9, 9), np.inf, np.float32),
        np.full((9, 9), -np.inf, np.float16),
        np.ones((9, 9), np.complex64),
        np.ones((9, 9, 5), np.uint8),
    ],
)
def test_levels_that_nobody_can_calculate_with_are_refused(
    tmp_path: Path, pixels: np.ndarray[Any, Any]
) -> None:
    path = tmp_path / "a.tif"
    options = {"planarconfig": "contig"} if pixels.ndim == 3 else {}
    path.write_bytes(tiff(pixels, photometric="minisblack", **options))
    with pytest.raises(ImageFileError) as refused:
        read_photograph(path)
    assert str(refused.value).isprintable()
    with pytest.raises((ImageFileError, ArgumentError)):
        photograph_of(pixels, "array")


@pytest.mark.slow
def test_one_odd_pixel_of_a_page_refuses_the_mean(tmp_path: Path) -> None:
    stack = np.ones((3, 9, 9), np.float32)
    stack[1, 4, 4] = np.inf
    path = tmp_path / "a.tif"
    path.write_bytes(tiff(stack, photometric="minisblack"))
    _, first, mean = read_in_a_child(path)["a.tif"]
    assert first.said == ""
    assert "infinite" in mean.said


NAMES = ["a\nb.png", "\x1b[31mred.png", "a\rb.png", b"\xff\xfe.png", "\u202eabc.png", " .png"]


@pytest.mark.parametrize("name", NAMES, ids=repr)
def test_odd_names_are_escaped_in_messages_and_their_images_read(
    tmp_path: Path, name: str | bytes
) -> None:
    path = tmp_path / os.fsdecode(name)
    path.write_bytes(png(GREY))
    found = read_photograph(path)
    np.testing.assert_array_equal(found.stored, GREY)
    assert found.name.isprintable()
    giant = bytearray(png(GREY))
    giant[16:24] = b"\x7f\xff\xff\xff" * 2
    for data in (b"hello", bytes(giant), b"II*\0", tiff(np.full((9, 9), np.nan))):
        path.write_bytes(data)
        with pytest.raises(ImageFileError) as refused:
            read_photograph(path)
        assert str(refused.value).isprintable()
    path.unlink()
    with pytest.raises(ImageFileError) as refused:
        read_photograph(path)
    assert str(refused.value).isprintable()


def test_a_giant_is_one_by_its_pixels_or_by_its_compression() -> None:
    refuse_giant((10_000, 15_000), 1, 10_000_000)
    refuse_giant((4000, 8000), 1, 10)  # decodes to little
    with pytest.raises(GiantImageError):
        refuse_giant((10_001, 15_000), 1, 1 << 30)
    with pytest.raises(GiantImageError):
        refuse_giant((10_000, 10_000, 3), 2, 1 << 20)
    assert is_swollen(201 << 20, 1 << 20)
    assert not is_swollen(199 << 20, 1 << 20)


def test_a_file_of_the_largest_size_is_looked_into(tmp_path: Path) -> None:
    path = tmp_path / "sparse.tif"
    with path.open("wb") as file:
        file.truncate(LARGEST_FILE_BYTES + 1)
    with pytest.raises(ImageFileError):
        read_file(path)
