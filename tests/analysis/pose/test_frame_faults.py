"""What of a frame costs changes, on pictures whose faults are made here."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, shift

from analysis.pose import FrameFaults, frame_faults

ROWS, COLS = 240, 320
SAME = np.eye(3)


def scene(seed: int = 0) -> NDArray[np.uint8]:
    noise = np.random.default_rng(seed).standard_normal((ROWS, COLS))
    texture = gaussian_filter(noise, 2.5) * 8 + gaussian_filter(noise, 12) * 30
    return np.clip(120 + 25 * texture, 0, 245).astype(np.uint8)


def faults(frame: NDArray[np.uint8], matrix: NDArray[np.float64] = SAME) -> FrameFaults:
    found = frame_faults(frame, scene(), matrix)
    assert found is not None
    return found


def test_a_frame_that_is_the_reference_has_no_fault() -> None:
    found = faults(scene())
    assert found.sharpness == pytest.approx(1)
    assert found.agreement == pytest.approx(1)
    assert found.glare == 0
    assert found.is_same_scene
    assert max(found.costs().values()) <= 1


def test_a_frame_at_its_pose_has_no_fault_and_beside_it_is_no_longer_the_scene() -> None:
    moved = np.rint(shift(scene().astype(float), (0, 12), mode="nearest")).astype(np.uint8)
    at_its_pose = np.array([[1.0, 0, -12], [0, 1, 0], [0, 0, 1]])
    assert faults(moved, at_its_pose).agreement > 0.95
    assert not faults(moved).is_same_scene


def test_blur_costs_sharpness_and_not_the_scene() -> None:
    blurred = [
        faults(np.rint(gaussian_filter(scene().astype(float), width)).astype(np.uint8))
        for width in (0.5, 2.0, 4.0)
    ]
    sharpness = [one.sharpness for one in blurred]
    assert sharpness == sorted(sharpness, reverse=True)
    assert blurred[0].costs()["sharpness"] < 1 < blurred[2].costs()["sharpness"]
    assert all(one.is_same_scene for one in blurred)


def test_other_light_is_no_fault_until_it_is_dark() -> None:
    dimmer = (0.5 * scene()).astype(np.uint8)
    assert faults(dimmer).sharpness == pytest.approx(1, abs=0.1)
    assert max(faults(dimmer).costs().values()) <= 1
    dark = (0.1 * scene()).astype(np.uint8)
    assert faults(dark).costs()["light"] > 1


def test_glare_is_the_share_that_is_white_and_was_not() -> None:
    glaring = scene()
    glaring[100:148, 100:164] = 255
    # 48 x 64 px; within the border left out, 14 px each side.
    expected = 48 * 64 / ((ROWS - 14) * (COLS - 14))
    assert faults(glaring).glare == pytest.approx(expected, rel=0.05)
    assert faults(glaring).costs()["glare"] > 1


@pytest.mark.parametrize("seed", range(1, 6))
def test_another_scene_does_not_agree(seed: int) -> None:
    assert abs(faults(scene(seed)).agreement) < 0.2
    assert not faults(scene(seed)).is_same_scene


def test_of_a_frame_that_shows_little_of_the_reference_nothing_is_said() -> None:
    aside = np.array([[1.0, 0, 0.9 * COLS], [0, 1, 0], [0, 0, 1]])
    assert frame_faults(scene(), scene(), aside) is None
