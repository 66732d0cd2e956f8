"""A photograph coded as another file is has exactly what that file would hold."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from acquisition.photographs import read_image
from tests.shipped import shipped


def saved(path: Path, name: str, **how: Any) -> Path:
    Image.fromarray(shipped(name)[:200, :240].astype(np.uint8)).save(path, **how)
    return path


@pytest.mark.parametrize("name", ["astronaut", "camera"])
@pytest.mark.parametrize("quality", [60, 75, 90, 98])
@pytest.mark.parametrize("subsampling", [0, 1, 2])
def test_a_png_coded_as_its_jpeg_is_that_jpeg(
    tmp_path: Path, name: str, quality: int, subsampling: int
) -> None:
    png = read_image(saved(tmp_path / "a.png", name))
    how = {"subsampling": subsampling} if name == "astronaut" else {}
    jpeg = read_image(saved(tmp_path / "a.jpg", name, quality=quality, **how))
    assert np.array_equal(png.coded_as(jpeg).stored, jpeg.stored)
    assert not np.array_equal(png.stored, jpeg.stored)


def test_the_coarser_file_stays_as_it_is(tmp_path: Path) -> None:
    fine, coarse = (
        read_image(saved(tmp_path / f"{quality}.jpg", "astronaut", quality=quality))
        for quality in (95, 75)
    )
    assert coarse.coded_as(fine) is coarse
    assert fine.coded_as(coarse) is not fine
    assert fine.coded_as(fine) is fine


def test_levels_of_another_kind_are_not_coded(tmp_path: Path) -> None:
    jpeg = read_image(saved(tmp_path / "a.jpg", "astronaut", quality=75))
    grey = read_image(saved(tmp_path / "grey.png", "camera"))
    deep = tmp_path / "deep.png"
    Image.fromarray(shipped("camera").astype(np.uint16) * 257).save(deep)
    for other in (grey, read_image(deep)):
        assert other.coded_as(jpeg) is other
        assert jpeg.coded_as(other) is jpeg


def test_a_step_in_grey_is_that_of_the_channels_in_their_luma(tmp_path: Path) -> None:
    # A grey of 188 in sRGB: its next level is 1.7 levels of linear light further on.
    Image.fromarray(np.full((20, 30), 188, dtype=np.uint8)).save(tmp_path / "grey.png")
    grey = read_image(tmp_path / "grey.png").file_steps.step_dn
    assert grey is not None
    by_hand = (
        255 * (((189 / 255 + 0.055) / 1.055) ** 2.4 - ((187 / 255 + 0.055) / 1.055) ** 2.4) / 2
    )
    np.testing.assert_allclose(grey, by_hand, rtol=1e-4)
    Image.fromarray(np.full((20, 30, 3), 188, dtype=np.uint8)).save(tmp_path / "colour.png")
    colour = read_image(tmp_path / "colour.png").file_steps.step_dn
    assert colour is not None
    weights = np.sqrt(0.299**2 + 0.587**2 + 0.114**2)
    np.testing.assert_allclose(colour, weights * by_hand, rtol=1e-4)
