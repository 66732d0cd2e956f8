"""One entry for one thing, with what happened to it, and movements apart."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from analysis.changes import (
    ChangeOptions,
    ChangeSummary,
    change_table,
    changes_between,
    describe_least,
)
from analysis.changes._change_list import large_enough
from analysis.changes._comparison import Comparison
from analysis.changes._things import moved_apart
from calibration.registration import DistortedPose
from simulation.arrays import FloatArray
from tests.analysis.changes.compared_fields import (
    at_rest,
    change_at,
    comparison,
    regions_and_changes,
)
from tests.analysis.changes.test_movement import SD_DN, SHAPE, compared, moved_thing, waves
from tests.shipped import shipped

SAME = at_rest(SHAPE)
TWICE = at_rest(SHAPE, np.diag([0.5, 0.5, 1.0]))  # the follow-up twice as near
SHIFT = (1.5, -2.0)


def thing(*, is_on_followup: bool) -> Comparison:
    """A disc that moved by ``SHIFT`` on the grid, in levels that a tone curve halved."""
    images = compared(*moved_thing(waves(5, 8.0), waves(6, 12.0), SHIFT))
    difference = images.after_dn - images.before_dn
    made = comparison(2 * difference, 2 * SD_DN, is_on_followup=is_on_followup)
    return replace(
        made,
        target_dn=(images.after_dn if is_on_followup else images.before_dn).astype(np.float32),
        matched_scale=2.0 if is_on_followup else -2.0,
    )


@pytest.mark.parametrize(("is_on_followup", "pose", "zoom"), [(True, SAME, 1), (False, TWICE, 2)])
def test_the_shift_is_in_followup_pixels(
    is_on_followup: bool, pose: DistortedPose, zoom: int
) -> None:
    made = thing(is_on_followup=is_on_followup)
    regions, listed = regions_and_changes(made, pose, 5.0)
    apart = moved_apart(made, pose, regions, listed)
    assert len(listed) > 1
    assert apart.changes == ()
    (moved,) = apart.moved
    assert moved.is_moved
    assert moved.displacement_px == pytest.approx((zoom * SHIFT[1], zoom * SHIFT[0]), abs=0.3)
    assert moved.displacement_err_px is not None
    assert max(moved.displacement_err_px) < 0.3 * zoom
    assert moved.area_px == pytest.approx(sum(change.area_px for change in listed))
    assert moved.significance == listed[0].significance


@pytest.mark.slow
def test_moved_things_are_counted_only_if_asked_for() -> None:
    rng = np.random.default_rng(4)
    before, after = moved_thing(waves(5, 8.0), waves(6, 12.0), SHIFT)
    before = 100 + before + 0.5 * rng.standard_normal(SHAPE)
    after = 100 + after + 0.5 * rng.standard_normal(SHAPE)
    apart = changes_between(before, after, None, ChangeOptions(pose=SAME)).summary
    options = ChangeOptions(pose=SAME, count_moved=True)
    counted = changes_between(before, after, None, options).summary
    assert len(apart.moved) == 1
    assert counted.moved == ()
    assert set(counted.changes) == {*apart.changes, *apart.moved}


def ground() -> FloatArray:
    """A photograph of a plain ground: the sky and the coat of scikit-image's camera man."""
    return 100 + 6 * shipped("camera")[:260, :300]


def two(before: FloatArray, after: FloatArray, least_dn: float | None = None) -> ChangeSummary:
    rng = np.random.default_rng(8)
    first, second = (one + rng.normal(0, 6, one.shape) for one in (before, after))
    return changes_between(first, second, options=ChangeOptions(least_dn=least_dn)).summary


def with_thing(image: FloatArray, top: int, left: int) -> FloatArray:
    """A thing of a bright and a dark half, cut out of another photograph."""
    made = image.copy()
    piece = shipped("coins")[30:58, 40:70]
    made[top : top + 28, left : left + 30] = 100 + 9 * piece
    return made


@pytest.mark.slow
@pytest.mark.parametrize("is_new", [True, False])
def test_a_thing_of_bright_and_dark_parts_is_one_entry(is_new: bool) -> None:
    plain, thing = ground(), with_thing(ground(), 40, 200)
    found = two(plain, thing) if is_new else two(thing, plain)
    assert len(found.changes) == 1
    (one,) = found.changes
    assert one.what == ("new" if is_new else "gone")
    assert one.x_px == pytest.approx(214.5, abs=4)
    assert one.y_px == pytest.approx(53.5, abs=4)
    assert sum(part.area_px for part in one.parts) in (0, pytest.approx(one.area_px))


@pytest.mark.slow
def test_things_further_apart_than_they_are_large_are_two() -> None:
    plain = ground()
    found = two(plain, with_thing(with_thing(plain, 20, 130), 20, 220))
    assert len(found.changes) == 2


@pytest.mark.slow
def test_the_same_thing_in_another_light_is_brighter_or_darker() -> None:
    plain = 300 + 4 * shipped("brick")[:260, :300]
    for factor, word in ((1.3, "brighter"), (0.75, "darker")):
        other = plain.copy()
        other[100:140, 120:170] *= factor
        (one,) = two(plain, other).changes
        assert one.what == word


@pytest.mark.slow
def test_a_thing_that_moved_is_one_entry_of_its_own() -> None:
    plain = ground()
    found = two(with_thing(plain, 40, 200), with_thing(plain, 43, 206))
    assert (len(found.changes), len(found.moved)) == (0, 1)
    assert found.moved[0].what == "moved"
    assert found.moved[0].displacement_px == pytest.approx((6, 3), abs=0.3)


@pytest.mark.slow
def test_what_catches_the_eye_comes_first() -> None:
    plain = ground()
    other = plain.copy()
    other[20:60, 20:70] += 500  # large and of high contrast
    other[30:36, 200:206] += 500  # small
    other[100:140, 240:280] += 60  # large and faint
    found = two(plain, other)
    order = [(round(one.x_px / 10), round(one.y_px / 10)) for one in found.changes]
    assert order[0] in [(4, 4), (5, 4)]
    assert len(order) == 3


@pytest.mark.slow
def test_what_is_smaller_than_asked_for_is_counted() -> None:
    plain = ground()
    other = plain.copy()
    other[20:60, 20:70] += 500
    other[100:140, 240:280] += 60
    every = two(plain, other, least_dn=0.0)
    found = two(plain, other, least_dn=200.0)
    assert (len(every.changes), every.below_least) == (2, 0)
    assert (len(found.changes), found.below_least) == (1, 1)
    assert describe_least(every) is None
    said = describe_least(found)
    assert said == "1 significant difference is smaller than 200 DN and not listed"


def test_the_files_step_is_the_least_by_default_in_the_follow_ups_light() -> None:
    changes = [change_at(5.0, 2.0, value) for value in (0.4, -0.9, 2.5)]
    step = np.full((10, 10), np.float32(0.5))
    for gain, expected in ((1.0, [False, True, True]), (4.0, [False, False, True])):
        kept = large_enough(changes, ChangeOptions(step_dn=(step, step)), gain)
        assert kept.tolist() == expected
    assert large_enough(changes, ChangeOptions(), 1.0).all()


def test_the_table_has_the_word_and_no_parts() -> None:
    one = change_at(5.0, 2.0, 2.0, what="gone", parts=(change_at(5.0, 2.0, 1.0),))
    (row,) = csv.DictReader(change_table([one]).decode().splitlines())
    assert row["what"] == "gone"
    assert not any("parts" in column for column in row)
