"""Photographs in colour go through as such: shown in colours, judged by their luma."""

import re
from base64 import b64decode
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

import standoff
from acquisition.photographs import LINEAR, ReadOptions, luma_plane
from analysis.errors import RefusedPhotographError
from simulation.arrays import FloatArray
from standoff.library.evaluation.evaluate import later_scene
from standoff.library.swept_photographs import colour_scene_image
from tests.standoff.changed_photographs import changed_pair

HUE = np.array([1.4, 0.9, 0.6])
"""An orange light."""


@pytest.fixture(scope="module")
def pair() -> tuple[FloatArray, FloatArray]:
    made = changed_pair(2, 25.0)
    return made.reference[:, :, np.newaxis] * HUE, made.followup[:, :, np.newaxis] * HUE


def pictures(page: str) -> list[NDArray[Any]]:
    """The photographs of a page, as red, green and blue."""
    data = re.findall(r'class="picture"[^>]*href="data:image/jpeg;base64,([^"]+)"', page)
    return [
        np.asarray(cv2.imdecode(np.frombuffer(b64decode(one), np.uint8), cv2.IMREAD_COLOR))[
            ..., ::-1
        ].astype(float)
        for one in data
    ]


@pytest.mark.slow
def test_a_comparison_shows_both_photographs_in_their_colours(
    pair: tuple[FloatArray, FloatArray], tmp_path: Path
) -> None:
    found = standoff.find_changes(*pair)
    before, after, _ = pictures(found.page())
    for shown in (before, after):
        inner = shown[20:-20, 20:-20]
        # The light is orange everywhere: red above green above blue.
        assert np.median(inner[..., 0] - inner[..., 1]) > 15
        assert np.median(inner[..., 1] - inner[..., 2]) > 15
    drawn = found.plot().axes[0].images[0].get_array()
    assert drawn is not None
    assert drawn.ndim == 3
    grey = standoff.find_changes(luma_plane(pair[0]), pair[1])
    assert grey.colours is None  # of the two that are blinked, both are in colour or none
    before, after, _ = pictures(grey.page())
    assert np.abs(before[..., 0] - before[..., 2]).max() < 3
    assert np.abs(after[..., 0] - after[..., 2]).max() < 3


@pytest.mark.slow
def test_a_pose_is_judged_by_the_luma(pair: tuple[FloatArray, FloatArray]) -> None:
    task = standoff.DetectionTask(
        zooms=(1.0, 1.8), noises_dn=(1.5,), models=("matched",), observers=("npw",)
    )
    grey = [luma_plane(one) for one in pair]
    curves = standoff.d_prime_curves(grey[:1], standoff.GaussianPsf(0.9, 0.9), task)
    in_colour, in_grey = (standoff.judge_pose(near, far, curves, 1.0) for near, far in (pair, grey))
    found = [
        one.summary.model_dump(exclude={"provenance", "detection_limit"})
        for one in (in_colour, in_grey)
    ]
    assert found[0] == found[1]
    assert len(in_colour.plot().axes) == 3  # the photograph, d' on its luma, and the bar
    assert len(in_grey.plot().axes) == 2


def test_a_simulated_photograph_in_colour_is_drawn_in_its_colours() -> None:
    image = np.full((60, 80, 3), 100.0) * HUE
    far = standoff.simulate(image, zoom=1.5, psf=standoff.GaussianPsf(sigma_px=0.8))
    assert far.image.shape == (40, 53, 3)
    drawn = far.plot().axes[0].images[0].get_array()
    assert drawn is not None
    red, green, blue = np.asarray(drawn)[20, 25]
    assert red == pytest.approx(1.0, abs=1e-3)
    for level, share in ((green, HUE[1] / HUE[0]), (blue, HUE[2] / HUE[0])):
        assert level == pytest.approx(1.055 * share ** (1 / 2.4) - 0.055, abs=1e-3)


def test_a_patch_of_a_file_in_colour_has_its_colours(tmp_path: Path) -> None:
    stored = np.zeros((5, 6, 4), np.uint8)  # blue, green, red, alpha
    stored[...] = (10, 20, 200, 255)
    stored[0] = 0
    cv2.imwrite(str(tmp_path / "red.png"), stored)
    patch = standoff.patch_of(tmp_path / "red.png", ReadOptions(encoding=LINEAR))
    assert patch.levels_dn[3, 3].tolist() == [200.0, 20.0, 10.0]
    assert patch.alpha[:, 0].tolist() == [0.0, 1.0, 1.0, 1.0, 1.0]


def test_a_photograph_of_later_has_its_colours_and_its_mask_none(tmp_path: Path) -> None:
    for name in ("after", "masks"):
        (tmp_path / name).mkdir()
    colours = np.random.default_rng(0).uniform(0, 255, (20, 30, 3)).astype(np.float32)
    tifffile.imwrite(tmp_path / "after" / "a.tif", colours, photometric="rgb")
    mask = np.zeros((20, 30), np.uint8)
    mask[5, 6] = 255
    cv2.imwrite(str(tmp_path / "masks" / "a.png"), np.stack([mask] * 3, axis=2))
    folders = tmp_path / "after", tmp_path / "masks"
    later = later_scene(*folders, ReadOptions(), Path("a.png"))
    np.testing.assert_array_equal(later.after_dn, colours)
    assert np.argwhere(later.mask).tolist() == [[5, 6]]
    cv2.imwrite(str(tmp_path / "masks" / "a.png"), mask[:, :-1])
    with pytest.raises(RefusedPhotographError, match="29 x 20 px, the later photograph 30 x 20 px"):
        later_scene(*folders, ReadOptions(), Path("a.png"))


def test_a_grey_scene_has_no_colours(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "grey.tif", np.ones((20, 30), np.float32))
    assert colour_scene_image(ReadOptions(), tmp_path / "grey.tif").colours is None
