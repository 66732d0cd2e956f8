"""The levels of a file as they were stored, its clipping, and the variance of its steps."""

from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile
from scipy.ndimage import gaussian_filter

import standoff
from acquisition.photographs import (
    LINEAR,
    CodedSteps,
    ReadOptions,
    photograph_of,
    read_photograph,
)
from acquisition.photographs._encoding import REC601_LUMA
from simulation.arrays import FloatArray
from standoff.errors import ImageFileError

SHAPE = (128, 160, 3)


def scene() -> np.ndarray:
    """Smooth colours with a little noise, in levels of 8 bits before they are rounded."""
    rng = np.random.default_rng(20)
    colours = gaussian_filter(rng.normal(size=SHAPE), (9, 9, 0)) * 400
    colours += gaussian_filter(rng.normal(size=SHAPE[:2]), 9)[..., np.newaxis] * 800 + 120
    return np.clip(colours + rng.normal(size=SHAPE), 5, 250)


def test_of_a_linear_colour_file_it_is_a_twelfth_of_each_channel_s_share(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.rint(scene()).astype(np.uint8))
    found = read_photograph(path, standoff.reading(encoding="linear")).file_steps.variance_dn2
    assert found is not None
    assert found.shape == SHAPE[:2]
    assert found == pytest.approx(np.square(REC601_LUMA).sum() / 12, rel=1e-6)


def test_of_an_srgb_file_it_is_what_rounding_did(tmp_path: Path) -> None:
    exact, path = scene(), tmp_path / "a.png"
    cv2.imwrite(str(path), np.rint(exact).astype(np.uint8)[..., ::-1])
    photograph = read_photograph(path, standoff.reading(encoding="srgb"))
    code = exact / 255
    light = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4) * 255
    errors = photograph.grey_dn - light @ np.asarray(REC601_LUMA)
    found = photograph.file_steps.variance_dn2
    assert found is not None
    # Of 20 480 independent errors the mean square is within 3 %, at three standard errors.
    assert float(np.mean(found)) == pytest.approx(float(np.mean(errors**2)), rel=0.05)


@pytest.mark.parametrize("quality", [75, 90, 98])
def test_a_jpeg_file_s_error_is_within_it_once_smoothed(tmp_path: Path, quality: int) -> None:
    plain, path = np.rint(scene()).astype(np.uint8), tmp_path / "a.jpg"
    cv2.imwrite(
        str(path),
        plain,
        [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, 0x111111],
    )
    photograph = read_photograph(path, standoff.reading(encoding="linear"))
    luma = np.asarray(REC601_LUMA)
    error = gaussian_filter(photograph.grey_dn - plain[..., ::-1] @ luma, 1.0)
    found = photograph.file_steps.variance_dn2
    assert found is not None
    gain = 1 / (4 * np.pi)  # of white noise by a Gaussian of 1 px
    assert float(np.mean(error**2)) <= 1.2 * gain * float(np.mean(found))


def test_floating_point_levels_have_none() -> None:
    assert photograph_of(scene().astype(np.float32), "a").file_steps.variance_dn2 is None


@pytest.mark.parametrize("quality", [75, 90, 98])
@pytest.mark.parametrize("sampling", [0, 1, 2])
def test_a_channel_s_error_is_within_what_luma_and_chroma_lose(
    tmp_path: Path, quality: int, sampling: int
) -> None:
    plain, path = np.rint(scene()).astype(np.uint8), tmp_path / "a.jpg"
    Image.fromarray(plain).save(path, quality=quality, subsampling=sampling)
    photograph = read_photograph(path, standoff.reading(encoding="linear"))
    found, luma = photograph.file_steps.channel_variance_dn2, photograph.file_steps.variance_dn2
    assert found is not None
    assert luma is not None
    error = gaussian_filter(photograph.stored - plain.astype(np.float64), (1.0, 1.0, 0.0))
    gain = 1 / (4 * np.pi)  # of white noise by a Gaussian of 1 px
    for channel in range(3):
        # Chroma of half the columns loses the finest noise of the scene as well: 1.26 at most.
        assert np.mean(error[..., channel] ** 2) <= 1.3 * gain * found[..., channel].mean()
    assert found[..., 2].mean() > luma.mean()


@pytest.mark.parametrize("quality", [75, 90, 98])
@pytest.mark.parametrize("sampling", [0, 1, 2])
@pytest.mark.parametrize("channel", [0, 2])
def test_what_a_channel_s_error_has_beside_the_luma_s_is_its_chroma_s(
    tmp_path: Path, quality: int, sampling: int, channel: int
) -> None:
    plain, path = np.rint(scene()).astype(np.uint8), tmp_path / "a.jpg"
    Image.fromarray(plain).save(path, quality=quality, subsampling=sampling)
    photograph = read_photograph(path, standoff.reading(encoding="linear"))
    covariance = photograph.file_steps.channel_covariance
    assert covariance is not None
    beside = np.eye(3)[channel] - np.asarray(REC601_LUMA)
    error = gaussian_filter(photograph.stored - plain.astype(np.float64), (1.0, 1.0, 0.0))
    gain = 1 / (4 * np.pi)  # of white noise by a Gaussian of 1 px
    expected = float(beside @ covariance @ beside)
    assert np.mean((error @ beside) ** 2) <= 1.3 * gain * expected  # as above
    assert expected < 1.2 * float(covariance[channel, channel])


@pytest.mark.parametrize("width_px", [1.0, 2.8, 11.3])
def test_equal_steps_are_white_behind_any_filter(width_px: float) -> None:
    step = 6.0
    coded = CodedSteps(
        luma=np.full((8, 8), step), chroma=np.full((8, 8), step), halved=(False, False)
    )
    # A coefficient's error is even over its step; luma and chroma are rounded before that.
    assert coded.variance(width_px) == pytest.approx((step**2 / 12 + 1 / 12,) * 2)


@pytest.mark.parametrize(("halved", "shared_px"), [((False, False), 1), ((True, True), 4)])
def test_a_wide_filter_sees_the_mean_of_the_blocks_alone(
    halved: tuple[bool, bool], shared_px: int
) -> None:
    steps = np.full((8, 8), 6.0)
    steps[0, 0] = 3.0
    coded = CodedSteps(luma=steps, chroma=steps, halved=halved)
    luma, chroma = coded.variance(100.0)
    assert luma == pytest.approx(9 / 12 + 1 / 12, rel=0.01)
    # Of halved chroma four pixels share one error.
    assert chroma == pytest.approx(shared_px * (9 / 12 + 1 / 12), rel=0.01)


@pytest.mark.parametrize("width_px", [1.0, 2.0, 2.8, 5.7, 11.3])
@pytest.mark.parametrize("sampling", ["4:4:4", "4:2:0"])
def test_of_strong_noise_chroma_loses_what_its_steps_say(sampling: str, width_px: float) -> None:
    """Against Pillow's coder: steps of 1 with the same sampling lose nothing beside these."""
    levels = np.random.default_rng(17).normal(128, 30, (800, 800, 3)).clip(0, 255).astype(np.uint8)

    def coded(**how: Any) -> tuple[FloatArray, FloatArray]:
        file = BytesIO()
        Image.fromarray(levels).save(file, "JPEG", subsampling=sampling, **how)
        image = Image.open(file)
        assert isinstance(image, JpegImageFile)
        image.draft("YCbCr", image.size)
        steps = np.reshape(image.quantization[1], (8, 8)).astype(np.float64)
        return np.asarray(image, dtype=np.float64)[..., 1], steps

    chroma, steps = coded(quality=90)
    error = chroma - coded(qtables=[[1] * 64] * 2)[0]
    filtered = gaussian_filter(error - error.mean(), width_px, mode="wrap", truncate=6)
    halved = (sampling == "4:2:0",) * 2
    _, expected = CodedSteps(luma=steps, chroma=steps, halved=halved).variance(width_px)
    measured = 4 * np.pi * width_px**2 * filtered.var()
    assert measured == pytest.approx(expected, rel=0.2)


def test_a_png_has_the_steps_of_each_channel(tmp_path: Path) -> None:
    levels = np.random.default_rng(6).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    Image.fromarray(levels).save(tmp_path / "a.png")
    photograph = read_photograph(tmp_path / "a.png", standoff.reading(encoding="linear"))
    found = photograph.file_steps
    assert found.channel_variance_dn2 is not None
    assert np.allclose(found.channel_variance_dn2, 1 / 12)
    assert found.channel_covariance is not None
    assert np.allclose(found.channel_covariance, np.eye(3) / 12)
    assert found.coded is None
    assert read_photograph(tmp_path / "a.png").file_steps.channel_step_dn is not None
    assert photograph_of(levels[..., 0], "a").file_steps.channel_step_dn is None


RNG = np.random.default_rng(0)
AS_LINEAR = ReadOptions(encoding=LINEAR)


def read_grey(path: Path) -> FloatArray:
    return read_photograph(path, AS_LINEAR).grey_dn


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("shape", [(7, 9), (7, 9, 3)])
def test_a_tiff_comes_back_as_it_was_written(
    tmp_path: Path, dtype: type, shape: tuple[int, ...]
) -> None:
    pixels: NDArray[Any] = RNG.integers(0, 255, shape).astype(dtype)
    photometric = "rgb" if len(shape) == 3 else "minisblack"
    tifffile.imwrite(tmp_path / "i.tif", pixels, photometric=photometric)
    image = read_photograph(tmp_path / "i.tif")
    np.testing.assert_array_equal(image.stored, pixels)
    assert image.is_colour is (len(shape) == 3)


def test_colours_stored_plane_by_plane_come_last(tmp_path: Path) -> None:
    planes = RNG.integers(0, 255, (3, 20, 30)).astype(np.uint8)
    tifffile.imwrite(
        tmp_path / "p.tif", planes, photometric="rgb", planarconfig="separate", metadata=None
    )
    np.testing.assert_array_equal(
        read_photograph(tmp_path / "p.tif").stored, np.moveaxis(planes, 0, -1)
    )


def test_sixteen_bit_colour_png_keeps_its_bits_and_its_order(tmp_path: Path) -> None:
    pixels = RNG.integers(0, 65535, (6, 8, 3)).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "c.png"), pixels[:, :, ::-1])  # OpenCV writes blue first
    image = read_photograph(tmp_path / "c.png")
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
    assert read_photograph(tmp_path / "i.png").stored.shape[:2] == (12, 10)


def test_a_12_bit_plateau_in_16_bits_is_saturation(tmp_path: Path) -> None:
    pixels = np.full((40, 40), 900, np.uint16)
    pixels[:, 20:] = 4095
    tifffile.imwrite(tmp_path / "i.tif", pixels)
    assert read_photograph(tmp_path / "i.tif").saturation_dn == 4095.0
    pixels[:, 20:] = 4000
    tifffile.imwrite(tmp_path / "i.tif", pixels)
    assert read_photograph(tmp_path / "i.tif").saturation_dn == 65535.0


def test_float_files_have_no_saturation(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "i.tif", np.ones((4, 5), np.float32))
    assert read_photograph(tmp_path / "i.tif").saturation_dn is None


def test_a_jpeg_is_known_by_its_bytes_not_its_name(tmp_path: Path) -> None:
    Image.new("L", (16, 16), 90).save(tmp_path / "photo.png", format="JPEG")
    assert read_photograph(tmp_path / "photo.png").is_jpeg


def _samples() -> list[bytes]:
    samples = []
    for extension in (".tif", ".png", ".jpg"):
        pixels = RNG.integers(0, 255, (20, 24)).astype(np.uint8)
        samples.append(cv2.imencode(extension, pixels)[1].tobytes())
    return samples


SAMPLES = _samples()


@pytest.mark.slow
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
        image = read_photograph(path)
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
        read_photograph(tmp_path / "rgba.png", AS_LINEAR).colour_planes, colour[..., :3]
    )
    wide = grey.astype(np.uint32) * 1000
    tifffile.imwrite(tmp_path / "wide.tif", wide)
    assert read_photograph(tmp_path / "wide.tif").colour_planes.dtype == np.float64
    np.testing.assert_array_equal(read_grey(tmp_path / "wide.tif"), wide)
    one_plane = read_photograph(tmp_path / "la.png")
    tifffile.imwrite(tmp_path / "one.tif", grey[:, :, None], photometric="minisblack")
    np.testing.assert_array_equal(read_grey(tmp_path / "one.tif"), grey)
    assert not one_plane.is_colour


def test_a_session_in_the_place_of_a_photograph_is_named(tmp_path: Path) -> None:
    (tmp_path / "journal.jsonl").write_text("{}\n")
    with pytest.raises(ImageFileError, match="is a capture session, not a photograph"):
        read_photograph(tmp_path)
