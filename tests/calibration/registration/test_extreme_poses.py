"""Poses at which the photographs share little: from far nearer, and from very different sides."""

from functools import cache

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from calibration.errors import RegistrationError
from calibration.registration import Registration, RegistrationHints, register_images
from simulation.arrays import FloatArray

TILT = 2.2
"""Foreshortening of each photograph, of the one across the other: 4.8 between them."""


@cache
def scene(seed: int, side_px: int) -> FloatArray:
    """Blobs of many sizes."""
    rng = np.random.default_rng(seed)
    made = sum(
        gaussian_filter(rng.normal(size=(side_px, side_px)), sigma, mode="wrap") * sigma**1.2
        for sigma in (1.5, 3.0, 6.0, 12.0, 24.0)
    )
    levels = np.clip(128 + 55 * made / np.std(made), 0, 255)
    levels.setflags(write=False)
    return np.asarray(levels)


def about_middle(
    scale_x: float, scale_y: float, side_px: int, shape: tuple[int, int]
) -> FloatArray:
    """Photograph pixel ``(x, y, 1)`` to scene pixel, both about their middles."""
    rows, cols = shape
    middle = (side_px - 1) / 2
    return np.array(
        [
            [scale_x, 0, middle - scale_x * (cols - 1) / 2],
            [0, scale_y, middle - scale_y * (rows - 1) / 2],
            [0, 0, 1.0],
        ]
    )


def photograph(
    levels: FloatArray, to_scene: FloatArray, seed: int, shape: tuple[int, int]
) -> FloatArray:
    """The scene, averaged over each pixel along both axes, with noise of 1.5 DN in 8 bits."""
    steps_px = to_scene[0, 0], to_scene[1, 1]
    blurred = cv2.GaussianBlur(levels, (0, 0), 0.6 * steps_px[0], sigmaY=0.6 * steps_px[1])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    made = cv2.warpPerspective(blurred, to_scene, shape[::-1], flags=flags)
    noise = np.random.default_rng(seed).normal(0, 1.5, shape)
    return np.rint(np.clip(made + noise, 0, 255))


def error_px(found: Registration, true: FloatArray) -> float:
    """Largest error over the overlap, in reference px."""
    rows, cols = found.pose.followup_shape
    y, x = np.mgrid[0:rows:8, 0:cols:8].astype(np.float64)
    true_x, true_y = true[0, 0] * x + true[0, 2], true[1, 1] * y + true[1, 2]
    shared = (true_x >= 0) & (true_x <= cols - 1) & (true_y >= 0) & (true_y <= rows - 1)
    at_y, at_x = found.pose.to_reference_px(y[shared], x[shared])
    return float(np.hypot(at_x - true_x[shared], at_y - true_y[shared]).max())


def seen_from_aside(seeds: tuple[int, int]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Reference foreshortened along x, follow-up along y, and the pose if the scene is one."""
    side_px, shape = 430, (120, 160)
    near, far = about_middle(TILT, 1.0, side_px, shape), about_middle(1.0, TILT, side_px, shape)
    return (
        photograph(scene(seeds[0], side_px), near, 1, shape),
        photograph(scene(seeds[1], side_px), far, 2, shape),
        np.asarray(np.linalg.inv(near) @ far),
    )


@pytest.mark.slow
def test_photographs_from_opposite_sides_are_aligned() -> None:
    reference, followup, true = seen_from_aside((3, 3))
    found = register_images(reference, followup, hints=RegistrationHints(zoom=1.1))
    assert error_px(found, true) < 0.3  # a tenth of the blur of the foreshortened axis


@pytest.mark.slow
def test_different_scenes_from_opposite_sides_are_refused() -> None:
    reference, followup, _ = seen_from_aside((3, 4))
    with pytest.raises(RegistrationError) as refused:
        register_images(reference, followup)
    assert refused.value.reason in ("low_correlation", "little_overlap")


@pytest.mark.slow
@pytest.mark.parametrize("is_nearer_second", [False, True])
def test_a_photograph_from_seven_times_nearer_is_aligned(is_nearer_second: bool) -> None:
    side_px, zoom, shape = 1680, 7.0, (180, 240)
    to_near, to_far = (about_middle(scale, scale, side_px, shape) for scale in (1.0, zoom))
    near = photograph(scene(5, side_px), to_near, 1, shape)
    far = photograph(scene(5, side_px), to_far, 2, shape)
    true = np.asarray(np.linalg.inv(to_near) @ to_far)
    if is_nearer_second:
        near, far, true = far, near, np.asarray(np.linalg.inv(true))
    found = register_images(near, far)
    # A tenth of a pixel of the further photograph.
    assert error_px(found, true) < (0.1 if is_nearer_second else 0.1 * zoom)
