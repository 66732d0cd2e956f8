"""From JPEG files to the compression that the fit of an edge takes into account."""

from io import BytesIO
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from acquisition.photographs._encoding import LINEAR, SRGB
from acquisition.photographs._reader import ReadOptions, read_photograph
from calibration.edges import Region, edges_of_image
from calibration.noise import CorrectionMaps
from standoff.library.edges import Reading, edge_image
from tests.calibration import closed_form

SIGMA_PX = 0.9


def codes(light: NDArray[np.float64], seed: int) -> NDArray[np.uint8]:
    """8-bit sRGB codes of linear levels from 0 to 255, IEC 61966-2-1, with noise of one code."""
    unit = light / 255
    srgb = 255 * np.where(unit <= 0.0031308, 12.92 * unit, 1.055 * unit ** (1 / 2.4) - 0.055)
    noisy = srgb + np.random.default_rng(seed).normal(0.0, 1.0, light.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def edge_codes(seed: int = 0) -> NDArray[np.uint8]:
    clean = closed_form.edge_image(SIGMA_PX, 12.0, low_dn=20.0, high_dn=160.0, has_pixel=True)
    return codes(clean, seed)


def jpeg(pixels: NDArray[np.uint8], **options: object) -> bytes:
    file = BytesIO()
    Image.fromarray(pixels).save(file, "JPEG", **{"quality": 80, **options})
    return file.getvalue()


def grey_as_colour(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.repeat(pixels[:, :, np.newaxis], 3, axis=2)


def stored_table(data: bytes) -> NDArray[np.float64]:
    """The first table of a JPEG file, its zigzag (ITU-T T.81, figure A.6) walked step by step."""
    at = data.index(b"\xff\xdb") + 5
    table = np.empty((8, 8))
    row = col = 0
    for value in data[at : at + 64]:
        table[row, col] = value
        if (row + col) % 2 == 0:
            row, col = (row + 1, col) if col == 7 else (max(row - 1, 0), col + 1)
        else:
            row, col = (row, col + 1) if row == 7 else (row + 1, max(col - 1, 0))
    return table


@pytest.mark.slow
@pytest.mark.parametrize("quality", [75, 92])
@pytest.mark.parametrize("is_colour", [False, True])
@pytest.mark.parametrize("is_progressive", [False, True])
def test_the_steps_are_those_of_the_file(
    tmp_path: Path, quality: int, is_colour: bool, is_progressive: bool
) -> None:
    pixels = grey_as_colour(edge_codes()) if is_colour else edge_codes()
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_PROGRESSIVE, int(is_progressive)]
    data = cv2.imencode(".jpg", pixels, options)[1].tobytes()
    (tmp_path / "a.jpg").write_bytes(data)
    steps = read_photograph(tmp_path / "a.jpg").luma_steps
    assert steps is not None
    np.testing.assert_array_equal(steps, stored_table(data))
    assert not np.array_equal(steps, steps.T)  # else the order would not show


def test_colours_that_are_no_luma_have_no_steps(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(jpeg(grey_as_colour(edge_codes()), keep_rgb=True))
    found = read_photograph(tmp_path / "a.jpg")
    assert found.is_jpeg
    assert found.luma_steps is None


@pytest.mark.parametrize("encoding", [LINEAR, SRGB])
def test_the_level_of_a_code_is_the_one_it_is_read_as(tmp_path: Path, encoding: object) -> None:
    pixels = np.repeat(np.arange(256, dtype=np.uint8).reshape(16, 16), 8, axis=0).repeat(8, axis=1)
    (tmp_path / "a.jpg").write_bytes(jpeg(grey_as_colour(pixels), quality=100))
    photograph = read_photograph(tmp_path / "a.jpg", ReadOptions(encoding=encoding))  # type: ignore[arg-type]  # of two
    source = edge_image(photograph, Reading())
    assert source.compression is not None
    levels = source.compression.code_levels_dn
    # Each block is of one code, which quality 100 keeps to one code.
    near = np.abs(np.interp(source.image_dn, levels, np.arange(256.0)) - pixels)
    assert near.max() < 1.01


@pytest.mark.slow
@pytest.mark.parametrize("is_colour", [False, True])
def test_the_widths_from_jpeg_files_are_within_their_errors(
    tmp_path: Path, is_colour: bool
) -> None:
    errors = []
    for seed in range(8):
        pixels = grey_as_colour(edge_codes(seed)) if is_colour else edge_codes(seed)
        (tmp_path / "a.jpg").write_bytes(jpeg(pixels, subsampling=2 if is_colour else -1))
        found = edges_of_image(edge_image(read_photograph(tmp_path / "a.jpg"), Reading()))
        assert len(found) == 1
        assert found[0].optical_sigma_px is not None
        assert found[0].optical_sigma_err_px is not None
        errors.append((found[0].optical_sigma_px - SIGMA_PX) / found[0].optical_sigma_err_px)
    # Of 8 unit normals the RMS is below 1.81 999 times of 1000; without the steps it is 7.1.
    assert np.sqrt(np.mean(np.square(errors))) < 1.81


def test_a_region_of_a_jpeg_keeps_its_blocks_and_its_colours(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(jpeg(grey_as_colour(edge_codes())))
    source = edge_image(read_photograph(tmp_path / "a.jpg"), Reading())
    rows, cols = source.image_dn.shape
    region = Region(x_px=3, y_px=5, width_px=cols - 3, height_px=rows - 5)
    part = source.within(region)
    assert part.compression is not None
    assert (part.compression.first_row, part.compression.first_col) == (5, 3)
    assert part.colours_dn is not None
    assert part.colours_dn.shape[:2] == part.image_dn.shape
    whole, cut = edges_of_image(source), edges_of_image(source, region)
    assert cut[0].sigma_px == pytest.approx(whole[0].sigma_px, abs=2 * whole[0].sigma_err_px)


def test_a_coloured_edge_is_less_sure_than_a_grey_one(tmp_path: Path) -> None:
    pixels = grey_as_colour(edge_codes())
    pixels[:, :, 1:] //= 2
    errors = []
    for levels in (grey_as_colour(pixels[:, :, 0]), pixels):
        (tmp_path / "a.jpg").write_bytes(jpeg(levels, subsampling=0))
        found = edges_of_image(edge_image(read_photograph(tmp_path / "a.jpg"), Reading()))
        errors.append(max(found, key=lambda edge: edge.length_px).sigma_err_px)
    # Steps of 6.6 at quality 80: widths from decoded pixels are wrong by 5 of their own errors.
    assert errors[1] > 2 * errors[0]


def test_planes_that_were_not_compressed_as_they_are_have_no_steps(tmp_path: Path) -> None:
    (tmp_path / "a.jpg").write_bytes(jpeg(grey_as_colour(edge_codes())))
    assert (
        edge_image(read_photograph(tmp_path / "a.jpg"), Reading(channel="green")).compression
        is None
    )
    Image.fromarray(edge_codes()).save(tmp_path / "a.png")
    assert edge_image(read_photograph(tmp_path / "a.png"), Reading()).compression is None
    (tmp_path / "a.jpg").write_bytes(jpeg(edge_codes()))
    photograph = read_photograph(tmp_path / "a.jpg")
    shape = photograph.stored.shape
    maps = CorrectionMaps(
        dark_dn=np.zeros(shape, np.float32),
        response=np.ones(shape, np.float32),
        defects=np.zeros(shape, np.uint8),
        black_level_dn=0.0,
    )
    assert edge_image(photograph, Reading()).compression is not None
    assert edge_image(photograph, Reading(correction=maps)).compression is None
