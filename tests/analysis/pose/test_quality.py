"""Go, no go or unsure: right as often as stated, and what would turn a verdict."""

from math import cos, exp, log, radians, sin

import numpy as np
import pytest
from hypothesis import given, strategies as st

from analysis.detectability import CurveUncertainty, DetectabilityCurve, DPrimeSlopes, ErrorSources
from analysis.errors import AnalysisError, BeyondCurveError, NotDetectableError, OverlapError
from analysis.pose import (
    FollowupPose,
    ViewingCamera,
    contrast_found_at,
    decide,
    describe_pose,
    limits_of_curve,
    pose_quality,
    verdict_of,
)
from analysis.pose._limits import local_sampling, shift_overlap, worst_zoom
from analysis.reports import plot_limits, plot_pose
from calibration.registration import DistortedPose
from simulation import SamplingGrid
from tests.analysis.detectability.test_curves import curve, of_two_zooms

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
        pose_quality(matrix, (640, 480), (640, 480), curve(), 3.0)
    assert isinstance(refused.value.__cause__, ValueError)


# d' = 4 / (2 z - 1) is 3 at zoom 7/6.
LIMIT = 7 / 6


@pytest.mark.parametrize(
    ("zoom", "is_accepted"), [(1.0, True), (1.16, True), (1.17, False), (2.5, False)]
)
def test_a_pose_is_accepted_up_to_the_threshold(zoom: float, is_accepted: bool) -> None:
    grid = SamplingGrid.centred((480, 640), zoom)
    found = pose_quality(grid.matrix, (grid.cols, grid.rows), (640, 480), curve(), 3.0)
    assert found.is_accepted is is_accepted
    assert found.beyond_curve == (1.0 if zoom > 2 else 0.0)


def test_the_verdict_in_figures_is_what_is_printed() -> None:
    grid = SamplingGrid.centred((480, 640), 1.5)
    found = pose_quality(grid.matrix, (grid.cols, grid.rows), (640, 480), curve(), 3.0)
    assert repr(found) == "<PoseQuality: no go, min d' 2.00, threshold 3>"
    document = found.summary.model_dump(mode="json")
    assert list(document) == [
        *("is_accepted", "criterion", "min_dprime", "curve", "is_upper_bound"),
        *("dprime_decisive", "dprime_min", "dprime_max", "zoom_min", "zoom_max"),
        *("anisotropy_max", "overlap", "beyond_curve", "homography"),
        *("registration_correlation", "warnings", "verdict", "probability"),
        *("dprime_interval_95", "budget", "unknown_sources", "focus_turning_px2"),
        *("detection_limit", "parallax", "picture", "provenance"),
    ]
    assert document["curve"] == {
        **{"model": "matched", "observer": "npw"},
        **{"noise_dn": 2.0, "contrast_dn": 12.0},
    }
    assert document["homography"] == grid.matrix.tolist()


def test_the_quantile_forgives_a_small_corner() -> None:
    matrix = CAMERA.followup_to_reference(1.1, 10.0)
    size = CAMERA.size
    strict = pose_quality(matrix, size, size, curve(), 2.0)
    threshold = strict.decisive_d_prime * 1.005
    assert not pose_quality(matrix, size, size, curve(), threshold).is_accepted
    assert pose_quality(matrix, size, size, curve(), threshold, "quantile").is_accepted
    judged = pose_quality(matrix, size, size, curve(), threshold)
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
        pose_quality(matrix, (640, 480), (640, 480), curve(), 1.0)
    assert refused.value.shared_px == 0


def test_limits_meet_the_threshold_exactly() -> None:
    found = limits_of_curve(curve(), 3.0, CAMERA)
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
    found = limits_of_curve(curve(), 3.0, CAMERA)
    allowed = dict(found.zoom_by_tilt)[5.0]
    assert allowed is not None
    for direction in range(0, 360, 15):
        assert worst_zoom(CAMERA, allowed, 5.0, 0.0, direction) <= LIMIT + 1e-6
    one_way = dict(limits_of_curve(curve(), 3.0, CAMERA, 0.0, 90.0).zoom_by_tilt)[5.0]
    assert one_way is not None
    assert one_way >= allowed


def test_a_curve_that_never_falls_below_is_a_limit_of_the_curve() -> None:
    found = limits_of_curve(curve(), 0.5, CAMERA)
    assert found.zoom == 2.0
    assert found.is_zoom_beyond_curve


def test_a_threshold_above_the_curve_is_told() -> None:
    with pytest.raises(NotDetectableError) as refused:
        limits_of_curve(curve(), 9.0, CAMERA)
    assert (refused.value.zoom, refused.value.d_prime) == (1.0, 4.0)


def test_a_reference_as_tilted_as_the_follow_up_allows_more() -> None:
    tilted = dict(limits_of_curve(curve(), 3.0, CAMERA, 15.0, 0.0).zoom_by_tilt)
    upright = dict(limits_of_curve(curve(), 3.0, CAMERA).zoom_by_tilt)
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


ERR = 0.05


def curve_knowing(sources: ErrorSources | None = None, **slopes: float) -> DetectabilityCurve:
    stated = DPrimeSlopes(**({"psf_per_px2": -1.0, "noise": -0.2} | slopes))
    uncertainty = CurveUncertainty(
        sources=sources or ErrorSources(), scene=[ERR] * 2, slopes=[stated] * 2
    )
    return of_two_zooms(uncertainty=uncertainty)


@pytest.mark.parametrize(
    ("d_prime", "verdict"),
    [(2 * exp(1.65 * ERR), "go"), (2 * exp(-1.65 * ERR), "no go"), (2.0, "unsure"), (0.0, "no go")],
)
def test_a_verdict_is_given_from_95_percent_on(d_prime: float, verdict: str) -> None:
    found = decide(curve_knowing(), 1.5, d_prime, 2.0)
    assert found.verdict == verdict == verdict_of(found.probability)


def test_go_and_no_go_are_wrong_as_rarely_as_stated() -> None:
    # Where the true d' is the threshold itself, either verdict comes in 5 %; elsewhere, the wrong
    # one comes more rarely.
    rng = np.random.default_rng(8)
    known = curve_knowing(ErrorSources(focus_scatter_px2=0.0))
    seen = 2.0 * np.exp(ERR * rng.standard_normal(2000))
    verdicts = [decide(known, 1.5, float(one), 2.0).verdict for one in seen]
    # 2000 of 5 %: 999 of 1000 stay below 6.6 %.
    assert verdicts.count("go") / 2000 < 0.066
    assert verdicts.count("no go") / 2000 < 0.066


def test_the_focus_that_would_turn_a_verdict_turns_it() -> None:
    loose = curve_knowing(signal_per_px2=-2.0, followup_per_px4=4.0)
    d_prime = 2 * exp(2.5 * ERR)
    found = decide(loose, 1.5, d_prime, 2.0)
    assert found.verdict == "go"
    assert "focus" in found.unknown_sources
    assert found.focus_turning_px2 is not None
    for share, verdict in ((0.97, "go"), (1.03, "unsure")):
        stated = loose.knowing(focus_scatter_px2=share * found.focus_turning_px2)
        assert decide(stated, 1.5, d_prime, 2.0).verdict == verdict
    assert f"{found.focus_turning_px2:.2g} px^2" in (found.unknown_sentence or "")


def test_a_focus_that_turns_nothing_is_said_to() -> None:
    found = decide(curve_knowing(), 1.5, 2 * exp(5 * ERR), 2.0)
    assert found.focus_turning_px2 is None
    assert "would change the verdict" in (found.unknown_sentence or "")


def test_the_budget_names_what_decides_and_what_would_shrink_it() -> None:
    sources = ErrorSources(focus_scatter_px2=0.1, psf_variance_err_px2=0.01)
    found = decide(curve_knowing(sources, signal_per_px2=-2.0), 1.5, 2.0, 2.0)
    assert [one.source for one in found.budget] == ["focus", "scene", "psf"]
    expected = 0.2**2 / (0.2**2 + ERR**2 + 0.01**2)  # closed form
    assert found.budget[0].share == pytest.approx(expected, rel=1e-3)
    assert found.verdict == "unsure"
    assert "a focus that repeats better" in found.sentence


def test_exact_curves_are_certain() -> None:
    exact = curve_knowing().model_copy(
        update={"uncertainty": None, "dprime_low": [4.0, 2.0], "dprime_high": [4.0, 2.0]}
    )
    assert decide(exact, 2.0, 2.0, 2.0).probability == 1.0
    assert decide(exact, 2.0, 1.999, 2.0).probability == 0.0
    assert log(decide(exact, 2.0, 2.0, 2.0).dprime_interval_95[0] / 2.0) == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("zoom", "turn_deg", "aside", "said"),
    [
        (1.0, 0.0, (0.0, 0.0), "the same distance (zoom 1.000), turned by 0.0 degrees"),
        (1.25, 10.0, (30.0, 40.0), "further away (zoom 1.250), turned by 10.0 degrees, aside by"),
        (0.8, -5.0, (0.0, 0.0), "nearer (zoom 0.800), turned by -5.0 degrees"),
    ],
)
def test_a_pose_is_told_in_an_operators_words(
    zoom: float, turn_deg: float, aside: tuple[float, float], said: str
) -> None:
    c, s = zoom * cos(radians(turn_deg)), zoom * sin(radians(turn_deg))
    turn = np.array([[c, -s], [s, c]])
    shift = np.array([199.5, 149.5]) + aside - turn @ [99.5, 74.5]
    matrix = np.array([[*turn[0], shift[0]], [*turn[1], shift[1]], [0, 0, 1]])
    pose = DistortedPose(
        matrix=matrix, k1=0.0, reference_shape=(300, 400), followup_shape=(150, 200)
    )
    assert describe_pose(pose).startswith(said)
    if any(aside):
        assert describe_pose(pose).endswith("aside by 50 px (12 % of the frame)")
