import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calibration.geometry._bundle_adjustment import Adjustment, PlaneMatches, adjust
from calibration.geometry._calibration import _stage_axis
from calibration.geometry._pupil import PupilFit, SeriesDistances, _fit_pupil
from tests.calibration.geometry_bench import (
    FOCAL_PX,
    HEIGHTS_MM,
    PUPIL_MM,
    blank_captures,
    exact_matches,
    pinhole,
    poses_over,
    start_series,
)

CAPTURES = blank_captures(HEIGHTS_MM)


def pupil_of(found: Adjustment) -> PupilFit:
    return _fit_pupil(SeriesDistances.of(found))


def adjusted(matches: list[PlaneMatches]) -> Adjustment:
    return adjust([start_series(CAPTURES)], matches)


def test_exact_points_give_back_lens_tilt_and_pupil() -> None:
    poses = poses_over(HEIGHTS_MM, tilt_deg=(2.0, -1.0))
    found = adjusted(exact_matches(pinhole(), CAPTURES, poses))
    lens = found.series[0].lens
    # The prior pulls by its own weight against matches good to 1e-3 px: far below 1e-4.
    assert lens.k1 == pytest.approx(-0.01, abs=1e-5)
    assert lens.k2 == pytest.approx(0.0, abs=1e-5)
    assert np.rad2deg(lens.tilt_x_rad) == pytest.approx(2.0, abs=1e-3)
    assert np.rad2deg(lens.tilt_y_rad) == pytest.approx(-1.0, abs=1e-3)
    assert pupil_of(found).pupil_offset_mm == pytest.approx(PUPIL_MM, abs=1e-3)
    assert max(one.rms_px for one in found.captures) < 1e-3


def test_a_leaning_stage_pierces_the_image_where_it_leans() -> None:
    # The camera goes 0.01 mm to the right for each mm up: the picture grows out of the pixel
    # 0.01 focal lengths to the left, as a thing seen there keeps its place.
    poses = poses_over(HEIGHTS_MM, drift_mm_per_mm=(0.01, -0.004))
    found = adjusted(exact_matches(pinhole(k1=0.0), CAPTURES, poses))
    axis = _stage_axis(found, 0)
    np.testing.assert_allclose(axis.offset_px, [-0.01 * FOCAL_PX, 0.004 * FOCAL_PX], atol=2e-3)
    assert np.abs(axis.sideways).max() < 1e-5


def test_the_pierced_pixel_stands_still() -> None:
    camera = pinhole()
    poses = poses_over(HEIGHTS_MM, drift_mm_per_mm=(0.02, 0.01), tilt_deg=(1.0, -2.0))
    x, y = _stage_axis(adjusted(exact_matches(camera, CAPTURES, poses)), 0).pierce_px
    plane = camera.to_plane_mm(np.array([x]), np.array([y]), poses[0])
    for pose in poses[1:]:
        np.testing.assert_allclose(camera.to_pixel(*plane, pose), [[x], [y]], atol=0.01)


@pytest.mark.slow
def test_standard_errors_cover_the_truth() -> None:
    # 20 draws: 95.4 % within two errors; fewer than 16 would be one chance in 300.
    inside = {"pupil": 0, "k1": 0, "tilt": 0, "drift": 0}
    poses = poses_over(HEIGHTS_MM, tilt_deg=(1.0, 0.5), drift_mm_per_mm=(0.01, 0.0))
    # In camera axes the travel leans by the drift and the tilt together.
    truth_px = -FOCAL_PX * np.tan(np.arctan(0.01) + np.deg2rad(1.0))
    for seed in range(20):
        matches = exact_matches(
            pinhole(),
            CAPTURES,
            poses,
            noise_px=0.05,
            rng=np.random.default_rng(seed),
            step_px=24,
        )
        found = adjusted(matches)
        lens, errs = found.series[0].lens, np.sqrt(np.diag(found.covariance))
        pupil = pupil_of(found)
        axis = _stage_axis(found, 0)
        axis_err_px = np.sqrt(axis.covariance_px2[0, 0])
        inside["pupil"] += abs(pupil.pupil_offset_mm - PUPIL_MM) < 2 * pupil.pupil_offset_err_mm
        inside["k1"] += abs(lens.k1 + 0.01) < 2 * errs[0]
        inside["tilt"] += abs(lens.tilt_x_rad - np.deg2rad(1.0)) < 2 * errs[4]
        inside["drift"] += abs(axis.offset_px[0] - truth_px) < 2 * axis_err_px
    assert min(inside.values()) >= 16, inside


@pytest.mark.slow
@settings(max_examples=3)
@given(order=st.permutations(range(1, len(CAPTURES))))
def test_the_order_of_the_captures_does_not_matter(order: list[int]) -> None:
    rng = np.random.default_rng(5)
    poses = poses_over(HEIGHTS_MM, tilt_deg=(0.5, 1.0))
    matches = exact_matches(pinhole(), CAPTURES, poses, noise_px=0.05, rng=rng, step_px=48)
    # The first stays: its distance is the unit.
    shuffled = [CAPTURES[n] for n in (0, *order)]
    straight, again = (
        {
            one.capture: one.pose.log_distance
            for one in adjust([start_series(captures)], matches).captures
        }
        for captures in (CAPTURES, shuffled)
    )
    for capture in CAPTURES:
        assert again[capture] == pytest.approx(straight[capture], abs=1e-8)


@pytest.mark.slow
@settings(max_examples=3)
@given(scale=st.floats(0.5, 3.0))
def test_the_pupil_does_not_depend_on_the_assumed_focal_length(scale: float) -> None:
    rng = np.random.default_rng(6)
    poses = poses_over(HEIGHTS_MM)
    matches = exact_matches(pinhole(), CAPTURES, poses, noise_px=0.05, rng=rng, step_px=48)
    offsets, errs = [], []
    for focal_px in (FOCAL_PX, scale * FOCAL_PX):
        found = adjust([start_series(CAPTURES, focal_px)], matches)
        offsets.append(pupil_of(found).pupil_offset_mm)
        errs.append(pupil_of(found).pupil_offset_err_mm)
    # Exactly but for the square of the tilt, which is no more than noise here.
    assert offsets[0] == pytest.approx(offsets[1], abs=0.05 * errs[0])


def test_wrong_matches_are_not_believed() -> None:
    rng = np.random.default_rng(7)
    matches = exact_matches(pinhole(), CAPTURES, poses_over(HEIGHTS_MM), noise_px=0.05, rng=rng)
    spoilt = []
    for m in matches:
        points = m.other_points.copy()
        wrong = rng.random(len(points)) < 0.1
        points[wrong] += rng.normal(0, 20, (int(wrong.sum()), 2))
        spoilt.append(
            PlaneMatches(
                capture=m.capture,
                seen_px=m.seen_px,
                other=m.other,
                other_points=points,
                covariance_px2=m.covariance_px2,
            )
        )
    pupil = pupil_of(adjusted(spoilt))
    assert pupil.pupil_offset_mm == pytest.approx(PUPIL_MM, abs=4 * pupil.pupil_offset_err_mm)
    assert pupil.pupil_offset_err_mm < 0.2
