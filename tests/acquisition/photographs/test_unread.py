"""Files that people take for photographs and that no reader reads: each is called what it is."""

from pathlib import Path

import imagecodecs
import numpy as np
import pytest

from acquisition.photographs import each_image
from standoff.errors import ImageFileError
from tests.acquisition.photographs.made import GREY, GREY_16, pillow, read

GREY_12 = (GREY_16 >> 4).astype(np.uint16)
LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12345\n"
BESIDE = bytes.fromhex("0005160700020000") + b"Mac OS X        " + bytes(4000)
FILES = {
    "12-bit": (imagecodecs.jpeg8_encode(GREY_12, level=95, bitspersample=12), "JPEG of 12 bits"),
    "lossless": (imagecodecs.ljpeg_encode(GREY_12, bitspersample=12), "a lossless JPEG"),
    "jpeg-ls": (imagecodecs.jpegls_encode(GREY_12), "a lossless JPEG"),
    "jpeg-xl": (imagecodecs.jpegxl_encode(GREY), "JPEG XL"),
    "cut": (b"\xff\xd8\xff" + bytes(60), "a damaged JPEG"),
    "photoshop": (b"8BPS\0\1" + bytes(200), "Photoshop"),
    "dicom": (bytes(128) + b"DICM" + bytes(200), "DICOM"),
    "czi": (b"ZISRAWFILE" + bytes(200), "microscope"),
    "ser": (b"LUCAM-RECORDER" + bytes(200), "its frames"),
    "numpy": (b"\x93NUMPY\x01\0" + bytes(200), "in Python"),
    "film": (b"\0\0\0\x20ftypisom" + bytes(200), "a video"),
    "avi": (b"RIFF\0\x01\0\0AVI LIST" + bytes(200), "a video"),
    "page": (b"\n<!DOCTYPE html><html><body>404</body></html>", "a web page"),
    "lfs": (LFS, "git lfs pull"),
    "beside": (BESIDE, "without the leading ._"),
    "archive": (b"PK\x03\x04" + bytes(200), "unpack it"),
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_called_what_it_is(name: str, tmp_path: Path) -> None:
    """Of a 12-bit or lossless JPEG it was said that JPEG is expected."""
    data, said = FILES[name]
    with pytest.raises(ImageFileError) as refused:
        read(tmp_path, bytes(data), name="photo.jpg")
    text = str(refused.value)
    assert said in text
    assert text.isprintable()


def test_what_macos_keeps_beside_photographs_is_none_of_a_folder(tmp_path: Path) -> None:
    """On exFAT sticks and in ZIP files each name.jpg has a ._name.jpg of 4 kB beside it."""
    (tmp_path / "a.jpg").write_bytes(pillow(GREY, "JPEG"))
    (tmp_path / "._a.jpg").write_bytes(BESIDE)
    assert list(each_image([tmp_path])) == [tmp_path / "a.jpg"]


def test_a_hidden_file_that_is_named_is_read(tmp_path: Path) -> None:
    assert list(each_image([tmp_path / ".a.jpg"])) == [tmp_path / ".a.jpg"]
