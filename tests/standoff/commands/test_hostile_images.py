"""Files that nobody would photograph: every command refuses each in one line, with status 1."""

import os
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from analysis.detectability._curves import DetectabilityCurves
from analysis.results_file import write_results
from tests.analysis.detectability.test_curves import curve
from tests.standoff.conftest import Command

GIGANTIC = 20 << 30


def pipe(path: Path) -> None:
    os.mkfifo(path)


def loop(path: Path) -> None:
    path.symlink_to(path.name)


def giant(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(GIGANTIC)


@cache
def bomb_bytes() -> bytes:
    """A PNG of 900 million black pixels, deflated to less than 1 MB."""
    row = b"\0" * 30_001
    packed = zlib.compressobj(9)
    data = b"".join(packed.compress(row) for _ in range(30_000)) + packed.flush()
    header = (30_000).to_bytes(4, "big") * 2 + bytes((8, 0, 0, 0, 0))
    chunks = ((b"IHDR", header), (b"IDAT", data), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        len(content).to_bytes(4, "big")
        + name
        + content
        + zlib.crc32(name + content).to_bytes(4, "big")
        for name, content in chunks
    )


def of_levels(level: float, kind: type[np.floating]) -> Callable[[Path], object]:
    return lambda path: tifffile.imwrite(path, np.full((64, 64), level, kind))


def of_mode(mode: str) -> Callable[[Path], None]:
    return lambda path: Image.new("RGB", (64, 64), (9, 99, 199)).convert(mode).save(path, "TIFF")


FILES: dict[str, Callable[[Path], object]] = {
    "pipe": pipe,
    "loop": loop,
    "20-gib": giant,
    "bomb": lambda path: path.write_bytes(bomb_bytes()),
    "1e300": of_levels(1e300, np.float64),
    "3e38": of_levels(3e38, np.float32),
    "nan": of_levels(np.nan, np.float64),
    "cmyk": of_mode("CMYK"),
    "lab": of_mode("LAB"),
    "eps": lambda path: path.write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n"),
    "folder": Path.mkdir,
    "empty": Path.touch,
    "stack": lambda path: tifffile.imwrite(
        path, np.zeros((3, 64, 64), np.uint16), photometric="minisblack"
    ),
}

COMMANDS: dict[str, tuple[str | float, ...]] = {
    "calibrate": ("calibrate", "BAD", "--out", "OUT.json"),
    "two-distance": ("calibrate", "GOOD", "BAD", "--method", "two-distance", "--out", "OUT.json"),
    "import": ("import", "BAD", "--kind", "edge", "--height-mm", 9, "--out", "OUT"),
    "simulate": ("simulate", "BAD", "--zoom", 2, "--psf", "PSF", "--out", "OUT.tif"),
    "detectability": (
        "detectability",
        "BAD",
        "--psf",
        "PSF",
        "--zooms",
        "1.25",
        "--out",
        "OUT.json",
    ),
    "changes": ("changes", "GOOD", "BAD", "--psf", "PSF", "--out", "OUT"),
    "changes-reference": ("changes", "BAD", "GOOD", "--psf", "PSF", "--out", "OUT"),
    "pose": ("pose", "GOOD", "BAD", "--curves", "CURVES", "--min-dprime", 2),
    "pose-reference": ("pose", "BAD", "GOOD", "--curves", "CURVES", "--min-dprime", 2),
    "signal": ("detectability", "GOOD", "--signal", "BAD", "--psf", "PSF", "--out", "OUT.json"),
    "change-pairs": ("change-pairs", "BAD", "--psf", "PSF", "--crop", 48, "--out", "OUT"),
    "sr-pairs": ("sr-pairs", "BAD", "--psf", "PSF", "--zoom", 2, "--crop", 32, "--out", "OUT"),
}


def command_line(name: str, words: dict[str, object], folder: Path) -> list[object]:
    """The arguments of a command, with files in the place of the words in capitals."""
    curves = folder / "curves.json"
    write_results(curves, DetectabilityCurves(curves=[curve()]))
    words = {**words, "CURVES": curves}
    return [
        folder / str(word) if str(word).startswith("OUT") else words.get(str(word), word)
        for word in COMMANDS[name]
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("kind", FILES)
def test_a_hostile_file_is_one_line_for_every_command(
    command: Command, image_file: Path, psf_file: Path, tmp_path: Path, kind: str, name: str
) -> None:
    bad = tmp_path / f"{kind}.tif"
    FILES[kind](bad)
    words: dict[str, object] = {"BAD": bad, "GOOD": image_file, "PSF": psf_file}
    done = command(*command_line(name, words, tmp_path))
    assert (done.status, done.err.count("\n")) == (1, 1), done.err
    assert bad.name in done.err


@pytest.mark.parametrize("name", COMMANDS)
def test_an_endless_device_is_one_line_for_every_command(
    command: Command, image_file: Path, psf_file: Path, tmp_path: Path, name: str
) -> None:
    words: dict[str, object] = {"BAD": "/dev/zero", "GOOD": image_file, "PSF": psf_file}
    done = command(*command_line(name, words, tmp_path))
    assert (done.status, done.err.count("\n")) == (1, 1), done.err
    assert "/dev/zero" in done.err


def test_a_good_image_of_a_name_that_a_terminal_obeys_is_read_and_shown_on_one_line(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    named = tmp_path / "edge\n\x1b[2J\udc80.tif"
    edge_file.rename(named)
    report, csv = tmp_path / "r.html", tmp_path / "e.csv"
    done = command.done(
        "calibrate", named, "--out", tmp_path / "p.json", "--report", report, "--csv", csv
    )
    assert "\x1b" not in done.out + done.err
    assert "edge\\n\\x1b[2J\\udc80.tif" in done.err
    assert "edge\\n\\x1b[2J\\udc80.tif" in report.read_text("utf-8")
    assert "\x1b" not in csv.read_text("utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["simulate", "detectability", "import", "sr-pairs"])
def test_every_command_reads_a_good_image_of_such_a_name(
    command: Command, psf_file: Path, tmp_path: Path, name: str
) -> None:
    named = tmp_path / "scene\n\x1b[2J\udc80.tif"
    scene = np.random.default_rng(1).integers(0, 4000, (256, 256)).astype(np.uint16)
    tifffile.imwrite(named, scene)
    words: dict[str, object] = {"BAD": named, "PSF": psf_file}
    done = command.done(*command_line(name, words, tmp_path))
    assert "scene\\n\\x1b[2J\\udc80.tif" in done.err
    assert "\x1b" not in done.out + done.err
