"""DNGs written byte by byte: their levels are known exactly."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from acquisition.photographs._decoding import DecodingError
from acquisition.photographs._photograph import Photograph
from acquisition.photographs._stored_image import PhotographFacts
from acquisition.photographs._tiff import is_camera_raw, read_camera_raw
from standoff.errors import ImageFileError
from tests.acquisition.photographs.made import CELLS, THUMBNAIL_LEVEL, Dng, read

pytest.importorskip("rawpy", reason="camera raw is an extra")

# Every level is of use once: a turned, shifted or mixed mosaic would show.
MOSAIC = (64 + np.arange(64 * 96) % 3000).reshape(64, 96).astype(np.uint16)
COLOUR = np.dstack([MOSAIC, MOSAIC[::-1], MOSAIC[:, ::-1]])


def raw(folder: Path, file: Dng, name: str = "photo.dng") -> Photograph:
    return read(folder, file.to_bytes(), name=name)


def refusal(folder: Path, data: bytes, name: str = "photo.dng") -> str:
    with pytest.raises(ImageFileError) as refused:
        read(folder, data, name=name)
    text = str(refused.value)
    assert text.isprintable()
    return text


@pytest.mark.parametrize("pattern", CELLS)
def test_the_mosaic_is_read_exactly_with_its_pattern(tmp_path: Path, pattern: str) -> None:
    found = raw(tmp_path, Dng(levels=MOSAIC, cells=CELLS[pattern]))
    np.testing.assert_array_equal(found.linear_planes, MOSAIC.astype(float) - 64)
    assert found.pattern == pattern
    assert found.full_scale_dn == found.saturation_dn == 4000 - 64
    assert (found.encoding.name, found.encoding_from) == ("linear", "camera raw")
    assert found.facts.camera == "Testmaker T1"


def test_the_thumbnail_is_never_read(tmp_path: Path) -> None:
    for name in ("photo.dng", "photo.tif", "photo"):
        found = raw(tmp_path, Dng(levels=MOSAIC), name)
        assert found.stored.shape == MOSAIC.shape
        assert not (found.stored == THUMBNAIL_LEVEL - 64).all()


@pytest.mark.parametrize("pattern", CELLS)
@pytest.mark.parametrize("repeat", [(2, 2), (1, 2), (2, 1)])
def test_each_cell_has_its_own_black(tmp_path: Path, pattern: str, repeat: tuple[int, int]) -> None:
    rows, cols = repeat
    black = (10, 20, 30, 40)[: rows * cols]
    found = raw(
        tmp_path,
        Dng(levels=MOSAIC, cells=CELLS[pattern], black=black, black_repeat=repeat),
    )
    expected = MOSAIC.astype(float) - np.tile(np.reshape(black, repeat), (64 // rows, 96 // cols))
    np.testing.assert_array_equal(found.linear_planes, expected)
    assert found.full_scale_dn == 4000 - max(black)  # the first channel to clip


def test_black_levels_that_libraw_keeps_to_itself_are_refused(tmp_path: Path) -> None:
    file = Dng(levels=MOSAIC, black=range(16), black_repeat=(4, 4))
    assert "black" in refusal(tmp_path, file.to_bytes())


def test_levels_below_black_stay_below_zero(tmp_path: Path) -> None:
    found = raw(tmp_path, Dng(levels=MOSAIC, black=(500,)))
    assert found.linear_planes.min() == 64 - 500


def test_a_linearisation_table_is_applied(tmp_path: Path) -> None:
    table = (np.arange(4096) ** 2 // 300).astype(np.uint16)
    found = raw(tmp_path, Dng(levels=MOSAIC, table=table, white=50_000))
    np.testing.assert_array_equal(found.linear_planes, table[MOSAIC].astype(float) - 64)


def test_linear_raw_is_a_photograph_in_colour(tmp_path: Path) -> None:
    found = raw(tmp_path, Dng(levels=COLOUR, black=(64, 65, 66)))
    np.testing.assert_array_equal(found.linear_planes, COLOUR.astype(float) - (64, 65, 66))
    assert found.pattern is None


def test_a_filter_of_six_by_six_is_refused(tmp_path: Path) -> None:
    x_trans = [1, 1, 0, 1, 1, 2, 1, 1, 2, 1, 1, 0, 2, 0, 1, 0, 2, 1,
               1, 1, 2, 1, 1, 0, 1, 1, 0, 1, 1, 2, 0, 2, 1, 2, 0, 1]  # fmt: skip
    text = refusal(tmp_path, Dng(levels=MOSAIC[:60], cells=x_trans).to_bytes())
    assert "Bayer" in text


def test_white_below_black_is_refused(tmp_path: Path) -> None:
    assert "white" in refusal(tmp_path, Dng(levels=MOSAIC, black=(4001,)).to_bytes())


@pytest.fixture
def without_rawpy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rawpy", None)


@pytest.mark.usefixtures("without_rawpy")
def test_without_libraw_one_line_names_the_extra(tmp_path: Path) -> None:
    assert "standoff[raw]" in refusal(tmp_path, Dng(levels=MOSAIC).to_bytes())


@pytest.mark.parametrize(
    ("data", "name"),
    [
        (b"", "a.NEF"),
        (b"", "a.cr3"),
        (b"II*\0\x10\0\0\0CR\x02\0", "a.tif"),
        (b"FUJIFILMCCD-RAW 0201", "a.jpg"),
        (b"\0\0\0\x18ftypcrx \0\0\0\1", "a"),
    ],
)
def test_a_raw_file_is_known_by_its_first_bytes_or_its_name(data: bytes, name: str) -> None:
    assert is_camera_raw(data, Path(name), frozenset())


def test_other_files_are_none() -> None:
    for data in (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xdb\0\x43\0\x01CRxx", b"P5\n12 34\nCR"):
        assert not is_camera_raw(data, Path("a.png"), frozenset())


def test_text_under_the_name_of_a_raw_file_is_refused(tmp_path: Path) -> None:
    assert "camera raw" in refusal(tmp_path, b"hello", "a.nef")


SAMPLE = Dng(levels=MOSAIC).to_bytes()


def levels_of(data: bytes) -> np.ndarray[Any, Any] | None:
    try:
        return read_camera_raw(data, PhotographFacts()).page(0)
    except DecodingError:
        return None


@given(length=st.integers(0, len(SAMPLE) - 1))
def test_a_file_that_is_cut_is_refused(length: int) -> None:
    found = levels_of(SAMPLE[:length])
    # The thumbnail and the pixels come first; the last bytes are the padding of a value.
    assert found is None or np.array_equal(found, MOSAIC.astype(np.float32) - 64)


@pytest.mark.slow
@given(at=st.integers(len(SAMPLE) - 500, len(SAMPLE) - 1), bits=st.integers(1, 255))
def test_flipped_bits_give_levels_or_the_one_error(at: int, bits: int) -> None:
    damaged = bytearray(SAMPLE)
    damaged[at] ^= bits
    levels_of(bytes(damaged))


@pytest.mark.parametrize("name", ["frame.raw", "frame.dng"])
def test_numbers_without_a_header_are_called_that(tmp_path: Path, name: str) -> None:
    """Viewers of machine-vision cameras, and phones, write the mosaic's numbers alone as .raw."""
    text = refusal(tmp_path, MOSAIC.tobytes(), name)
    assert "neither its size nor its type" in text
    assert "give the array" in text


def test_a_raw_file_that_libraw_does_not_know_is_to_be_converted(tmp_path: Path) -> None:
    """As of a camera that is newer than LibRaw, or a compression that it has no licence for."""
    import tifffile

    tifffile.imwrite(tmp_path / "made.tif", MOSAIC[:4, :4])
    data = (tmp_path / "made.tif").read_bytes()
    text = refusal(tmp_path, data, "photo.nef")
    assert "convert it to DNG" in text


def test_a_photograph_under_the_name_of_a_raw_file_is_called_what_it_is(tmp_path: Path) -> None:
    assert "a Photoshop document" in refusal(tmp_path, b"8BPS" + bytes(400), "photo.arw")
