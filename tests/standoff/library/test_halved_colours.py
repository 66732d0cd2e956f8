"""Photographs of which one or both are JPEGs with half the pixels for colours, from two poses.

Nearly every JPEG of a camera or phone is one; what is compared with it may be a PNG or a TIFF.
"""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from skimage import data

import standoff

SIDE = 360
POSE = np.array([[1.01, 0.01, 3.0], [-0.012, 1.008, -2.0], [1e-5, -5e-6, 1.0]])
PLACES = ((70.0, 60.0), (290.0, 90.0), (180.0, 300.0))
"""Where a colour changes, its luma unchanged."""


def photographed(scene: NDArray[np.float64], seed: int) -> NDArray[np.uint8]:
    noise = np.random.default_rng(seed).normal(0, 2, scene.shape)
    return np.clip(np.rint(scene + noise), 0, 255).astype(np.uint8)


def saved(folder: Path, is_changed: bool) -> None:
    part = data.astronaut()[:300, :300]  # type: ignore[no-untyped-call]
    scene = cv2.resize(part, (SIDE, SIDE), interpolation=cv2.INTER_CUBIC)
    before = scene.astype(np.float64)
    after = before.copy()
    if is_changed:
        rows, cols = np.mgrid[:SIDE, :SIDE]
        for x, y in PLACES:
            spot = np.exp(-((cols - x) ** 2 + (rows - y) ** 2) / (2 * 3.0**2))
            after += spot[:, :, np.newaxis] * np.array([25.0, -12.7, 0.0])
    seen: NDArray[np.float64] = np.asarray(
        cv2.warpPerspective(
            after, POSE, (SIDE, SIDE), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
        ),
        dtype=np.float64,
    )
    for name, picture in {
        "before": photographed(before, 1),
        "after": photographed(seen, 2),
    }.items():
        image = Image.fromarray(picture)
        image.save(folder / f"{name}.png")
        image.save(folder / f"{name}.jpg", quality=97)  # 4:2:0, as usual


@pytest.mark.slow
@pytest.mark.parametrize("names", [("before.png", "after.jpg"), ("before.jpg", "after.jpg")])
def test_outlines_of_colours_are_no_changes(names: tuple[str, str], tmp_path: Path) -> None:
    """71 of 73 entries were colours at outlines, of a JPEG after a PNG where nothing changed."""
    saved(tmp_path, is_changed=False)
    found = standoff.find_changes(*(tmp_path / name for name in names))
    assert sum(change.what == "colour" for change in found.summary.changes) <= 1


@pytest.mark.slow
def test_a_colour_that_changed_is_found_all_the_same(tmp_path: Path) -> None:
    saved(tmp_path, is_changed=True)
    found = standoff.find_changes(tmp_path / "before.png", tmp_path / "after.jpg")
    true = cv2.perspectiveTransform(np.array([PLACES]), POSE)[0]
    for x, y in true:
        assert any(np.hypot(each.x_px - x, each.y_px - y) < 4 for each in found.summary.changes)
