"""Image files of every format, read as a photograph with all that can be asked of one."""

from collections.abc import Iterator
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from acquisition.photographs import ReadOptions, read_photograph
from acquisition.photographs._encoding import ProfileError, read_profile
from calibration.errors import CalibrationError
from standoff.errors import ImageFileError
from standoff.library import Reading, edge_image
from tests.acquisition.photographs.made import (
    DISPLAY_P3,
    GREY_16,
    Dng,
    curve_of,
    icc_chunk,
    pillow,
    png,
    profile,
    tiff,
)
from tests.acquisition.photographs.test_scientific import exr, fits
from tests.acquisition.photographs.test_stored_image import made_tiff, pillow_tags
from tests.fuzz.damage import damaged_bytes
from tests.fuzz.target import FuzzTarget, from_file

RNG = np.random.default_rng(2)
GREY = RNG.integers(0, 256, (12, 16)).astype(np.uint8)
COLOUR = RNG.integers(0, 256, (12, 16, 3)).astype(np.uint8)
STACK = RNG.integers(0, 65536, (3, 12, 16)).astype(np.uint16)
THREE_CURVES = profile(curve_of(256), curve_of(461), curve_of(0, 9000, 65535))

TIFFS = (
    tiff(GREY, iccprofile=THREE_CURVES),
    tiff(COLOUR, photometric="rgb", compression="lzw", predictor=True, iccprofile=DISPLAY_P3),
    tiff(COLOUR, photometric="rgb", compression="jpeg"),
    tiff(STACK[0], tile=(16, 16), compression="zstd", bigtiff=True),
    tiff(STACK, photometric="minisblack", compression="deflate", byteorder=">"),
    tiff(STACK, imagej=True, truncate=True),
    tiff(GREY > 99, photometric="miniswhite"),
    made_tiff(),
)
RASTERS = (
    pillow(COLOUR, "JPEG", icc_profile=THREE_CURVES, exif=pillow_tags()),
    png(COLOUR, icc_chunk(DISPLAY_P3)),
    png(STACK[0], (b"gAMA", (55556).to_bytes(4, "big")), (b"cICP", b"\1\15\0\1")),
    png(np.dstack([STACK[0]] * 4)),
    pillow(GREY, "GIF", save_all=True, append_images=[]),
    *(pillow(COLOUR, kind) for kind in ("BMP", "WEBP", "JPEG2000", "PPM", "AVIF")),
    b"P5 # made\n16 12\n4095\n" + (STACK[0] >> 4).astype(">u2").tobytes(),
)
RAWS = (
    Dng(levels=STACK[0] >> 4, black=(1, 2, 3, 4), black_repeat=(2, 2)).to_bytes(),
    Dng(levels=np.stack(list(STACK >> 4), axis=2).astype(np.uint16), black=(1, 2, 3)).to_bytes(),
)


def use_photograph(path: Path) -> None:
    """Read, and ask for all that a command asks for."""
    for options in (ReadOptions(), ReadOptions(page=1), ReadOptions(is_mean=True)):
        with suppress(ImageFileError):
            found = read_photograph(path, options)
            assert np.isfinite(found.grey_dn).all()
            assert all(str(fact).isprintable() for fact in found.facts.to_json().values())
            assert found.encoding_from.isprintable()
        with suppress(ImageFileError, CalibrationError):
            read = read_photograph(path, options)
            source = edge_image(read, Reading(pattern=read.pattern))
            assert source.clipped is None or source.clipped.shape == source.image_dn.shape


def photograph_target(kind: str, samples: tuple[bytes, ...], name: str) -> FuzzTarget:
    read = from_file(use_photograph, name)
    return FuzzTarget(kind, damaged_bytes(samples), read, (ImageFileError,), 150)


def targets() -> Iterator[FuzzTarget]:
    yield photograph_target("photograph as a TIFF", TIFFS, "photograph.dat")
    yield photograph_target("photograph as PNG, JPEG and others", RASTERS, "photograph.dat")
    if find_spec("rawpy") is not None:
        yield photograph_target("camera raw file", RAWS, "photograph.dng")
    if find_spec("OpenEXR") is not None:
        with TemporaryDirectory() as folder:
            light = COLOUR.astype(np.float32)
            samples = (
                exr(Path(folder), {"RGB": light}),
                exr(Path(folder), {"Y": light[:, :, 0].astype(np.float16)}),
            )
        yield photograph_target("OpenEXR file", samples, "photograph.exr")
    if find_spec("astropy") is not None:
        yield photograph_target("FITS file", (fits(GREY_16[:9]), fits(STACK)), "photograph.fits")
    profiles = damaged_bytes((DISPLAY_P3, THREE_CURVES))
    yield FuzzTarget("colour profile", profiles, read_profile, (ProfileError,), 200)


PHOTOGRAPH_TARGETS = tuple(targets())
