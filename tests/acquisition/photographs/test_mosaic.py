"""A raw mosaic that was saved as a grey picture: told from photographs, prints and sensors."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from skimage import data

from acquisition.photographs._mosaic import seems_mosaic
from tests.acquisition.photographs.made import GREY_16, png, read, tiff

SIDE = 160
RNG = np.random.default_rng(3)


def scene(dark: float = 300.0, bright: float = 3000.0) -> NDArray[np.float64]:
    """A slanted edge with noise."""
    rows, cols = np.mgrid[:SIDE, :SIDE].astype(float)
    step = 0.5 * (1 + np.tanh((cols - SIDE / 2 + 0.1 * rows - 0.05 * SIDE) / 1.2))
    return np.asarray(dark + (bright - dark) * step + RNG.normal(0, 4, step.shape))


def mosaic(light: NDArray[np.float64], pattern: str, **gains: float) -> NDArray[np.uint16]:
    taken = {"R": 0.6, "G": 1.0, "B": 0.75} | gains
    cells = np.array([taken[colour] for colour in pattern]).reshape(2, 2)
    rows, cols = light.shape
    levels: NDArray[np.uint16] = np.rint(light * np.tile(cells, (rows // 2, cols // 2))).astype(
        np.uint16
    )
    return levels


@pytest.mark.parametrize("pattern", ["RGGB", "GRBG", "GBRG", "BGGR"])
def test_a_mosaic_saved_as_grey_is_named(pattern: str, tmp_path: Path) -> None:
    """Viewers of cameras save BayerRG8 as a grey picture "with a grid on it"."""
    light = scene()
    for file in (tiff(mosaic(light, pattern)), png(mosaic(light / 12, pattern).astype(np.uint8))):
        remarks = read(tmp_path, file).remarks.values()
        assert any("raw mosaic" in said and "--bayer" in said for said in remarks)


@pytest.mark.parametrize("name", ["camera", "coins", "moon", "page", "text", "brick", "grass"])
def test_photographs_are_none(name: str) -> None:
    assert not seems_mosaic(getattr(data, name)())


def test_what_is_regular_in_prints_and_sensors_is_none() -> None:
    light = scene()
    rows, cols = np.indices(light.shape)
    for regular in (
        light,
        light * (1 + 0.1 * (rows % 2)),  # a film of two half pictures
        light * (1 + 0.1 * (cols % 2)),  # two converters
        light + 400 * ((rows // 2 + cols // 2) % 2),  # a fine screen
        light + RNG.normal(0, 400, light.shape),
        GREY_16,
        gaussian_filter(RNG.normal(size=light.shape), 1.0) * 1000,
        np.zeros((64, 64)),
    ):
        assert not seems_mosaic(regular)
