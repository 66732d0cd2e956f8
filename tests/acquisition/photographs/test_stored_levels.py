"""The levels of a file as they were stored, and what the file says of its clipping."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from PIL import Image

from acquisition.photographs import LINEAR, ReadOptions, read_image
from simulation.arrays import FloatArray
from standoff.errors import ImageFileError

RNG = np.random.default_rng(0)
AS_LINEAR = ReadOptions(encoding=LINEAR)


def read_grey(path: Path) -> FloatArray:
    return read_image(path, AS_LINEAR).grey_dn


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("shape", [(7, 9), (7, 9, 3)])
def test_a_tiff_comes_back_as_it_was_written(
    tmp_path: Path, dtype: type, shape: tuple[int, ...]
) -> None:
    pixels: NDArray[Any] = RNG.integers(0, 255, shape).astype(dtype)
    photometric = "rgb" if len(shape) == 3 else "minisblack"
    tifffile.imwrite(tmp_path / "i.tif", pixels, photometric=photometric)
    image = read_image(tmp_path / "i.tif")
    np.testing.assert_array_equal(image.stored, pixels)
    assert image.is_colour is (len(shape) == 3)


def test_colours_stored_plane_by_plane_come_last(tmp_path: Path) -> None:
    planes = RNG.integers(0, 255, (3, 20, 30)).astype(np.uint8)
    tifffile.imwrite(
        tmp_path / "p.tif", planes, photometric="rgb", planarconfig="separate", metadata=None
    )
    np.testing.assert_array_equal(read_image(tmp_path / "p.tif").stored, np.moveaxis(planes, 0, -1))


def test_sixteen_bit_colour_png_keeps_its_bits_and_its_order(tmp_path: Path) -> None:
    pixels = RNG.integers(0, 65535, (6, 8, 3)).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "c.png"), pixels[:, :, ::-1])  # OpenCV writes blue first
    image = read_image(tmp_path / "c.png")
    np.testing.assert_array_equal(image.stored, pixels)
    assert image.full_scale_dn == 65535.0


@pytest.mark.parametrize("mode", ["1", "L", "P", "RGB", "RGBA", "I;16"])
def test_what_pillow_opens_is_read(tmp_path: Path, mode: str) -> None:
    grey = Image.fromarray(RNG.integers(0, 255, (12, 10)).astype(np.uint8))
    if mode == "I;16":
        picture = Image.fromarray(RNG.integers(0, 4000, (12, 10)).astype(np.uint16))
    else:
        picture = grey.convert(mode)
    picture.save(tmp_path / "i.png")
    assert read_image(tmp_path / "i.png").stored.shape[:2] == (12, 10)


def test_a_12_bit_plateau_in_16_bits_is_saturation(tmp_path: Path) -> None:
    pixels = np.full((40, 40), 900, np.uint16)
    pixels[:, 20:] = 4095
    tifffile.imwrite(tmp_path / "i.tif", pixels)
    assert read_image(tmp_path / "i.tif").saturation_dn == 4095.0
    pixels[:, 20:] = 4000
    tifffile.imwrite(tmp_path / "i.tif", pixels)
    assert read_image(tmp_path / "i.tif").saturation_dn == 65535.0


def test_float_files_have_no_saturation(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "i.tif", np.ones((4, 5), np.float32))
    assert read_image(tmp_path / "i.tif").saturation_dn is None


def test_a_jpeg_is_known_by_its_bytes_not_its_name(tmp_path: Path) -> None:
    Image.new("L", (16, 16), 90).save(tmp_path / "photo.png", format="JPEG")
    assert read_image(tmp_path / "photo.png").is_jpeg


def _samples() -> list[bytes]:
    samples = []
    for extension in (".tif", ".png", ".jpg"):
        pixels = RNG.integers(0, 255, (20, 24)).astype(np.uint8)
        samples.append(cv2.imencode(extension, pixels)[1].tobytes())
    return samples


SAMPLES = _samples()


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_a_file_with_damaged_bytes_gives_an_image_or_the_one_error(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    content = bytearray(data.draw(st.sampled_from(SAMPLES)))
    for _ in range(data.draw(st.integers(0, 4))):
        index = data.draw(st.integers(0, len(content) - 1))
        content[index] = data.draw(st.integers(0, 255))
    length = data.draw(st.integers(0, len(content)))
    path = tmp_path_factory.mktemp("fuzz") / "i.dat"
    path.write_bytes(bytes(content[:length]))
    try:
        image = read_image(path)
    except ImageFileError as error:
        message = str(error)
    else:
        message = f"i.dat {image.stored.shape}"
        assert image.stored.ndim in (2, 3)
    assert "i.dat" in message
    assert "\n" not in message


def test_an_opacity_plane_is_no_light_and_odd_types_are_read_as_numbers(tmp_path: Path) -> None:
    grey = RNG.integers(0, 200, (12, 10)).astype(np.uint8)
    Image.fromarray(np.dstack([grey, np.full_like(grey, 7)]), "LA").save(tmp_path / "la.png")
    np.testing.assert_array_equal(read_grey(tmp_path / "la.png"), grey)
    colour = np.dstack([grey] * 3 + [np.full_like(grey, 7)])
    Image.fromarray(colour, "RGBA").save(tmp_path / "rgba.png")
    np.testing.assert_array_equal(
        read_image(tmp_path / "rgba.png", AS_LINEAR).colour_planes, colour[..., :3]
    )
    wide = grey.astype(np.uint32) * 1000
    tifffile.imwrite(tmp_path / "wide.tif", wide)
    assert read_image(tmp_path / "wide.tif").colour_planes.dtype == np.float64
    np.testing.assert_array_equal(read_grey(tmp_path / "wide.tif"), wide)
    one_plane = read_image(tmp_path / "la.png")
    tifffile.imwrite(tmp_path / "one.tif", grey[:, :, None], photometric="minisblack")
    np.testing.assert_array_equal(read_grey(tmp_path / "one.tif"), grey)
    assert not one_plane.is_colour
