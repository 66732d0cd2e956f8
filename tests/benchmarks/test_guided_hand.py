"""The hand that follows arrows: one approach that arrives, and what keeps it from arriving."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("starlette", reason="the console's extra is not installed")

from benchmarks.studies.guided_hand import (
    FOCAL_PER_SIDE,
    FRAME,
    approach,
    greens,
    pairs_of,
    reference_of,
    scene_levels,
)
from benchmarks.truth.hand_held import Hand, HandHabits, HeldPose, Wall

pytestmark = pytest.mark.slow(minutes=0.5)

STEADY = HandHabits(sway=0, sway_deg=0, tremor=0, tremor_deg=0, clumsiness=0)


def wall_of(name: str) -> Wall:
    return Wall.of(scene_levels(name), FRAME, FOCAL_PER_SIDE)


def test_a_hand_that_follows_the_arrows_arrives_and_another_scene_is_never_good(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng([7, 3])
    wall = wall_of("coffee")
    reference = reference_of(wall, tmp_path / "coffee.jpg", rng)
    run = approach(wall, reference, rng, period_s=0.25, age_s=0.25)
    assert run.is_guided
    assert not run.start.is_within(3, 2, 2)
    other = reference_of(wall_of("rocket"), tmp_path / "rocket.jpg", rng)
    pairs = pairs_of(run.frames, 8)
    assert greens(other, pairs, 0.25) == 0


def test_a_hand_that_does_not_move_is_not_guided(tmp_path: Path) -> None:
    rng = np.random.default_rng([7, 3])
    wall = wall_of("coffee")
    reference = reference_of(wall, tmp_path / "coffee.jpg", rng)
    numb = HandHabits(most_speed=0, most_deg_per_s=0)
    assert not approach(wall, reference, rng, period_s=2.0, age_s=0.25, habits=numb).is_guided


@pytest.mark.parametrize(
    ("arrow", "amount", "moved"),
    [
        ("right", 10.0, lambda pose: pose.centre[0] > 0.01),
        ("up", 10.0, lambda pose: pose.centre[1] < -0.01),
        ("nearer", 10.0, lambda pose: pose.centre[2] > 0.01),
        ("tilt right", 5.0, lambda pose: pose.axes[0, 2] > 0.01),
        ("tilt down", 5.0, lambda pose: pose.axes[1, 2] > 0.01),
        ("turn clockwise", 5.0, lambda pose: pose.axes[1, 0] > 0.01),
    ],
)
def test_an_arrow_moves_the_hand_its_way_and_not_before_it_reacts(
    arrow: str, amount: float, moved: object
) -> None:
    assert callable(moved)
    hand = Hand(HeldPose(), np.random.default_rng(1), 1.0, STEADY)
    hand.show([(arrow, amount)])
    early = hand.move(0.1)
    np.testing.assert_array_equal(early.centre, 0)
    for _ in range(200):
        pose = hand.move(0.005)
    assert moved(pose)


def test_the_wall_is_seen_where_the_camera_looks() -> None:
    levels = np.full((300, 400), 100.0)
    levels[140:160, 190:210] = 250  # in the middle
    wall = Wall.of(levels, (80, 60), 0.8)
    rng = np.random.default_rng(1)
    right = HeldPose(axes=Rotation.from_euler("y", 10, degrees=True).as_matrix())
    for pose, column in ((HeldPose(), 39.5), (right, 39.5 - 0.8 * 80 * np.tan(np.radians(10)))):
        seen = wall.seen([pose], rng).astype(float) - 180
        weight = np.clip(seen, 0, None).sum(axis=0)
        assert (weight * np.arange(80)).sum() / weight.sum() == pytest.approx(column, abs=1)
    assert wall.errors(right).tilt_deg == pytest.approx(10)
    assert wall.errors(HeldPose()).is_within(1e-9, 1e-9, 1e-4)
