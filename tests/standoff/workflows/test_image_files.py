import errno
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from PIL import Image

from standoff.errors import ImageFileError
from standoff.workflows.image_files import read_grey, read_image, write_float_tiff, write_mask

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("shape", [(7, 9), (7, 9, 3)])
def test_a_tiff_comes_back_as_it_was_written(
    tmp_path: Path, dtype: type, shape: tuple[int, ...]
) -> None:
    pixels: NDArray[Any] = RNG.integers(0, 255, shape).astype(dtype)
    photometric = "rgb" if len(shape) == 3 else "minisblack"
    tifffile.imwrite(tmp_path / "i.tif", pixels, photometric=photometric)
    image = read_image(tmp_path / "i.tif")
    np.testing.assert_array_equal(image.pixels, pixels)
    assert image.is_colour is (len(shape) == 3)


def test_colours_stored_plane_by_plane_come_last(tmp_path: Path) -> None:
    planes = RNG.integers(0, 255, (3, 20, 30)).astype(np.uint8)
    tifffile.imwrite(
        tmp_path / "p.tif", planes, photometric="rgb", planarconfig="separate", metadata=None
    )
    np.testing.assert_array_equal(read_image(tmp_path / "p.tif").pixels, np.moveaxis(planes, 0, -1))


def test_sixteen_bit_colour_png_keeps_its_bits_and_its_order(tmp_path: Path) -> None:
    pixels = RNG.integers(0, 65535, (6, 8, 3)).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "c.png"), pixels[:, :, ::-1])  # OpenCV writes blue first
    image = read_image(tmp_path / "c.png")
    np.testing.assert_array_equal(image.pixels, pixels)
    assert image.full_scale_dn == 65535.0


@pytest.mark.parametrize("mode", ["1", "L", "P", "RGB", "RGBA", "CMYK", "I;16"])
def test_what_pillow_opens_is_read(tmp_path: Path, mode: str) -> None:
    grey = Image.fromarray(RNG.integers(0, 255, (12, 10)).astype(np.uint8))
    if mode == "I;16":
        picture = Image.fromarray(RNG.integers(0, 4000, (12, 10)).astype(np.uint16))
    else:
        picture = grey.convert(mode)
    name = "i.tif" if mode == "CMYK" else "i.png"
    picture.save(tmp_path / name)
    assert read_image(tmp_path / name).pixels.shape[:2] == (12, 10)


def test_the_first_page_of_a_capture_is_the_image(tmp_path: Path) -> None:
    pages = RNG.normal(size=(2, 8, 9)).astype(np.float32)
    tifffile.imwrite(tmp_path / "c.tif", pages, imagej=True, metadata={"axes": "ZYX"})
    np.testing.assert_array_equal(read_image(tmp_path / "c.tif").pixels, pages[0])


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
        message = f"i.dat {image.pixels.shape}"
        assert image.pixels.ndim in (2, 3)
    assert "i.dat" in message
    assert "\n" not in message


def test_a_failed_write_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "o.tif"
    write_float_tiff(path, np.zeros((4, 5), np.float32), "first")
    before = path.read_bytes()

    def full_disk(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.fsync", full_disk)
    with pytest.raises(ImageFileError) as refused:
        write_float_tiff(path, np.ones((4, 5), np.float32), "second")
    assert isinstance(refused.value.__cause__, OSError)
    assert refused.value.__cause__.errno == errno.ENOSPC
    assert path.read_bytes() == before
    assert sorted(tmp_path.iterdir()) == [path]


def test_an_opacity_plane_is_no_light_and_odd_types_are_read_as_numbers(tmp_path: Path) -> None:
    grey = RNG.integers(0, 200, (12, 10)).astype(np.uint8)
    Image.fromarray(np.dstack([grey, np.full_like(grey, 7)]), "LA").save(tmp_path / "la.png")
    np.testing.assert_array_equal(read_grey(tmp_path / "la.png"), grey)
    colour = np.dstack([grey] * 3 + [np.full_like(grey, 7)])
    Image.fromarray(colour, "RGBA").save(tmp_path / "rgba.png")
    np.testing.assert_array_equal(read_image(tmp_path / "rgba.png").colour_planes, colour[..., :3])
    wide = grey.astype(np.uint32) * 1000
    tifffile.imwrite(tmp_path / "wide.tif", wide)
    assert read_image(tmp_path / "wide.tif").colour_planes.dtype == np.float64
    np.testing.assert_array_equal(read_grey(tmp_path / "wide.tif"), wide)
    one_plane = read_image(tmp_path / "la.png")
    tifffile.imwrite(tmp_path / "one.tif", grey[:, :, None], photometric="minisblack")
    np.testing.assert_array_equal(read_grey(tmp_path / "one.tif"), grey)
    assert not one_plane.is_colour


def test_a_mask_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(ImageFileError) as refused:
        write_mask(tmp_path / "nowhere" / "m.png", np.ones((4, 5), np.bool_))
    assert str(tmp_path / "nowhere" / "m.png") in str(refused.value)
