"""Movements in the list of changes: places and shifts in follow-up pixels."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.changes import ChangeOptions, find_changes
from analysis.changes.comparison import Comparison
from analysis.changes.things import moved_apart
from calibration.registration import DistortedPose
from tests.analysis.changes.compared_fields import comparison, regions_and_changes
from tests.analysis.changes.test_movement import SD_DN, SHAPE, compared, moved_thing, waves

SAME = DistortedPose(matrix=np.eye(3), k1=0.0, reference_shape=SHAPE, followup_shape=SHAPE)
TWICE = DistortedPose(  # the follow-up twice as near
    matrix=np.diag([0.5, 0.5, 1.0]), k1=0.0, reference_shape=SHAPE, followup_shape=SHAPE
)
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


def test_moved_things_are_counted_only_if_asked_for() -> None:
    rng = np.random.default_rng(4)
    before, after = moved_thing(waves(5, 8.0), waves(6, 12.0), SHIFT)
    before = 100 + before + 0.5 * rng.standard_normal(SHAPE)
    after = 100 + after + 0.5 * rng.standard_normal(SHAPE)
    apart = find_changes(before, after, None, ChangeOptions(pose=SAME)).summary
    options = ChangeOptions(pose=SAME, count_moved=True)
    counted = find_changes(before, after, None, options).summary
    assert len(apart.moved) == 1
    assert counted.moved == ()
    assert set(counted.changes) == {*apart.changes, *apart.moved}
