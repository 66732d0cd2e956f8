"""OpenEXR and FITS by their own libraries."""

import contextlib
import sys
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from acquisition.photographs._decoding import DecodingError
from acquisition.photographs._raster import read_exr_image, read_fits_image
from acquisition.photographs._reader import ReadOptions
from standoff.errors import ImageFileError
from tests.acquisition.photographs.made import COLOUR, GREY_16, read

LIGHT = (COLOUR / np.float32(100)).astype(np.float32)
CUBE = np.stack([GREY_16, GREY_16 // 2, GREY_16 // 3])


def exr(path: Path, channels: dict[str, NDArray[Any]]) -> bytes:
    library = pytest.importorskip("OpenEXR", reason="an extra")
    header = {"compression": library.ZIP_COMPRESSION, "type": library.scanlineimage}
    with library.File(header, channels) as file:
        file.write(str(path / "made.exr"))
    return (path / "made.exr").read_bytes()


def fits(pixels: NDArray[Any], **options: Any) -> bytes:
    library = pytest.importorskip("astropy.io.fits", reason="an extra")
    buffer = BytesIO()
    library.HDUList([library.PrimaryHDU(pixels, **options)]).writeto(buffer)
    return buffer.getvalue()


def refusal(folder: Path, data: bytes) -> str:
    with pytest.raises(ImageFileError) as refused:
        read(folder, data)
    text = str(refused.value)
    assert text.isprintable()
    return text


def test_rows_of_fits_are_in_the_order_of_the_file_which_viewers_turn_over(tmp_path: Path) -> None:
    found = read(tmp_path, fits(GREY_16.astype(np.int16)))
    np.testing.assert_array_equal(found.stored, GREY_16.astype(np.int16))
    assert found.facts.turn == "mirrored top to bottom"
    assert any("mirrored top to bottom" in said for said in found.remarks.values())


def test_fits_that_state_the_first_row_at_the_top_are_not_turned_over(tmp_path: Path) -> None:
    library = pytest.importorskip("astropy.io.fits", reason="an extra")
    header = library.Header({"ROWORDER": "TOP-DOWN"})
    assert read(tmp_path, fits(GREY_16.astype(np.int16), header=header)).facts.turn is None


@pytest.mark.parametrize("kind", [np.float32, np.float16])
def test_the_colours_of_an_exr_are_read(tmp_path: Path, kind: type[np.floating[Any]]) -> None:
    light = LIGHT.astype(kind)
    found = read(tmp_path, exr(tmp_path, {"RGB": light}))
    np.testing.assert_array_equal(found.colour_planes, light)
    assert (found.encoding.name, found.full_scale_dn) == ("linear", None)


def test_opacity_and_depth_beside_the_colours_are_left_out(tmp_path: Path) -> None:
    names = ("R", "G", "B", "A", "Z")
    planes = {name: np.ascontiguousarray(LIGHT[:, :, i % 3]) for i, name in enumerate(names)}
    np.testing.assert_array_equal(read(tmp_path, exr(tmp_path, planes)).stored, LIGHT)


@pytest.mark.parametrize("name", ["Y", "depth"])
def test_one_channel_of_an_exr_is_grey(tmp_path: Path, name: str) -> None:
    plane = np.ascontiguousarray(LIGHT[:, :, 1])
    np.testing.assert_array_equal(read(tmp_path, exr(tmp_path, {name: plane})).stored, plane)


def test_channels_that_are_no_picture_are_named_on_one_line(tmp_path: Path) -> None:
    plane = np.ascontiguousarray(LIGHT[:, :, 1])
    text = refusal(tmp_path, exr(tmp_path, {"normal.X": plane, "a\nb\x1b[31m": plane}))
    assert "normal.X" in text


def parts(path: Path, **channels: dict[str, NDArray[Any]]) -> bytes:
    library = pytest.importorskip("OpenEXR", reason="an extra")
    header = {"compression": library.ZIP_COMPRESSION, "type": library.scanlineimage}
    library.File(
        [library.Part(header | {"name": name}, each) for name, each in channels.items()]
    ).write(str(path / "made.exr"))
    return (path / "made.exr").read_bytes()


def test_the_one_picture_of_several_parts_is_read_wherever_it_stands(tmp_path: Path) -> None:
    """Renderers write depth and picture as parts; the first one was taken, which may be depth."""
    depth = np.ascontiguousarray(LIGHT[:, :, 0])
    found = read(tmp_path, parts(tmp_path, depth={"Z": depth}, beauty={"RGB": LIGHT}))
    np.testing.assert_array_equal(found.stored, LIGHT)
    assert any("parts depth" in said for said in found.remarks.values())


def test_of_two_pictures_in_an_exr_none_is_chosen(tmp_path: Path) -> None:
    """A stereo pair: the left view was taken without a word."""
    data = parts(tmp_path, left={"RGB": LIGHT}, right={"RGB": LIGHT / 2})
    text = refusal(tmp_path, data)
    assert "left, right" in text
    assert "a file of its own" in text


def test_parts_without_a_picture_are_named(tmp_path: Path) -> None:
    plane = np.ascontiguousarray(LIGHT[:, :, 0])
    data = parts(tmp_path, depth={"Z": plane}, normal={"X": plane, "Z": plane})
    assert "none of its parts (depth, normal)" in refusal(tmp_path, data)


@pytest.mark.parametrize(
    ("stated", "offsets", "pattern"),
    [
        ("RGGB", (0, 0), "RGGB"),
        ("rggb ", (0, 0), "RGGB"),
        ("RGGB", (1, 0), "GRBG"),
        ("RGGB", (0, 1), "GBRG"),
        ("RGGB", (1, 1), "BGGR"),
        ("GRBG", (1, 0), "RGGB"),
        ("NONE", (0, 0), None),
    ],
)
def test_the_mosaic_of_an_astronomers_colour_camera_has_its_pattern(
    stated: str, offsets: tuple[int, int], pattern: str | None, tmp_path: Path
) -> None:
    """Frames of one-shot-colour cameras were measured as grey, with all colours in one edge."""
    library = pytest.importorskip("astropy.io.fits", reason="an extra")
    header = library.Header({"BAYERPAT": stated, "XBAYROFF": offsets[0], "YBAYROFF": offsets[1]})
    assert read(tmp_path, fits(GREY_16, header=header)).pattern == pattern


def test_a_filter_that_is_not_bayers_is_refused_and_colours_made_of_it_are_not(
    tmp_path: Path,
) -> None:
    library = pytest.importorskip("astropy.io.fits", reason="an extra")
    text = refusal(tmp_path, fits(GREY_16, header=library.Header({"BAYERPAT": "GGGBRB"})))
    assert "pattern GGGBRB" in text
    developed = fits(CUBE, header=library.Header({"BAYERPAT": "RGGB"}))
    assert read(tmp_path, developed, ReadOptions(page=1)).pattern is None


@pytest.mark.parametrize("pixels", [LIGHT[:, :, 0], GREY_16, GREY_16.astype(np.int16)])
def test_a_fits_image_is_read_in_the_order_of_its_rows(
    tmp_path: Path, pixels: NDArray[Any]
) -> None:
    found = read(tmp_path, fits(pixels))
    np.testing.assert_array_equal(found.stored, pixels)
    assert found.stored.dtype == pixels.dtype
    assert found.stored.dtype.isnative
    assert found.encoding.name == "linear"


def test_unsigned_levels_of_a_fits_file_have_their_white(tmp_path: Path) -> None:
    # Stored as signed integers with BZERO 32768.
    assert b"BZERO" in fits(GREY_16)
    found = read(tmp_path, fits(GREY_16))
    assert found.full_scale_dn == found.saturation_dn == 65535


def test_a_fits_cube_is_a_stack(tmp_path: Path) -> None:
    data = fits(CUBE)
    assert "3 pages" in refusal(tmp_path, data)
    np.testing.assert_array_equal(read(tmp_path, data, ReadOptions(page=2)).stored, CUBE[1])
    found = read(tmp_path, data, ReadOptions(is_mean=True))
    np.testing.assert_allclose(found.grey_dn, CUBE.mean(axis=0), rtol=1e-12)
    assert found.variance_dn2 is not None
    np.testing.assert_allclose(found.variance_dn2, CUBE.var(axis=0, ddof=1), rtol=1e-9)


def test_the_image_of_an_extension_is_read(tmp_path: Path) -> None:
    library = pytest.importorskip("astropy.io.fits", reason="an extra")
    for unit in (library.ImageHDU(GREY_16), library.CompImageHDU(GREY_16)):
        buffer = BytesIO()
        library.HDUList([library.PrimaryHDU(), unit]).writeto(buffer)
        np.testing.assert_array_equal(read(tmp_path, buffer.getvalue()).stored, GREY_16)


def test_a_fits_file_without_a_picture_is_refused(tmp_path: Path) -> None:
    for pixels in (None, np.zeros(9, np.int16), np.zeros((2, 2, 2, 2), np.int16)):
        assert "two axes" in refusal(tmp_path, fits(pixels))  # type: ignore[arg-type]  # none


def test_a_fits_file_that_says_it_is_a_giant_is_refused(tmp_path: Path) -> None:
    data = fits(GREY_16).replace(
        b"NAXIS1  =                   52", b"NAXIS1  =           5200000000"
    )
    assert "pixels" in refusal(tmp_path, data)


def test_pixels_that_are_not_numbers_are_refused(tmp_path: Path) -> None:
    holes = LIGHT[:, :, 0].copy()
    holes[3, 4] = np.nan
    assert "NaN" in refusal(tmp_path, fits(holes))
    assert "NaN" in refusal(tmp_path, exr(tmp_path, {"Y": holes}))


@pytest.mark.parametrize(
    ("module", "data"), [("OpenEXR", b"\x76\x2f\x31\x01"), ("astropy.io", b"SIMPLE  =")]
)
def test_without_the_library_one_line_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str, data: bytes
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    assert "standoff[formats]" in refusal(tmp_path, data)


def damaged(sample: bytes, data: st.DataObject) -> bytes:
    changed = bytearray(sample)
    changed[data.draw(st.integers(0, len(sample) - 1))] ^= data.draw(st.integers(0, 255))
    return bytes(changed[: data.draw(st.integers(0, len(sample)))])


@pytest.mark.slow
@given(data=st.data())
def test_a_damaged_exr_gives_an_image_or_the_one_error(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    sample = exr(tmp_path_factory.getbasetemp(), {"RGB": LIGHT})
    with contextlib.suppress(DecodingError):
        read_exr_image(damaged(sample, data)).page(0)


@pytest.mark.slow
@given(data=st.data())
def test_a_damaged_fits_file_gives_an_image_or_the_one_error(data: st.DataObject) -> None:
    with contextlib.suppress(DecodingError):
        read_fits_image(damaged(fits(GREY_16), data)).page(0)


@pytest.mark.slow
@given(data=st.data())
def test_a_file_that_is_cut_is_refused_or_whole(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    plane = np.ascontiguousarray(LIGHT[:, :, 0])
    samples = (
        (read_exr_image, exr(tmp_path_factory.getbasetemp(), {"Y": plane}), plane),
        (read_fits_image, fits(GREY_16), GREY_16),
    )
    for reader, sample, pixels in samples:
        length = data.draw(st.integers(0, len(sample)))
        with contextlib.suppress(DecodingError):
            np.testing.assert_array_equal(reader(sample[:length]).page(0), pixels)
