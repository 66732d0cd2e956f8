"""TIFFs by tifffile and byte by byte, in every layout a microscope or a scanner writes."""

import struct
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import pytest
import tifffile
from hypothesis import example, given, strategies as st
from PIL import Image

from acquisition.photographs._decoding import DecodingError
from acquisition.photographs._encoding import SRGB, Encoding
from acquisition.photographs._reader import ReadOptions
from acquisition.photographs._tiff import read_tiff_image
from acquisition.session._capture_files import CaptureImages
from standoff.errors import ImageFileError
from tests.acquisition.photographs.made import (
    COLOUR,
    COLOUR_16,
    DISPLAY_P3,
    GREY,
    GREY_16,
    curve_of,
    directory,
    grey_tags,
    long_tag,
    pillow,
    profile,
    read,
    short_tag,
    tiff,
)
from tests.acquisition.records import RECORD, capture_bytes

STACK = np.random.default_rng(5).integers(0, 65536, (5, 30, 40)).astype(np.uint16)
MEAN = ReadOptions(is_mean=True)


def refusal(folder: Path, data: bytes, options: ReadOptions | None = None) -> str:
    with pytest.raises(ImageFileError) as refused:
        read(folder, data, options)
    text = str(refused.value)
    assert text.isprintable()
    return text


@pytest.mark.parametrize(
    "options",
    [
        *({"compression": name} for name in (None, "lzw", "deflate", "zstd", "packbits", "lzma")),
        {"compression": "lzw", "predictor": True},
        {"compression": "deflate", "predictor": True, "tile": (16, 16)},
        {"tile": (32, 16)},
        {"bigtiff": True},
        {"byteorder": ">"},
        {"byteorder": ">", "bigtiff": True, "compression": "lzw"},
        {"rowsperstrip": 7},
    ],
    ids=str,
)
@pytest.mark.parametrize("pixels", [GREY, GREY_16, COLOUR, COLOUR_16, GREY_16.astype(np.float32)])
def test_every_layout_without_loss_gives_the_pixels(
    tmp_path: Path, pixels: np.ndarray[Any, Any], options: dict[str, Any]
) -> None:
    found = read(tmp_path, tiff(pixels, **options))
    np.testing.assert_array_equal(found.stored, pixels)
    assert found.stored.dtype == pixels.dtype
    assert found.stored.dtype.isnative
    assert (found.encoding.name, found.is_jpeg) == ("linear", False)
    assert found.full_scale_dn == (None if pixels.dtype.kind == "f" else np.iinfo(pixels.dtype).max)


@pytest.mark.parametrize("mode", ["RGB", "YCbCr"])
def test_jpeg_within_a_tiff_is_near_and_said(tmp_path: Path, mode: str) -> None:
    ramp = np.add.outer(np.arange(64), np.arange(80)).astype(np.uint8)
    smooth = np.dstack([ramp, 255 - ramp, ramp // 2])
    options = {"compression": "jpeg", "compressionargs": {"level": 95}}
    stored = np.asarray(Image.fromarray(smooth).convert(mode))
    found = read(tmp_path, tiff(stored, photometric=mode.lower(), **options))
    assert found.is_jpeg
    assert np.abs(found.stored.astype(int) - smooth).mean() < 2  # quality 95


def test_planes_behind_each_other_are_channels(tmp_path: Path) -> None:
    planes = np.moveaxis(COLOUR_16, -1, 0)
    found = read(tmp_path, tiff(planes, photometric="rgb", planarconfig="separate"))
    np.testing.assert_array_equal(found.stored, COLOUR_16)


def test_a_palette_is_replaced_by_its_colours(tmp_path: Path) -> None:
    colours = np.random.default_rng(6).integers(0, 65536, (3, 256)).astype(np.uint16)
    found = read(tmp_path, tiff(GREY, photometric="palette", colormap=colours))
    np.testing.assert_array_equal(found.stored, colours.T[GREY])
    assert found.full_scale_dn == 65535


def test_opacity_beside_a_palette_is_not_read(tmp_path: Path) -> None:
    palette = Image.fromarray(GREY).convert("P")
    buffer = BytesIO()
    palette.convert("PA").save(buffer, "TIFF")
    found = read(tmp_path, buffer.getvalue())
    np.testing.assert_array_equal(found.stored[:, :, 0] // 256, GREY)  # as Pillow widens them


def test_a_palette_too_short_for_its_pixels_is_told_in_its_own_words(tmp_path: Path) -> None:
    # The count of the colour map's entry (tag 320, SHORT) is cut from 3 x 256 to 3 x 16.
    whole = tiff(GREY, photometric="palette", colormap=np.zeros((3, 256), np.uint16))
    entry, count = struct.pack("<HH", 320, 3), struct.pack("<I", 3 * 256)
    assert whole.count(entry + count) == 1
    short = whole.replace(entry + count, entry + struct.pack("<I", 3 * 16))
    with pytest.raises(ImageFileError, match="palette has 16 colours"):
        read(tmp_path, short)


@pytest.mark.parametrize("pixels", [GREY, GREY_16])
def test_where_white_is_zero_levels_are_turned_over(
    tmp_path: Path, pixels: np.ndarray[Any, Any]
) -> None:
    found = read(tmp_path, tiff(pixels, photometric="miniswhite"))
    np.testing.assert_array_equal(found.stored, np.iinfo(pixels.dtype).max - pixels)


def test_where_white_is_zero_bits_are_turned_over_and_floats_refused(tmp_path: Path) -> None:
    bits = GREY > 100
    found = read(tmp_path, tiff(bits, photometric="miniswhite"))
    np.testing.assert_array_equal(found.stored, np.where(bits, 0, 255))
    assert "white" in refusal(tmp_path, tiff(GREY.astype(np.float32), photometric="miniswhite"))


def test_bits_are_black_and_white(tmp_path: Path) -> None:
    bits = GREY > 100
    found = read(tmp_path, pillow(bits, "TIFF", compression="group4"))
    np.testing.assert_array_equal(found.stored, 255 * bits)


def packed(levels: np.ndarray[Any, Any], bits: int) -> bytes:
    """Levels packed to that many bits, most significant first, each row on a whole byte."""
    shifted = (levels[..., np.newaxis] >> np.arange(bits)[::-1]) & 1
    return np.packbits(shifted.reshape(len(levels), -1).astype(np.uint8), axis=1).tobytes()


@pytest.mark.parametrize("bits", [4, 10, 12, 14])
@pytest.mark.parametrize("is_inverted", [False, True])
def test_packed_samples_have_the_white_of_their_bits(
    tmp_path: Path, bits: int, is_inverted: bool
) -> None:
    white = 2**bits - 1
    levels = np.random.default_rng(bits).integers(0, white + 1, (12, 16)).astype(np.uint16)
    strip = packed(levels, bits)
    tags = [tag for tag in grey_tags(12, 16, 8, bits=bits, size=len(strip)) if tag[0] != 262]
    tags.append(short_tag(262, 0 if is_inverted else 1))
    data = b"II*\0" + struct.pack("<I", 8 + len(strip)) + strip
    found = read(tmp_path, data + directory(tags, len(data)))
    np.testing.assert_array_equal(found.stored, white - levels if is_inverted else levels)
    assert found.full_scale_dn == found.saturation_dn == white


def test_half_floats_are_floats(tmp_path: Path) -> None:
    found = read(tmp_path, tiff((GREY / 255).astype(np.float16)))
    assert found.stored.dtype == np.float32
    np.testing.assert_array_equal(found.stored, (GREY / 255).astype(np.float16))


@pytest.mark.parametrize("pixels", [GREY_16, COLOUR_16])
def test_an_opacity_plane_is_left_out(tmp_path: Path, pixels: np.ndarray[Any, Any]) -> None:
    opaque = np.full(pixels.shape[:2], 65535, np.uint16)
    for kind in ("unassalpha", "assocalpha"):
        data = tiff(
            np.dstack([pixels, opaque]),
            photometric="rgb" if pixels.ndim == 3 else "minisblack",
            planarconfig="contig",
            extrasamples=[kind],
        )
        np.testing.assert_array_equal(read(tmp_path, data).stored, pixels)


def test_the_plateau_of_a_12_bit_camera_counts_beside_an_opacity_plane(tmp_path: Path) -> None:
    clipped = np.minimum(COLOUR_16 // 8, 4095)
    opaque = np.full(clipped.shape[:2], 65535, np.uint16)
    data = tiff(np.dstack([clipped, opaque]), photometric="rgb", extrasamples=["unassalpha"])
    assert read(tmp_path, data).saturation_dn == 4095


def test_a_stack_says_how_many_pages_it_has_and_how_one_is_chosen(tmp_path: Path) -> None:
    data = tiff(STACK, photometric="minisblack")
    text = refusal(tmp_path, data)
    assert "5 pages" in text
    assert "--page" in text
    assert "--mean" in text
    for number in range(1, 6):
        found = read(tmp_path, data, ReadOptions(page=number))
        np.testing.assert_array_equal(found.stored, STACK[number - 1])
    assert "5 pages" in refusal(tmp_path, data, ReadOptions(page=6))
    assert "1 page" in refusal(tmp_path, tiff(GREY), ReadOptions(page=2))


def test_pages_count_from_one_and_are_chosen_or_averaged() -> None:
    for options in ({"page": 0}, {"page": -1}, {"page": 1, "is_mean": True}):
        with pytest.raises(ValueError):
            ReadOptions(**options)  # type: ignore[arg-type]  # of both types


one_directory = pytest.mark.parametrize(
    "options",
    [
        {"photometric": "minisblack"},
        {"photometric": "minisblack", "compression": "lzw"},
        {"imagej": True},
        {"imagej": True, "truncate": True},  # one directory for all
        {"imagej": True, "truncate": True, "byteorder": ">"},
        {"photometric": "minisblack", "truncate": True},
    ],
    ids=str,
)


@one_directory
def test_a_stack_gives_its_pages_mean_and_variance(tmp_path: Path, options: dict[str, Any]) -> None:
    data = tiff(STACK, **options)
    assert "5 pages" in refusal(tmp_path, data)
    np.testing.assert_array_equal(read(tmp_path, data, ReadOptions(page=4)).stored, STACK[3])
    found = read(tmp_path, data, MEAN)
    np.testing.assert_allclose(found.grey_dn, STACK.mean(axis=0), rtol=1e-12)
    assert found.variance_dn2 is not None
    np.testing.assert_allclose(found.variance_dn2, STACK.var(axis=0, ddof=1), rtol=1e-9)
    assert found.frames == 5


def test_colour_stacks_behind_one_directory_are_stacks(tmp_path: Path) -> None:
    colours = np.random.default_rng(7).integers(0, 255, (3, 20, 24, 3)).astype(np.uint8)
    data = tiff(colours, imagej=True, truncate=True)
    assert "3 pages" in refusal(tmp_path, data)
    np.testing.assert_array_equal(read(tmp_path, data, ReadOptions(page=2)).stored, colours[1])


def test_the_mean_of_encoded_pages_is_that_of_their_light(tmp_path: Path) -> None:
    stack = STACK.astype(np.uint8)
    # The formula of IEC 61966-2-1, not the code under test.
    x = stack / 255
    light = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
    data = tiff(stack, photometric="minisblack")
    found = read(tmp_path, data, replace(MEAN, encoding=SRGB))
    np.testing.assert_allclose(found.grey_dn, 255 * light.mean(axis=0), rtol=1e-9)
    assert found.variance_dn2 is not None
    expected = 255**2 * light.var(axis=0, ddof=1)
    np.testing.assert_allclose(found.variance_dn2, expected, rtol=1e-9)


def test_pages_of_two_sizes_have_no_mean(tmp_path: Path) -> None:
    buffer = BytesIO()
    with tifffile.TiffWriter(buffer) as writer:
        writer.write(GREY)
        writer.write(GREY[:20])
    assert "--page" in refusal(tmp_path, buffer.getvalue(), MEAN)
    found = read(tmp_path, buffer.getvalue(), ReadOptions(page=2))
    np.testing.assert_array_equal(found.stored, GREY[:20])


def test_each_page_is_read_by_its_own_tags(tmp_path: Path) -> None:
    buffer = BytesIO()
    with tifffile.TiffWriter(buffer) as writer:
        writer.write(GREY)
        writer.write(GREY, photometric="miniswhite")
        writer.write(np.dstack([COLOUR, GREY]), photometric="separated")
    second = read(tmp_path, buffer.getvalue(), ReadOptions(page=2))
    np.testing.assert_array_equal(second.stored, 255 - GREY)
    assert "CMYK" in refusal(tmp_path, buffer.getvalue(), ReadOptions(page=3))


def test_a_thumbnail_before_the_image_is_not_measured(tmp_path: Path) -> None:
    buffer = BytesIO()
    with tifffile.TiffWriter(buffer) as writer:
        writer.write(COLOUR[:8, :8], photometric="rgb", subfiletype=1)
        writer.write(GREY_16, photometric="minisblack")
    np.testing.assert_array_equal(read(tmp_path, buffer.getvalue()).stored, GREY_16)


def test_a_thumbnail_above_the_image_is_not_measured(tmp_path: Path) -> None:
    buffer = BytesIO()
    with tifffile.TiffWriter(buffer) as writer:
        writer.write(COLOUR[:8, :8], photometric="rgb", subfiletype=1, subifds=1)
        writer.write(GREY_16, photometric="minisblack", subfiletype=0)
    np.testing.assert_array_equal(read(tmp_path, buffer.getvalue()).stored, GREY_16)


@pytest.mark.parametrize("place", [2**31 - 2, 0])
def test_a_thumbnail_whose_picture_cannot_be_read_is_not_measured_for_it(
    tmp_path: Path, place: int
) -> None:
    tags = [long_tag(254, 1), *grey_tags(40, 52, 8), long_tag(330, place)]
    head = b"II*\0" + struct.pack("<I", 8 + GREY.size)
    said = refusal(tmp_path, head + GREY.tobytes() + directory(tags, 8 + GREY.size))
    assert "thumbnail" in said
    assert "TIFF of its own" in said


@pytest.mark.parametrize("is_below", [False, True])
def test_a_pyramid_is_one_image(tmp_path: Path, is_below: bool) -> None:
    buffer = BytesIO()
    with tifffile.TiffWriter(buffer) as writer:
        writer.write(GREY_16, subifds=2 if is_below else 0)
        for step in (2, 4):
            writer.write(np.ascontiguousarray(GREY_16[::step, ::step]), subfiletype=1)
    np.testing.assert_array_equal(read(tmp_path, buffer.getvalue()).stored, GREY_16)


def test_a_mask_beside_the_image_is_no_page(tmp_path: Path) -> None:
    buffer = BytesIO()
    with tifffile.TiffWriter(buffer) as writer:
        writer.write(GREY_16)
        writer.write(GREY > 9, subfiletype=4, photometric=4)
    np.testing.assert_array_equal(read(tmp_path, buffer.getvalue()).stored, GREY_16)


@pytest.mark.parametrize(
    ("first_timestamp_ns", "taken"), [(5, "2026:03:04 05:06:07 UTC"), (None, None)]
)
def test_a_capture_says_when_it_was_begun_and_an_imported_photograph_does_not(
    tmp_path: Path, first_timestamp_ns: int | None, taken: str | None
) -> None:
    record = replace(
        RECORD, started_utc="2026-03-04T05:06:07.123456Z", first_timestamp_ns=first_timestamp_ns
    )
    level = GREY.astype(np.float32)
    images = CaptureImages(mean_dn=level, variance_dn2=level, record=record)
    assert read(tmp_path, bytes(capture_bytes(images))).facts.taken == taken


def test_a_capture_of_a_session_is_its_mean_with_the_variance(tmp_path: Path) -> None:
    mean = (GREY_16 / 16.5).astype(np.float32)
    variance = (GREY / 7.0).astype(np.float32)
    record = replace(RECORD, frames_used=25, max_level_dn=4095.0, scale_px_per_mm=None)
    data = capture_bytes(CaptureImages(mean_dn=mean, variance_dn2=variance, record=record))
    for options in (ReadOptions(), ReadOptions(page=1), MEAN):
        found = read(tmp_path, bytes(data), options)
        np.testing.assert_array_equal(found.grey_dn, mean)
        assert found.variance_dn2 is not None
        np.testing.assert_array_equal(found.variance_dn2, variance)
        assert (found.frames, found.saturation_dn, found.encoding.name) == (25, 4095.0, "linear")


@pytest.mark.parametrize(("mode", "name"), [("CMYK", "CMYK"), ("LAB", "L*a*b*")])
def test_colours_without_a_luma_are_refused(tmp_path: Path, mode: str, name: str) -> None:
    assert name in refusal(tmp_path, pillow(Image.new(mode, (9, 8)), "TIFF"))


@pytest.mark.parametrize("options", [{"photometric": "ycbcr"}, {"photometric": 32845}], ids=str)
def test_luma_beside_colour_differences_is_refused(tmp_path: Path, options: dict[str, Any]) -> None:
    data = bytearray(tiff(COLOUR, photometric="rgb"))
    with tifffile.TiffFile(BytesIO(data)) as made:
        at = made.pages.first.tags["PhotometricInterpretation"].valueoffset
    data[at : at + 2] = struct.pack("<H", {"ycbcr": 6}.get(options["photometric"], 32845))
    assert "convert" in refusal(tmp_path, bytes(data))


def test_a_profile_says_how_levels_are_encoded(tmp_path: Path) -> None:
    found = read(tmp_path, tiff(COLOUR, iccprofile=DISPLAY_P3, photometric="rgb"))
    assert found.encoding.name == "srgb"
    assert found.encoding_from.endswith("Display P3")
    gamma = profile(curve_of(563), space=b"GRAY")
    assert read(tmp_path, tiff(GREY, iccprofile=gamma)).encoding.name == "gamma:2.199"


def test_three_curves_on_grey_pixels_are_refused_and_an_encoding_reads_them(
    tmp_path: Path,
) -> None:
    data = tiff(GREY, iccprofile=profile(curve_of(256), curve_of(300), curve_of(512)))
    assert "--encoding" in refusal(tmp_path, data)
    given = Encoding(name="gamma:2.2")
    assert read(tmp_path, data, ReadOptions(encoding=given)).encoding == given


def test_three_curves_on_a_stack_with_an_opacity_plane_have_a_mean(tmp_path: Path) -> None:
    stack = np.random.default_rng(8).integers(0, 255, (3, 10, 12, 4)).astype(np.uint8)
    curves = profile(curve_of(256), curve_of(300), curve_of(512))
    data = tiff(stack, photometric="rgb", extrasamples=["unassalpha"], iccprofile=curves)
    found = read(tmp_path, data, MEAN)
    red = np.asarray(found.colour_planes, dtype=np.float64)[:, :, 0]
    np.testing.assert_allclose(red, stack[..., 0].mean(axis=0), atol=1e-9)


def test_encoded_floats_beyond_white_are_refused(tmp_path: Path) -> None:
    data = tiff(GREY.astype(np.float32))
    assert "--encoding" in refusal(tmp_path, data, ReadOptions(encoding=SRGB))


def test_a_raw_mosaic_in_a_plain_tiff_has_its_pattern(tmp_path: Path) -> None:
    def mosaic(*cells: int, size: int = 2) -> bytes:
        tags = [(33421, "H", 2, (size, size), True), (33422, "B", len(cells), bytes(cells), True)]
        return tiff(GREY_16, photometric=32803, extratags=tags)

    found = read(tmp_path, mosaic(1, 0, 2, 1))
    np.testing.assert_array_equal(found.stored, GREY_16)
    assert found.pattern == "GRBG"
    for data in (mosaic(0, 1, 1, 1), mosaic(*[0, 1, 2] * 12, size=6)):
        assert "Bayer" in refusal(tmp_path, data)


def test_a_number_in_place_of_a_pattern_takes_no_memory() -> None:
    tags = [(33421, "H", 2, (2, 2), True), (33422, "I", 1, 2**32 - 1, True)]
    with pytest.raises(DecodingError):
        read_tiff_image(tiff(GREY_16, photometric=32803, extratags=tags))


def test_a_compression_that_states_no_size_is_refused(tmp_path: Path) -> None:
    assert "deflate" in refusal(tmp_path, tiff(GREY, compression="jpegxl"))


def test_a_segment_that_is_larger_than_its_page_is_refused(tmp_path: Path) -> None:
    small = tiff(GREY, compression="jpeg")
    large = imagecodecs.jpeg8_encode(np.zeros((3000, 3000), np.uint8))
    with tifffile.TiffFile(BytesIO(small)) as made:
        offset, count = (
            made.pages.first.tags[name].valueoffset for name in ("StripOffsets", "StripByteCounts")
        )
        wide = made.pages.first.tags["StripByteCounts"].dtype == 4
    data = bytearray(small)
    struct.pack_into("<I", data, offset, len(small))
    struct.pack_into("<I" if wide else "<H", data, count, min(len(large), 65535))
    refusal(tmp_path, bytes(data) + large)


def test_directories_that_follow_in_a_circle_end(tmp_path: Path) -> None:
    tags = grey_tags(40, 52, 8)
    at = 8 + GREY.size
    data = b"II*\0" + struct.pack("<I", at) + GREY.tobytes() + directory(tags, at, following=at)
    refusal(tmp_path, data)


def test_more_values_than_the_file_can_hold_are_refused(tmp_path: Path) -> None:
    # Nine thousand pages whose profile is the same megabyte: 8 GB and a minute once.
    tags = [*grey_tags(4, 4, 8), *((n, 1, 1 << 20, b"\10\0\0\0") for n in (700, 34675, 37724))]
    size = len(directory([long_tag(number, 8) for number, *_ in tags], 0))
    start = 8 + (1 << 20)
    pages = [
        directory([(n, k, c, v[:4]) for n, k, c, v in tags], 0, start + (i + 1) * size)
        for i in range(9000)
    ]
    data = b"II*\0" + struct.pack("<I", start) + bytes(1 << 20) + b"".join(pages)
    assert "tags" in refusal(tmp_path, data + directory(tags[:9], 0))


SAMPLES = {
    "plain": (tiff(GREY_16), GREY_16),
    "tiles": (tiff(GREY_16, tile=(16, 16), compression="deflate"), GREY_16),
    "strips": (tiff(COLOUR, compression="lzw", rowsperstrip=5, photometric="rgb"), COLOUR),
    "frames": (tiff(STACK, imagej=True, truncate=True), STACK[4]),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SAMPLES)
@given(data=st.data())
def test_a_file_that_is_cut_is_refused_or_whole(name: str, data: st.DataObject) -> None:
    sample, pixels = SAMPLES[name]
    length = data.draw(st.integers(0, len(sample)))
    try:
        image = read_tiff_image(sample[:length])
        found = image.page(image.count - 1)
    except DecodingError:
        return
    if image.count == (5 if name == "frames" else 1):
        np.testing.assert_array_equal(found, pixels)


@pytest.mark.slow
@given(at=st.integers(8, 300), bits=st.integers(1, 255), kind=st.sampled_from(sorted(SAMPLES)))
@example(at=8, bits=255, kind="plain")
def test_flipped_bits_give_an_image_or_the_one_error(at: int, bits: int, kind: str) -> None:
    damaged = bytearray(SAMPLES[kind][0])
    damaged[at] ^= bits
    try:
        image = read_tiff_image(bytes(damaged))
        image.marked()
        image.page(0)
    except DecodingError:
        pass


@pytest.mark.parametrize("pages", [1, 3])
def test_signed_levels_that_imagej_moved_up_come_back(tmp_path: Path, pages: int) -> None:
    """ImageJ stores signed 16-bit levels, as of scanning microscopes, 32768 higher, and says so."""
    signed = GREY_16.astype(np.int32) - 20_000
    signed = np.clip(signed, -32768, 32767).astype(np.int16)
    stored = (signed.astype(np.int32) + 32768).astype(np.uint16)
    calibration = (
        "ImageJ=1.54f\nimages={}\nslices={}\ncf=0\nc0=-32768.0\nc1=1.0\nvunit=Gray Value\n"
    )
    data = tiff(
        np.stack([stored] * pages) if pages > 1 else stored,
        description=calibration.format(pages, pages),
        metadata=None,
        photometric="minisblack",
    )
    options = ReadOptions(page=pages) if pages > 1 else ReadOptions()
    found = read(tmp_path, data, options)
    np.testing.assert_array_equal(found.stored, signed)
    assert found.stored.dtype == np.int16


def test_another_calibration_of_imagej_leaves_the_levels(tmp_path: Path) -> None:
    data = tiff(GREY_16, description="ImageJ=1.54f\ncf=0\nc0=0.5\nc1=0.01\n", metadata=None)
    np.testing.assert_array_equal(read(tmp_path, data).stored, GREY_16)
