from math import cos, radians

import numpy as np
import pytest
from hypothesis import given, strategies as st

from analysis.errors import (
    AnalysisError,
    BeyondCurveError,
    NotDetectableError,
    OverlapError,
)
from analysis.pose.limits import (
    FollowupPose,
    ViewingCamera,
    contrast_found_at,
    local_sampling,
    pose_limits,
    shift_overlap,
    worst_zoom,
)
from analysis.pose.quality import judge_pose
from analysis.reports.evaluation import plot_limits, plot_pose
from simulation import SamplingGrid
from tests.analysis.detectability.test_curves import curve

CAMERA = ViewingCamera(focal_length_px=800.0, width_px=640, height_px=480)


def test_a_straight_zoom_out_samples_everywhere_alike() -> None:
    matrix = SamplingGrid.centred((480, 640), 1.7).matrix
    found = local_sampling(matrix, (376, 282), (640, 480))
    np.testing.assert_allclose(found.worst_zoom, 1.7)
    np.testing.assert_allclose(found.anisotropy, 1.0)
    assert found.overlap == 1.0


def test_axes_stretched_and_turned_are_the_singular_values() -> None:
    turn = np.array([[cos(0.4), -np.sin(0.4)], [np.sin(0.4), cos(0.4)]])
    matrix = np.eye(3)
    matrix[:2, :2] = turn @ np.diag([1.6, 1.2]) @ turn.T
    found = local_sampling(matrix, (100, 80), (640, 480))
    np.testing.assert_allclose(found.worst_zoom, 1.6)
    np.testing.assert_allclose(found.best_zoom, 1.2)


@given(zoom=st.floats(1.0, 2.0), tilt=st.floats(-40, 40), place=st.floats(-0.9, 0.9))
def test_a_tilted_camera_samples_as_the_closed_form_says(
    zoom: float, tilt: float, place: float
) -> None:
    # A = z cos(t) diag(k^2, k), k = cos(a) / cos(a + t) at angle a along the lean.
    x = 319.5 + place * 319.5
    angle, lean = np.arctan((x - 319.5) / 800.0), radians(tilt)
    k = cos(angle) / cos(angle + lean)
    matrix = CAMERA.followup_to_reference(zoom, tilt)
    shift = np.array([[1.0, 0.0, x], [0.0, 1.0, 239.5], [0.0, 0.0, 1.0]])
    found = local_sampling(matrix @ shift, (1, 1), (640, 480))
    expected = sorted([zoom * cos(lean) * k**2, zoom * cos(lean) * k])
    assert found.best_zoom[0, 0] == pytest.approx(expected[0], rel=1e-9)
    assert found.worst_zoom[0, 0] == pytest.approx(expected[1], rel=1e-9)


def test_the_horizon_in_the_frame_is_refused() -> None:
    matrix = CAMERA.followup_to_reference(1.0, 72.0)
    with pytest.raises(ValueError):
        local_sampling(matrix, (640, 480), (640, 480))
    with pytest.raises(AnalysisError) as refused:
        judge_pose(matrix, (640, 480), (640, 480), curve(), 3.0)
    assert isinstance(refused.value.__cause__, ValueError)


# d' = 4 / (2 z - 1) is 3 at zoom 7/6.
LIMIT = 7 / 6


@pytest.mark.parametrize(
    ("zoom", "is_accepted"), [(1.0, True), (1.16, True), (1.17, False), (2.5, False)]
)
def test_a_pose_is_accepted_up_to_the_threshold(zoom: float, is_accepted: bool) -> None:
    grid = SamplingGrid.centred((480, 640), zoom)
    found = judge_pose(grid.matrix, (grid.cols, grid.rows), (640, 480), curve(), 3.0)
    assert found.is_accepted is is_accepted
    assert found.beyond_curve == (1.0 if zoom > 2 else 0.0)


def test_the_verdict_in_figures_is_what_is_printed() -> None:
    grid = SamplingGrid.centred((480, 640), 1.5)
    found = judge_pose(grid.matrix, (grid.cols, grid.rows), (640, 480), curve(), 3.0)
    assert repr(found) == "<PoseQuality: no go, min d' 2.00, threshold 3>"
    document = found.summary.model_dump(mode="json")
    assert list(document) == [
        *("is_accepted", "criterion", "min_dprime", "curve", "is_upper_bound"),
        *("dprime_decisive", "dprime_min", "dprime_max", "zoom_min", "zoom_max"),
        *("anisotropy_max", "overlap", "beyond_curve", "homography"),
        *("registration_correlation", "warnings", "verdict", "probability"),
        *("dprime_interval_95", "budget", "unknown_sources", "focus_turning_px2"),
        *("detection_limit", "picture", "provenance"),
    ]
    assert document["curve"] == {
        **{"model": "matched", "observer": "npw"},
        **{"noise_dn": 2.0, "contrast_dn": 12.0},
    }
    assert document["homography"] == grid.matrix.tolist()


def test_the_quantile_forgives_a_small_corner() -> None:
    matrix = CAMERA.followup_to_reference(1.1, 10.0)
    size = CAMERA.size
    strict = judge_pose(matrix, size, size, curve(), 2.0)
    threshold = strict.decisive_d_prime * 1.005
    assert not judge_pose(matrix, size, size, curve(), threshold).is_accepted
    assert judge_pose(matrix, size, size, curve(), threshold, "quantile").is_accepted
    judged = judge_pose(matrix, size, size, curve(), threshold)
    figure = plot_pose(np.zeros((480, 640)), judged)
    assert "rejected" in figure.axes[0].get_title()
    # In colour there is the photograph beside the map, which lies on grey: its colours mean d'.
    colours = np.ones((480, 640, 3)) * (200.0, 100.0, 20.0)
    photograph, map_axes, _ = plot_pose(colours, judged).axes
    assert "rejected" in map_axes.get_title()
    shown, below = (axes.images[0].get_array() for axes in (photograph, map_axes))
    assert shown is not None
    assert below is not None
    assert shown.ndim == 3
    assert below.ndim == 2


def test_no_overlap_is_an_error() -> None:
    matrix = np.eye(3)
    matrix[0, 2] = 5000.0
    with pytest.raises(OverlapError) as refused:
        judge_pose(matrix, (640, 480), (640, 480), curve(), 1.0)
    assert refused.value.shared_px == 0


def test_limits_meet_the_threshold_exactly() -> None:
    found = pose_limits(curve(), 3.0, CAMERA)
    assert found.zoom == pytest.approx(LIMIT, rel=1e-12)
    assert not found.is_zoom_beyond_curve
    assert found.tilt_deg is not None
    assert worst_zoom(CAMERA, 1.0, found.tilt_deg) == pytest.approx(LIMIT, abs=1e-6)
    for tilt, zoom in found.zoom_by_tilt:
        if zoom is not None:
            assert worst_zoom(CAMERA, zoom, tilt) == pytest.approx(LIMIT, abs=1e-6)
    allowed = [zoom for _, zoom in found.zoom_by_tilt if zoom is not None]
    assert allowed == sorted(allowed, reverse=True)
    assert allowed[0] == pytest.approx(LIMIT)
    assert dict(found.overlap_by_shift)[0.3] == pytest.approx(0.7)
    assert shift_overlap(1.5) == 0.0
    assert len(plot_limits(found).axes) == 2


def test_limits_of_distance_and_tilt_hold_in_every_direction() -> None:
    found = pose_limits(curve(), 3.0, CAMERA)
    allowed = dict(found.zoom_by_tilt)[5.0]
    assert allowed is not None
    for direction in range(0, 360, 15):
        assert worst_zoom(CAMERA, allowed, 5.0, 0.0, direction) <= LIMIT + 1e-6
    one_way = dict(pose_limits(curve(), 3.0, CAMERA, 0.0, 90.0).zoom_by_tilt)[5.0]
    assert one_way is not None
    assert one_way >= allowed


def test_a_curve_that_never_falls_below_is_a_limit_of_the_curve() -> None:
    found = pose_limits(curve(), 0.5, CAMERA)
    assert found.zoom == 2.0
    assert found.is_zoom_beyond_curve


def test_a_threshold_above_the_curve_is_told() -> None:
    with pytest.raises(NotDetectableError) as refused:
        pose_limits(curve(), 9.0, CAMERA)
    assert (refused.value.zoom, refused.value.d_prime) == (1.0, 4.0)


def test_a_reference_as_tilted_as_the_follow_up_allows_more() -> None:
    tilted = dict(pose_limits(curve(), 3.0, CAMERA, 15.0, 0.0).zoom_by_tilt)
    upright = dict(pose_limits(curve(), 3.0, CAMERA).zoom_by_tilt)
    assert tilted[15.0] is not None
    assert upright[15.0] is None or tilted[15.0] > upright[15.0]


def test_the_contrast_found_at_a_pose_reaches_the_threshold_there() -> None:
    assert contrast_found_at(curve(), 2.0, CAMERA, FollowupPose(zoom=1.5)) == pytest.approx(12.0)
    local = worst_zoom(CAMERA, 1.2, 10.0)
    assert 1.2 < local < 1.5
    # 12 DN give 4 / (2 z - 1) there.
    expected = 12.0 * 2.0 * (2 * local - 1) / 4
    leaning = FollowupPose(zoom=1.2, tilt_deg=10.0)
    assert contrast_found_at(curve(), 2.0, CAMERA, leaning) == pytest.approx(expected)
    with pytest.raises(BeyondCurveError) as refused:
        contrast_found_at(curve(), 2.0, CAMERA, FollowupPose(zoom=2.5))
    assert refused.value.zoom == pytest.approx(2.5)
    assert refused.value.largest_zoom == 2.0


@pytest.mark.parametrize("values", [{"focal_length_px": 0.0}, {"width_px": 3}, {"height_px": 15}])
def test_a_camera_that_is_none_is_refused(values: dict[str, float]) -> None:
    about = {"focal_length_px": 800.0, "width_px": 640, "height_px": 480} | values
    with pytest.raises(ValueError):
        ViewingCamera(**about)  # type: ignore[arg-type]
