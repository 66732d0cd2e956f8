"""Changes of scenes with depth: what a plane leaves is parallax, what was painted is a change."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import analysis.changes._depth as depth_module
from analysis.changes import ChangeOptions, ChangeResult, changes_between, depth_in_mm
from analysis.errors import OverlapError
from benchmarks.truth.depth import DepthPair, View, depth_pair
from calibration.parallax import FrameCamera
from simulation.arrays import Float32Array
from tests.calibration.known import known
from tests.calibration.parallax.test_parallax import (
    FARTHER,
    NEAR,
    TILTED,
    photographs,
    plates,
)

pytestmark = pytest.mark.slow
SPOT = (90.0, 118.0)
"""Row and column on the ground between the plates, in the follow-up."""

FLAT = ChangeOptions(flat=True)


@cache
def rendered(one: View, other: View) -> DepthPair:
    return depth_pair(plates(), one, other)


def with_spot(followup: Float32Array) -> Float32Array:
    y, x = np.indices(followup.shape)
    spot = 40 * np.exp(-((y - SPOT[0]) ** 2 + (x - SPOT[1]) ** 2) / (2 * 2.0**2))
    return np.asarray(followup + spot, dtype=np.float32)


def listed_at(found: ChangeResult) -> int:
    y, x = SPOT
    return sum(np.hypot(one.y_px - y, one.x_px - x) < 4 for one in found.summary.changes)


@pytest.mark.parametrize("views", [(NEAR, TILTED), (FARTHER, NEAR)])
def test_a_spot_is_listed_and_next_to_nothing_else(views: tuple[View, View]) -> None:
    """And nothing is listed at its place before it is painted."""
    before, after = photographs(rendered(*views))
    unchanged, plane = changes_between(before, after), changes_between(before, after, options=FLAT)
    assert known(unchanged.summary.parallax).held_out_gain > 0.05
    assert plane.summary.parallax is None
    # What a plane leaves is listed as changed, or as moved.
    share, plane_share = (
        (one.summary.changed_px + one.summary.moved_px) / one.summary.compared_px
        for one in (unchanged, plane)
    )
    assert share < min(0.03, plane_share)
    assert listed_at(unchanged) == 0
    assert listed_at(changes_between(before, with_spot(after))) == 1


@pytest.mark.parametrize("views", [(NEAR, TILTED), (FARTHER, NEAR)])
def test_the_epipole_is_where_the_follow_up_sees_the_references_camera(
    views: tuple[View, View],
) -> None:
    before, after = photographs(rendered(*views))
    x, y, w = known(changes_between(before, after).summary.parallax).epipole
    true_x, true_y = (float(at) for at in views[1].pixels(views[0].centre, before.shape))
    middle = np.array([after.shape[1] / 2, after.shape[0] / 2])
    there, truth = np.array([x / w, y / w]) - middle, np.array([true_x, true_y]) - middle
    angle = np.arctan2(*there[::-1]) - np.arctan2(*truth[::-1])
    # Far outside the frame its direction is what is seen, to some degrees.
    assert abs(np.rad2deg((angle + np.pi / 2) % np.pi - np.pi / 2)) < 5


def test_a_flat_scene_has_no_depth_and_a_spot_all_the_same() -> None:
    ground = replace(plates(), plates=())
    before, after = photographs(depth_pair(ground, NEAR, TILTED))
    assert changes_between(before, after).summary.parallax is None
    assert listed_at(changes_between(before, with_spot(after))) == 1


def test_where_depth_leaves_nothing_to_compare_the_plane_stays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def nothing_shared(*_: object) -> None:
        raise OverlapError("nothing can be compared", shared_px=0)

    before, after = photographs(rendered(NEAR, TILTED))
    monkeypatch.setattr(depth_module, "compare", nothing_shared)
    found = changes_between(before, after)
    assert found.parallax is None
    plane = changes_between(before, after, options=FLAT).summary
    assert found.summary.changed_px == plane.changed_px


@pytest.mark.parametrize("views", [(NEAR, TILTED), (FARTHER, NEAR), (NEAR, FARTHER)])
def test_heights_are_those_of_the_scene_within_what_they_are_said_to_err(
    views: tuple[View, View],
) -> None:
    made = rendered(*views)
    rows, cols = made.is_seen.shape
    found = changes_between(*photographs(made))
    camera = FrameCamera(
        focal_length_px=View().focal_px, principal_px=((cols - 1) / 2, (rows - 1) / 2)
    )
    figures, seen = known(found.summary.parallax), known(found.parallax)
    depth = known(depth_in_mm(found.pose, (seen, figures), camera, views[0].distance_px))
    measured = np.isfinite(depth.height_error_mm) & made.is_seen
    np.testing.assert_array_equal(np.isfinite(depth.depth_mm), np.isfinite(seen.parallax_px))
    apart = (depth.height_mm - made.height_px)[measured]
    # Plates of 60 to 110 px, of which a pixel of parallax is 7 to 15.
    assert np.median(np.abs(apart)) < 2.5
    # Some beside steps err by more than they are said to.
    assert np.mean(np.abs(apart) < 2 * depth.height_error_mm[measured]) > 0.85
    # Heights are in proportion to a baseline that is known to as much.
    assert np.median(depth.height_error_mm[measured]) < 12.0
    # Along the axis, from the camera: the scene's points in its own coordinates.
    x, y = np.meshgrid(np.arange(float(cols)), np.arange(float(rows)))
    ray = views[1].rays(x, y, made.is_seen.shape)
    points = ray * (views[1].distance_px - made.height_px) / -ray[2]
    along = np.tensordot(views[1].rotation[2] * [1, 1, -1], points, axes=1)
    off = (depth.depth_mm - along)[measured]
    # Nearly the same error, and that of the distance of the plane.
    assert np.median(np.abs(off)) < 2.5 + 0.02 * views[1].distance_px
    assert np.std(off) < 1.2 * np.std(apart) + 2.0
    said = known(depth.figures.heights)
    assert said.distance_mm == pytest.approx(views[1].distance_px, rel=0.02)
    baseline = float(np.linalg.norm(views[0].centre - views[1].centre))
    assert said.baseline_mm == pytest.approx(baseline, rel=0.1)
    # Without a lens the two photographs say as much of what is nearer.
    assert figures.larger_is == depth.figures.larger_is
    on_plates = measured & (made.height_px > 50)
    sign = 1 if figures.larger_is == "nearer" else -1
    assert np.mean(sign * seen.parallax_px[on_plates] > 0) > 0.99
