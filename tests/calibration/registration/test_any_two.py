"""Alignment of two photographs that nothing is known of, on scenes in closed form.

A scene is a sum of waves, photographed by points through any homography.
"""

from dataclasses import dataclass
from functools import cache
from math import pi

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from calibration.errors import RegistrationError
from calibration.registration import (
    DistortedPose,
    FeatureMatches,
    Registration,
    RegistrationHints,
    register_images,
)
from simulation.arrays import FloatArray

SMALL = (150, 200)


@dataclass(frozen=True)
class Waves:
    """Waves ``(x, y)`` in cycles per reference pixel, and their phases."""

    along_x: FloatArray
    along_y: FloatArray
    phase: FloatArray

    def seen(self, matrix: FloatArray, shape: tuple[int, int]) -> FloatArray:
        """Levels of mean 120 and standard deviation 25 where ``matrix`` puts the pixels."""
        x, y = placed(matrix, *pixels(shape))
        waves = zip(self.along_x, self.along_y, self.phase, strict=True)
        total = sum(np.cos(2 * pi * (u * x + v * y) + phase) for u, v, phase in waves)
        return np.asarray(120 + 25 * total / np.sqrt(len(self.phase) / 2))


def waves(seed: int, low: float, high: float) -> Waves:
    rng = np.random.default_rng(seed)
    frequency, direction = rng.uniform(low, high, 60), rng.uniform(0, 2 * pi, 60)
    return Waves(
        frequency * np.cos(direction), frequency * np.sin(direction), rng.uniform(0, 2 * pi, 60)
    )


def pixels(shape: tuple[int, int], step: int = 1) -> tuple[FloatArray, FloatArray]:
    y, x = np.mgrid[: shape[0] : step, : shape[1] : step].astype(np.float64)
    return x, y


def placed(matrix: FloatArray, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    u, v, w = np.tensordot(matrix, np.stack([x, y, np.ones_like(x)]), axes=1)
    return u / w, v / w


def middle(shape: tuple[int, int]) -> FloatArray:
    return np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])


def similarity(
    zoom: float, turn_deg: float, centres: tuple[FloatArray, FloatArray], slant: float = 0.0
) -> FloatArray:
    """Follow-up to reference: centre to centre, with a perspective of ``slant`` per px."""
    turn = np.deg2rad(turn_deg)
    linear = zoom * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    back, to, lean = np.eye(3), np.eye(3), np.eye(3)
    back[:2, 2], to[:2, 2] = -centres[0], centres[1]
    lean[2, :2] = slant, -slant / 2
    turned = np.eye(3)
    turned[:2, :2] = linear
    return np.asarray(to @ turned @ lean @ back)


def error_px(pose: DistortedPose, matrix: FloatArray) -> float:
    """Rms over the overlap, in px of the reference."""
    x, y = pixels(pose.followup_shape, 8)
    true_x, true_y = placed(matrix, x, y)
    found_y, found_x = pose.to_reference_px(y, x)
    rows, cols = pose.reference_shape
    inside = (true_x >= 0) & (true_x < cols) & (true_y >= 0) & (true_y < rows)
    return float(np.sqrt(np.mean(((found_x - true_x) ** 2 + (found_y - true_y) ** 2)[inside])))


@pytest.mark.slow
@given(
    zoom=st.floats(0.7, 1.5),
    turn_deg=st.floats(-180, 180),
    shift_px=st.tuples(st.floats(-20, 20), st.floats(-15, 15)),
    slant=st.floats(-5e-4, 5e-4),
)
@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_pose_is_found_and_inverted_by_swapping_the_photographs(
    zoom: float, turn_deg: float, shift_px: tuple[float, float], slant: float
) -> None:
    centres = middle(SMALL), middle(SMALL) + shift_px
    matrix = similarity(zoom, turn_deg, centres, slant)
    scene = waves(1, 0.01, 0.12)
    reference, followup = scene.seen(np.eye(3), SMALL), scene.seen(matrix, SMALL)
    forth, back = register_images(reference, followup), register_images(followup, reference)
    # Without noise: what the descent's last step and the interpolation of waves of 8 px leave.
    assert error_px(forth.pose, matrix) < 0.05
    assert error_px(back.pose.inverse(), matrix) < 0.05
    assert not forth.warnings


NEAR, FAR = (480, 640), (96, 128)
HARD = similarity(4.0, 70.0, (middle(FAR), middle(NEAR) + np.array([12.0, -6.0])))
RESCUED_PX = 2.0
"""Half a pixel of the follow-up, which is 4 in the reference; noise explains .8."""


@cache
def hard_pair() -> tuple[FloatArray, FloatArray]:
    """Noise of four times the contrast, from a distance beyond the range of the search."""
    scene, rng = waves(2, 0.01, 0.03), np.random.default_rng(2)
    near, far = scene.seen(np.eye(3), NEAR), scene.seen(HARD, FAR)
    return near + rng.normal(0, 110, near.shape), far + rng.normal(0, 110, far.shape)


def clicked() -> FeatureMatches:
    """Four pairs of points, each 2 px off."""
    followup = np.array([[20.0, 15], [110, 20], [100, 80], [25, 75]])
    reference = np.stack(placed(HARD, *followup.T), axis=1)
    return FeatureMatches(followup, reference + np.array([[2.0, 0], [0, -2], [-2, 0], [0, 2]]))


def shifted(matrix: FloatArray, by_px: float) -> FloatArray:
    made = matrix.copy()
    made[:2, 2] += by_px / np.sqrt(2)
    return made


@pytest.mark.slow
def test_without_a_hint_noise_of_four_times_the_contrast_is_refused() -> None:
    with pytest.raises(RegistrationError) as refused:
        register_images(*hard_pair())
    assert refused.value.reason == "low_correlation"


@pytest.mark.parametrize(
    "hints",
    [
        pytest.param(RegistrationHints(zoom=4.2), id="zoom", marks=pytest.mark.slow),
        pytest.param(RegistrationHints(matrix=shifted(HARD, 3.0)), id="matrix"),
        pytest.param(RegistrationHints(points=clicked()), id="points"),
    ],
)
def test_each_hint_rescues_the_pair(hints: RegistrationHints) -> None:
    found: Registration = register_images(*hard_pair(), hints=hints)
    assert error_px(found.pose, HARD) < RESCUED_PX
    assert not any("kept" in one for one in found.warnings)


def test_a_mask_rescues_a_scene_most_of_which_moves_with_the_camera() -> None:
    shape = (120, 160)
    scene, other = waves(5, 0.01, 0.12), waves(6, 0.01, 0.12)
    moved = similarity(1.0, 0.0, (np.zeros(2), np.array([13.0, 9.0])))
    reference, followup = scene.seen(np.eye(3), shape), scene.seen(moved, shape)
    covered = np.zeros(shape, dtype=np.bool_)
    covered[:, :95] = True
    for image in (reference, followup):
        image[covered] = other.seen(np.eye(3), shape)[covered]
    plain = register_images(reference, followup)
    masked = register_images(reference, followup, hints=RegistrationHints(left_out=covered))
    assert error_px(plain.pose, np.eye(3)) < 0.05
    assert error_px(masked.pose, moved) < 0.05


@pytest.mark.slow
def test_a_reflection_does_not_draw_the_pose_away_from_the_features() -> None:
    # Large soft shapes, three times as strong, move by 8 px against the scene's detail: the coarse
    # levels of the refinement follow them, by .7 px in the end.
    shape = (300, 400)
    detail, reflection = waves(2, 0.05, 0.12), waves(52, 0.003, 0.02)
    matrix, other = (
        similarity(1.1, 3.0, (middle(shape), middle(shape) + np.array([aside, 3.0])))
        for aside in (5.0, 13.0)
    )
    reference, followup = (
        detail.seen(own, shape) + 3 * reflection.seen(apart, shape)
        for own, apart in ((np.eye(3), np.eye(3)), (matrix, other))
    )
    found = register_images(reference, followup)
    assert error_px(found.pose, matrix) < 0.1
    assert any("matched features" in one for one in found.warnings)
