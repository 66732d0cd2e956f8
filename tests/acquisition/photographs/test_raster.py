"""PNGs chunk by chunk, and what Pillow and OpenCV write; the PNG specification's order counts."""

import struct
from io import BytesIO
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from PIL import Image, ImageFile

from acquisition.photographs._decoding import DecodingError
from acquisition.photographs._encoding import SRGB
from acquisition.photographs._raster import read_raster_image
from acquisition.photographs._reader import ReadOptions
from standoff.errors import ImageFileError
from tests.acquisition.photographs.made import (
    COLOUR,
    COLOUR_16,
    DISPLAY_P3,
    GREY,
    GREY_16,
    Pixels,
    curve_of,
    icc_chunk,
    pillow,
    png,
    profile,
    read,
)

ADOBE = profile(curve_of(563), name="Adobe RGB (1998)")
CICP_SRGB, CICP_LINEAR = ((b"cICP", bytes((1, number, 0, 1))) for number in (13, 8))
SRGB_CHUNK = (b"sRGB", b"\0")


def gama(value: int) -> tuple[bytes, bytes]:
    return b"gAMA", struct.pack(">I", value)


def exif_srgb() -> Image.Exif:
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA001] = 1
    return exif


EXIF_CHUNK = (b"eXIf", exif_srgb().tobytes()[6:])


def refusal(folder: Path, data: bytes, name: str = "image.png") -> str:
    with pytest.raises(ImageFileError) as refused:
        read(folder, data, name=name)
    text = str(refused.value)
    assert text.isprintable()
    return text


@pytest.mark.parametrize("pixels", [GREY, COLOUR, GREY_16, COLOUR_16])
def test_a_png_without_a_mark_is_srgb_of_8_bits_and_linear_of_16(
    tmp_path: Path, pixels: Pixels
) -> None:
    found = read(tmp_path, png(pixels))
    np.testing.assert_array_equal(found.stored, pixels)
    white = np.iinfo(pixels.dtype).max
    assert found.full_scale_dn == white
    assert found.encoding.name == ("srgb" if white == 255 else "linear")


@pytest.mark.parametrize("kind", ["JPEG", "WEBP", "BMP", "JPEG2000", "PPM", "GIF"])
def test_other_formats_of_8_bits_without_a_mark_are_srgb(tmp_path: Path, kind: str) -> None:
    found = read(tmp_path, pillow(COLOUR, kind))
    assert found.encoding.name == "srgb"
    assert found.stored.shape == COLOUR.shape
    assert found.is_jpeg == (kind == "JPEG")


@pytest.mark.parametrize("kind", ["WEBP", "BMP", "PPM", "JPEG2000"])
def test_formats_without_loss_give_the_pixels(tmp_path: Path, kind: str) -> None:
    options: dict[str, Any] = {"lossless": True} if kind == "WEBP" else {}
    np.testing.assert_array_equal(read(tmp_path, pillow(COLOUR, kind, **options)).stored, COLOUR)


@pytest.mark.parametrize("channels", [2, 4])
@pytest.mark.parametrize("pixels", [COLOUR, COLOUR_16])
def test_the_opacity_of_a_png_is_left_out_at_full_depth(
    tmp_path: Path, pixels: Pixels, channels: int
) -> None:
    opacity = pixels[:, :, :1]
    colours = pixels[:, :, : channels - 1]
    found = read(tmp_path, png(np.concatenate([colours, opacity], axis=2)))
    assert found.stored.dtype == pixels.dtype
    seen = found.stored if found.stored.ndim == 3 else found.stored[:, :, np.newaxis]
    np.testing.assert_array_equal(seen, np.broadcast_to(colours, seen.shape))


@pytest.mark.parametrize("white", [1023, 4095, 65535])
@pytest.mark.parametrize("colours", [1, 3])
def test_a_pgm_of_more_than_8_bits_keeps_its_levels_and_their_white(
    tmp_path: Path, white: int, colours: int
) -> None:
    pixels = np.squeeze(COLOUR_16[:, :, :colours] // ((65535 // white) + (white < 65535)))
    magic = "P5" if colours == 1 else "P6"
    head = f"{magic} # made\n52 40\n{white}\n".encode()
    found = read(tmp_path, head + pixels.astype(">u2").tobytes())
    np.testing.assert_array_equal(found.stored, pixels)
    assert found.stored.dtype == np.uint16
    assert found.full_scale_dn == white


@pytest.mark.parametrize("pixels", [GREY, GREY_16], ids=["8 bits", "16 bits"])
@pytest.mark.parametrize(
    ("chunks", "name"),
    [
        ([gama(45455)], "srgb"),  # 1/2.2, as all write who mean sRGB
        ([gama(100_000)], "linear"),
        ([gama(55556)], "gamma:1.8"),
        ([gama(40_000)], "gamma:2.5"),
        ([SRGB_CHUNK], "srgb"),
        ([CICP_SRGB], "srgb"),
        ([CICP_LINEAR], "linear"),
        ([(b"cICP", bytes((1, 4, 0, 1)))], "gamma:2.2"),  # ITU-T H.273, table 3
        ([icc_chunk(profile(curve_of(563), space=b"GRAY"))], "gamma:2.199"),
        ([EXIF_CHUNK], "srgb"),
        # Each counts before those after it: PNG, third edition, 4.3.
        ([EXIF_CHUNK, gama(55556)], "gamma:1.8"),
        ([gama(55556), SRGB_CHUNK], "srgb"),
        ([SRGB_CHUNK, icc_chunk(profile(curve_of(563), space=b"GRAY"))], "gamma:2.199"),
        ([icc_chunk(profile(curve_of(563), space=b"GRAY")), CICP_LINEAR], "linear"),
        # Two that say nothing.
        ([(b"cICP", bytes((1, 2, 0, 1))), gama(55556)], "gamma:1.8"),
        ([gama(0), SRGB_CHUNK], "srgb"),
    ],
)
def test_the_chunks_of_a_png_say_its_encoding(
    tmp_path: Path, pixels: Pixels, chunks: list[tuple[bytes, bytes]], name: str
) -> None:
    found = read(tmp_path, png(pixels, *chunks))
    assert found.encoding.name == name
    np.testing.assert_array_equal(found.stored, pixels)


def test_a_gamma_of_nothing_is_no_mark(tmp_path: Path) -> None:
    assert read(tmp_path, png(GREY, gama(0))).encoding_from.startswith("usual")


@pytest.mark.parametrize("transfer", [1, 16, 18])
def test_a_transfer_that_is_not_read_is_refused_and_an_encoding_wins(
    tmp_path: Path, transfer: int
) -> None:
    data = png(GREY, (b"cICP", bytes((9, transfer, 0, 1))))
    assert "--encoding" in refusal(tmp_path, data)
    assert read(tmp_path, data, ReadOptions(encoding=SRGB)).encoding == SRGB


def test_a_jpeg_is_read_by_its_profile_then_by_its_exif(tmp_path: Path) -> None:
    both = read(tmp_path, pillow(COLOUR, "JPEG", icc_profile=ADOBE, exif=exif_srgb()))
    assert both.encoding.name == "gamma:2.199"
    assert both.encoding_from.endswith("Adobe RGB (1998)")
    assert read(tmp_path, pillow(COLOUR, "JPEG", exif=exif_srgb())).encoding_from == "its Exif"
    phone = read(tmp_path, pillow(COLOUR, "JPEG", icc_profile=DISPLAY_P3))
    assert phone.encoding.name == "srgb"


def test_an_encoding_that_is_given_wins_over_a_damaged_profile(tmp_path: Path) -> None:
    data = pillow(COLOUR, "JPEG", icc_profile=ADOBE[:150])
    assert "--encoding" in refusal(tmp_path, data)
    found = read(tmp_path, data, ReadOptions(encoding=SRGB))
    assert (found.encoding, found.encoding_from) == (SRGB, "--encoding")


def test_a_phones_jpeg_with_a_depth_map_is_one_photograph(tmp_path: Path) -> None:
    depth = Image.fromarray(GREY)
    data = pillow(Image.fromarray(COLOUR), "MPO", save_all=True, append_images=[depth])
    found = read(tmp_path, data, name="phone.jpg")
    assert found.stored.shape == COLOUR.shape
    assert found.is_jpeg
    assert found.encoding_from == "usual for JPEG without a mark"


@pytest.mark.parametrize("kind", ["GIF", "PNG", "WEBP"])
def test_several_frames_are_a_stack(tmp_path: Path, kind: str) -> None:
    levels = (10, 100, 220)
    frames = [Image.new("L", (20, 12), level) for level in levels]
    options: dict[str, Any] = {"lossless": True} if kind == "WEBP" else {}
    data = pillow(frames[0], kind, save_all=True, append_images=frames[1:], **options)
    assert "3 pages" in refusal(tmp_path, data)
    # Out of order, too: a frame may build upon the one before.
    image = read_raster_image(data)
    assert [image.page(i).mean() for i in (2, 0, 1)] == [220, 10, 100]
    found = read(tmp_path, data, ReadOptions(is_mean=True))
    light = [255 * ((level / 255 + 0.055) / 1.055) ** 2.4 for level in levels[1:]]
    # 10 lies on the straight segment.
    assert found.grey_dn.mean() == pytest.approx((10 / 12.92 + sum(light)) / 3, rel=1e-9)


@pytest.mark.parametrize(
    ("data", "noun"),
    [
        (b"", "empty"),
        (b"hello", "not an image"),
        (b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", "PostScript"),
        (b"%PDF-1.7\n", "PDF"),
        (b"\0\0\0\x18ftypheic\0\0\0\0mif1heic", "HEIC"),
        (b"\0\0\0\x18ftypmif1\0\0\0\0mif1heic", "HEIC"),
        (b"<svg xmlns='http://www.w3.org/2000/svg'/>", "not an image"),
    ],
)
def test_what_is_no_photograph_is_refused_under_any_name(
    tmp_path: Path, data: bytes, noun: str
) -> None:
    for name in ("a.png", "a.jpg", "a.tif", "a.eps"):
        assert noun in refusal(tmp_path, data, name)


def test_cmyk_is_refused(tmp_path: Path) -> None:
    assert "CMYK" in refusal(tmp_path, pillow(Image.new("CMYK", (9, 8)), "JPEG"))


def test_a_name_does_not_decide_the_format(tmp_path: Path) -> None:
    np.testing.assert_array_equal(read(tmp_path, png(GREY), name="a.jpg").stored, GREY)


@pytest.mark.parametrize("pixels", [GREY_16, COLOUR_16])
@pytest.mark.parametrize("bits", [12, 16])
@pytest.mark.parametrize("container", ["jp2", "j2k"])
def test_more_than_8_bits_of_jpeg_2000_are_kept(
    tmp_path: Path, pixels: Pixels, bits: int, container: str
) -> None:
    levels = pixels >> (16 - bits)
    coded = imagecodecs.jpeg2k_encode(
        levels, level=0, reversible=True, bitspersample=bits, codecformat=container
    )
    found = read(tmp_path, bytes(coded))
    np.testing.assert_array_equal(found.stored, levels)
    assert found.full_scale_dn == 2**bits - 1
    assert found.encoding.name == "linear"


def test_a_giant_within_a_small_container_is_refused(tmp_path: Path) -> None:
    data = bytearray(imagecodecs.jpeg2k_encode(GREY_16, codecformat="jp2"))
    at = data.index(b"\xff\x4f\xff\x51") + 8
    data[at : at + 8] = struct.pack(">II", 60_000, 60_000)
    refusal(tmp_path, bytes(data))


SAMPLES = {
    "png": (png(COLOUR), COLOUR),
    "png16": (png(COLOUR_16, SRGB_CHUNK), COLOUR_16),
    "webp": (pillow(COLOUR, "WEBP", lossless=True), COLOUR),
    "bmp": (pillow(COLOUR, "BMP"), COLOUR),
    "ppm": (b"P5\n52 40\n65535\n" + GREY_16.astype(">u2").tobytes(), GREY_16),
    "jpeg": (pillow(COLOUR, "JPEG"), np.asarray(Image.open(BytesIO(pillow(COLOUR, "JPEG"))))),
}


@pytest.mark.parametrize("kind", SAMPLES)
@given(data=st.data())
def test_a_file_that_is_cut_is_refused_or_whole(kind: str, data: st.DataObject) -> None:
    sample, pixels = SAMPLES[kind]
    try:
        image = read_raster_image(sample[: data.draw(st.integers(0, len(sample)))])
        found = image.page(0)
    except DecodingError:
        return
    np.testing.assert_array_equal(found, pixels)


@pytest.mark.parametrize("kind", ["png", "bmp", "jpeg"])
def test_what_another_library_allows_pillow_is_not_allowed_here(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ImageFile, "LOAD_TRUNCATED_IMAGES", True)
    sample, _ = SAMPLES[kind]
    with pytest.raises(DecodingError, match="not a complete image"):
        read_raster_image(sample[: len(sample) // 2]).page(0)
    assert ImageFile.LOAD_TRUNCATED_IMAGES


@given(at=st.integers(0, 200), bits=st.integers(1, 255), kind=st.sampled_from(sorted(SAMPLES)))
@example(at=24, bits=16, kind="png")
def test_flipped_bits_give_an_image_or_the_one_error(at: int, bits: int, kind: str) -> None:
    damaged = bytearray(SAMPLES[kind][0])
    damaged[at] ^= bits
    try:
        image = read_raster_image(bytes(damaged))
        image.marked()
        image.page(0)
    except DecodingError:
        pass
