"""Scenes with depth beside projections written out: parallax, hidden strips, folds, spots."""

from math import cos, radians, sin

import numpy as np
import pytest

from hil_mocks.benchmark_set._depth import (
    DeepView,
    Depths,
    Thing,
    depth_of_parallax,
)
from hil_mocks.benchmark_set._documents import benchmark_tasks
from hil_mocks.benchmark_set._lenses import round_lens
from hil_mocks.benchmark_set._pair_tracks import DeepPair
from hil_mocks.benchmark_set._scenes import Pose
from hil_mocks.benchmark_set._tasks import View
from hil_mocks.truth import Outline

SHAPE = (90, 120)
FOCAL_PX = 1.24 * 120
MIDDLE_X, MIDDLE_Y = 59.5, 44.5

# An upright camera beside the reference, at its distance: all parallax is along x.
BASELINE = 0.1
ASIDE = Pose(reference_shape=SHAPE, followup_shape=SHAPE, shift_px=(BASELINE * FOCAL_PX, 0.0))


def plate(depth: float, outline: Outline = "plate", x_px: float = MIDDLE_X) -> Thing:
    return Thing(
        outline=outline,
        x_px=x_px,
        y_px=MIDDLE_Y,
        half_x_px=15.25,
        half_y_px=10.25,
        turn_deg=0.0,
        depth=depth,
        shade=1.0,
        texture_px=(0.0, 0.0),
    )


def seen(depths: Depths, pose: Pose = ASIDE) -> DeepView:
    return DeepView(
        scene="texture-1",
        seed=1,
        lens=round_lens(0.6),
        pose=pose,
        depths=depths,
        things_scene="tiles-1",
    )


def test_a_plate_is_displaced_by_its_height_times_the_baseline_over_its_depth() -> None:
    depth = 0.8
    found = seen(Depths(things=(plate(depth),))).visibility()
    on_ground = np.arange(120.0) + BASELINE * FOCAL_PX  # of a frontal pair, everywhere the same
    row = 45
    on = found.surface[row] == 1
    np.testing.assert_allclose(found.x_px[row][~on], on_ground[~on])
    # f b (1 - Z) / Z beyond where the plane has it.
    beyond = FOCAL_PX * BASELINE * (1 - depth) / depth
    np.testing.assert_allclose(found.x_px[row][on], on_ground[on] + beyond)
    assert beyond == pytest.approx(3.72)
    # It is as wide as in the reference: both are as far from it.
    assert np.count_nonzero(on) == pytest.approx(2 * 15.25, abs=1)


def test_a_strip_beside_a_plate_is_hidden_as_wide_as_its_parallax() -> None:
    depth = 0.5
    found = seen(Depths(things=(plate(depth),))).visibility()
    row = 45
    hidden = np.flatnonzero(found.is_unseen[row] & (found.x_px[row] < 119))
    wide = FOCAL_PX * BASELINE * (1 - depth) / depth  # 14.88 px
    assert len(hidden) == pytest.approx(wide, abs=1)
    on = np.flatnonzero(found.surface[row] == 1)
    # The follow-up stands at +x, and looks behind the plate's side there: next to it.
    assert hidden[0] == on[-1] + 1
    # In the reference, those places are on the plate.
    assert np.abs(found.x_px[row, hidden] - MIDDLE_X).max() <= 15.25


def test_what_the_reference_s_frame_does_not_hold_is_unseen() -> None:
    found = seen(Depths(things=())).visibility()
    np.testing.assert_array_equal(
        found.is_unseen, np.broadcast_to(np.arange(120) + BASELINE * FOCAL_PX > 119, SHAPE)
    )


def test_a_point_of_a_fold_is_seen_where_its_ray_meets_the_sensor() -> None:
    """A point of the street, projected into the tilted camera step by step."""
    pose = Pose(
        reference_shape=SHAPE, followup_shape=SHAPE, zoom=1.1, tilt_deg=4.0, bearing_deg=0.0
    )
    depths = Depths(things=(), fold_px=50.0, rise_per_px=0.03)
    x, y = 52.0, 78.0
    depth = 1 / (1 + 0.03 * (y - 50.0))
    point = np.array([(x - MIDDLE_X) / FOCAL_PX, (y - MIDDLE_Y) / FOCAL_PX, 1.0]) * depth
    t = radians(4)
    ray = point - (np.array([0, 0, 1.0]) - 1.1 * np.array([sin(t), 0, cos(t)]))
    across, along = ray[0] * cos(t) - ray[2] * sin(t), ray[0] * sin(t) + ray[2] * cos(t)
    seen_x, seen_y = MIDDLE_X + FOCAL_PX * across / along, MIDDLE_Y + FOCAL_PX * ray[1] / along
    sight = seen(depths, pose)._from_followup(np.array([seen_x]), np.array([seen_y]))
    found_x, found_y = sight.on_backdrop(depths)
    assert (found_x[0], found_y[0]) == pytest.approx((x, y), abs=1e-9)


def test_a_depth_that_is_drawn_by_its_parallax_has_it() -> None:
    pose = Pose(reference_shape=SHAPE, followup_shape=SHAPE, zoom=1.3, tilt_deg=9.0)
    depth = depth_of_parallax(pose, 12.0)
    pupil = pose.pupil
    # On the ray from the pupil through the point before the middle, where the depth is 1.
    at = pupil + (np.array([0, 0, depth]) - pupil) * (1 - pupil[2]) / (depth - pupil[2])
    assert FOCAL_PX * np.hypot(*at[:2]) == pytest.approx(12.0)


@pytest.mark.parametrize(
    ("outline", "inside", "outside"),
    [
        ("plate", (15.0, 10.0), (15.5, 0.0)),
        ("coin", (0.0, 15.0), (11.0, 11.0)),
        ("leaf", (15.0, 0.0), (10.0, 8.0)),
    ],
)
def test_an_outline_holds_what_is_within_it(
    outline: Outline, inside: tuple[float, float], outside: tuple[float, float]
) -> None:
    thing = plate(0.8, outline)
    for (x, y), is_inside in ((inside, True), (outside, False)):
        found = thing.inside_px(np.array([MIDDLE_X + x]), np.array([MIDDLE_Y + y]))
        assert (found[0] > 0) == is_inside


def test_a_thing_covers_the_ground_with_what_it_was_cut_out_of() -> None:
    """Away from its outline each shows what its own scene alone would."""
    view = seen(Depths(things=(plate(0.7),)))
    ground, cut_out = (
        View(scene=name, seed=1, lens=view.lens, pose=ASIDE).reference_light()
        for name in (view.scene, view.things_scene)
    )
    found = view.reference_light()
    inner = np.s_[40:50, 50:70]
    np.testing.assert_allclose(found[inner], cut_out[inner], atol=1e-6)
    np.testing.assert_allclose(found[:, :30], ground[:, :30], atol=1e-6)
    assert np.abs(ground[inner] - cut_out[inner]).max() > 0.1


@pytest.mark.slow
def test_twins_show_the_same_depths_and_spots_lie_on_what_both_photographs_show() -> None:
    tasks = [task for task in benchmark_tasks("tiny", 1) if isinstance(task, DeepPair)]
    assert {task.kind for task in tasks} == {"steps", "outdoors"}
    for kind in ("steps", "outdoors"):
        first, second = (task.rendered() for task in tasks if task.kind == kind)
        assert first.truth["depths"] == second.truth["depths"]
        marked = [made.files[made.truth["unseen"]] for made in (first, second)]
        assert marked[0] == marked[1]
        unseen = np.frombuffer(marked[0][-112 * 144 :], np.uint8).reshape(112, 144)
        spots = first.truth["spots"] or second.truth["spots"]
        assert len(spots) >= 2
        for spot in spots:
            row, col = round(spot["y_px"]), round(spot["x_px"])
            assert not unseen[row - 4 : row + 5, col].any()
            assert not unseen[row, col - 4 : col + 5].any()


def test_kinds_that_were_there_before_are_drawn_as_they_were() -> None:
    """Their names and twins, of which files are made, follow from the first stream alone."""
    tasks = [task for task in benchmark_tasks("small", 1) if task.track == "changes"]
    last = max(task.name for task in tasks if not isinstance(task, DeepPair))
    first = min(task.name for task in tasks if isinstance(task, DeepPair))
    assert (last, first) == ("changes-096", "changes-097")
