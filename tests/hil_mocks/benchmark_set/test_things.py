"""The track of things: where things lie, what twins share, and pairs without a change."""

from io import BytesIO
from math import hypot

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import gaussian_filter

from hil_mocks.benchmark_set._documents import benchmark_tasks
from hil_mocks.benchmark_set._lenses import round_lens
from hil_mocks.benchmark_set._scenes import Pose, stream
from hil_mocks.benchmark_set._tasks import RenderedTask, View
from hil_mocks.benchmark_set._things import (
    LONE_KINDS,
    MOST_CHANGED,
    TWIN_KINDS,
    ColouredThing,
    StagedView,
    ThingsPair,
    drawn_fates,
    labels_of,
)

SHAPE = (90, 120)
POSE = Pose(reference_shape=SHAPE, followup_shape=SHAPE, zoom=1.1, roll_deg=3.0)


def tasks_of(size: str, kind: str) -> list[ThingsPair]:
    tasks = [one for one in benchmark_tasks(size, 1) if isinstance(one, ThingsPair)]
    return sorted((one for one in tasks if one.kind == kind), key=lambda one: one.name)


def levels(made: RenderedTask, of: str) -> NDArray[np.uint8]:
    return np.asarray(Image.open(BytesIO(made.files[made.task[of]])), np.uint8)


def test_every_kind_is_there_as_often_and_changed_pairs_have_a_twin() -> None:
    for kind in TWIN_KINDS:
        pairs = [one.pair for one in tasks_of("small", kind)]
        assert len(pairs) == 16
        assert all(pairs.count(pair) == 2 for pair in pairs)
        assert sum(one.is_changed for one in tasks_of("small", kind)) == 8
    for kind in LONE_KINDS:
        assert [one.is_changed for one in tasks_of("small", kind)] == [False] * 6
    assert {one.kind for one in benchmark_tasks("tiny", 1) if isinstance(one, ThingsPair)} >= set(
        LONE_KINDS
    )


def test_things_are_apart_within_both_frames_and_happen_as_they_say() -> None:
    for number in range(60):
        fates = drawn_fates(stream(number, "things"), POSE, is_ink=number % 2 == 0)
        happened = [one for one in fates if one.what is not None]
        assert 1 <= len(happened) <= MOST_CHANGED
        for fate in happened:
            assert (fate.before is None) == (fate.what == "new")
            assert (fate.after is None) == (fate.what == "gone")
            if fate.before is not None and fate.after is not None:
                away = hypot(fate.before.x_px - fate.after.x_px, fate.before.y_px - fate.after.y_px)
                assert (away > 0) == (fate.what == "moved")
                assert away == 0 or 4 <= away <= 60
            undone = fate.undone()
            assert undone.before == undone.after
            assert undone.what is None
        placed = [(one, number) for number, fate in enumerate(fates) for one in fate.shown]
        for thing, of in placed:
            assert thing.reach_px < thing.x_px < SHAPE[1] - thing.reach_px
            assert thing.reach_px < thing.y_px < SHAPE[0] - thing.reach_px
            for other, of_other in placed:
                if of != of_other:
                    away = hypot(thing.x_px - other.x_px, thing.y_px - other.y_px)
                    assert away > thing.reach_px + other.reach_px


def coin(**where: float) -> ColouredThing:
    known = {"x_px": 59.5, "y_px": 44.5, "shade": 0.9, "hue_deg": 30.0, **where}
    return ColouredThing(
        outline="coin",
        half_x_px=12.0,
        half_y_px=12.0,
        turn_deg=0.0,
        depth=1.0,
        texture_px=(0.0, 0.0),
        **known,
    )


def staged(*, is_ink: bool = False) -> StagedView:
    return StagedView(
        scene="texture-1",
        seed=1,
        lens=round_lens(0.6),
        pose=Pose(reference_shape=SHAPE, followup_shape=SHAPE),
        things_scene="tiles-1",
        is_ink=is_ink,
        wave_px=(150.0, 130.0),
        phase_deg=40.0,
    )


def test_a_coin_hides_the_scene_in_its_own_colour_and_leaves_the_rest_as_it_was() -> None:
    view = staged()
    bare = view.photographed([], is_followup=False)
    laid = view.photographed([coin()], is_followup=False)
    grey, cut_out = (
        View(scene=name, seed=1, lens=view.lens, pose=view.pose).reference_light()
        for name in ("texture-1", "tiles-1")
    )
    # The waves of the three channels add to nothing.
    np.testing.assert_allclose(bare.mean(axis=-1), grey, atol=1e-12)
    np.testing.assert_allclose(laid[:, :30], bare[:, :30], atol=1e-9)
    inner = np.s_[40:50, 55:65]
    np.testing.assert_allclose(laid[inner].mean(axis=-1), 0.9 * cut_out[inner], atol=1e-6)
    for channel, third_deg in enumerate((0.0, 120.0, 240.0)):
        tint = 1 + 0.4 * np.cos(np.radians(30.0 + third_deg))
        np.testing.assert_allclose(
            laid[inner][..., channel], 0.9 * tint * cut_out[inner], atol=1e-6
        )


def test_a_printed_thing_is_black_and_casts_no_shadow() -> None:
    view = staged(is_ink=True)
    printed = view.photographed([coin()], is_followup=False)
    assert printed.shape == (*SHAPE, 1)
    np.testing.assert_allclose(printed[40:50, 55:65], 0.04, atol=1e-6)


def test_labels_hold_the_pixels_of_a_thing_where_it_was_and_where_it_is() -> None:
    rng = stream(3, "things")
    fates = [one for one in drawn_fates(rng, POSE, is_ink=False) if one.what is not None]
    labels = labels_of(fates, POSE)
    for number, fate in enumerate(fates, 1):
        for thing in fate.shown:
            x, y, w = np.linalg.solve(POSE.matrix, [thing.x_px, thing.y_px, 1.0])
            assert labels[round(y / w), round(x / w)] == number
    assert set(np.unique(labels)) == set(range(len(fates) + 1))


@pytest.mark.slow
def test_a_pair_without_a_change_is_one_file_twice_its_mirror_image_or_has_other_noise() -> None:
    [same] = [one.rendered() for one in tasks_of("tiny", "same")]
    assert same.files[same.task["reference"]] == same.files[same.task["followup"]]
    [mirrored] = [one.rendered() for one in tasks_of("tiny", "mirrored")]
    assert mirrored.truth["mirrored"]
    assert not mirrored.truth["things"]
    followup = levels(mirrored, "followup").mean(axis=-1)
    reference = levels(mirrored, "reference").mean(axis=-1)
    as_it_is, turned_over = (
        np.corrcoef(gaussian_filter(reference, 5).ravel(), gaussian_filter(one, 5).ravel())[0, 1]
        for one in (followup, followup[:, ::-1])
    )
    assert turned_over > as_it_is


@pytest.mark.slow
def test_twins_differ_by_what_happened_and_scans_have_two_levels() -> None:
    tasks = {one.is_changed: one for one in tasks_of("small", "two-level")[:2]}
    made = {is_changed: task.rendered() for is_changed, task in tasks.items()}
    for each in made.values():
        for of in ("reference", "followup"):
            assert set(np.unique(levels(each, of))) == {0, 255}
    changed = made[True]
    labels = tifffile.imread(BytesIO(changed.files[changed.truth["labels"]]))
    what = [one["what"] for one in changed.truth["things"]]
    assert set(np.unique(labels)) == set(range(len(what) + 1))
    differs = levels(changed, "followup") != levels(made[False], "followup")
    beside = labels > 0
    # Elsewhere noise alone turns pixels at the outlines of letters.
    assert differs[beside].mean() > 5 * differs[~beside].mean()
