"""Captures and targets that contradict the others, by points that are known."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, strategies as st

from calibration.errors import GeometryError
from calibration.geometry._pupil import (
    HEIGHT_FLOOR_MM,
    ConsistentSeries,
    SeriesDistances,
    _fit_pupil,
    _height_outlier,
    without_outliers,
)
from simulation.arrays import FloatArray
from tests.calibration.exact_survey import Survey
from tests.calibration.geometry_bench import HEIGHTS_MM, PUPIL_MM, poses_over
from tests.calibration.known import known

HEIGHTS = np.array([180.0, 220.0, 275.0, 340.0, 430.0, 500.0])


def distances(
    heights_mm: FloatArray,
    log_distances: FloatArray,
    series: Sequence[int] | None = None,
    covariance: FloatArray | None = None,
) -> SeriesDistances:
    """One series, good to 1e-5, unless it is said."""
    count = len(heights_mm)
    return SeriesDistances(
        heights_mm=heights_mm,
        series=np.array([0] * count if series is None else series),
        log_distances=log_distances,
        covariance=np.eye(count) * 1e-10 if covariance is None else covariance,
    )


def test_two_heights_give_the_pupil_in_closed_form() -> None:
    # z = (h2 + p) / (h1 + p) = 1.5 with heights 100 and 160: p = (160 - 150) / 0.5 = 20.
    fit = _fit_pupil(
        distances(np.array([100.0, 160.0]), np.log([1.0, 1.5]), covariance=np.diag([0.0, 1e-8]))
    )
    assert fit.pupil_offset_mm == pytest.approx(20.0, abs=1e-9)
    # dp = (h1 + p)^2 / (h2 - h1) dz = 240 * 1.5e-4, and the heights' floor on both.
    assert fit.pupil_offset_err_mm == pytest.approx(240 * 1.5e-4, rel=0.01)
    assert fit.degrees_of_freedom == 0
    assert fit.zoom(100.0, 160.0)[0] == pytest.approx(1.5, abs=1e-9)


@pytest.mark.slow
@given(
    pupil=st.floats(-50, 80),
    unit=st.floats(-5, 5),
    shift=st.floats(-30, 30),
    order=st.permutations(range(len(HEIGHTS))),
)
def test_units_order_and_height_zero_do_not_matter(
    pupil: float, unit: float, shift: float, order: list[int]
) -> None:
    rng = np.random.default_rng(0)
    wobble = rng.normal(0, 1e-5, len(HEIGHTS))
    log_distances = np.log(HEIGHTS + pupil) + wobble
    first = _fit_pupil(distances(HEIGHTS, log_distances))
    second = _fit_pupil(distances((HEIGHTS + shift)[order], (log_distances + unit)[order]))
    assert second.pupil_offset_mm + shift == pytest.approx(first.pupil_offset_mm, abs=1e-6)
    assert second.pupil_offset_err_mm == pytest.approx(first.pupil_offset_err_mm, rel=1e-3)


@pytest.mark.slow
def test_heights_that_scatter_get_an_error_of_their_own() -> None:
    rng = np.random.default_rng(1)
    within, scatters = 0, []
    for _ in range(100):
        read = HEIGHTS + rng.normal(0, 0.05, len(HEIGHTS))
        fit = _fit_pupil(distances(read, np.log(HEIGHTS + 12.5)))
        scatters.append(fit.scatter_mm)
        reach = fit.interval_factor * fit.pupil_offset_err_mm
        within += abs(fit.pupil_offset_mm - 12.5) < reach
    # Four degrees of freedom: the rms of the scatters is right to 0.05 / sqrt(8 * 100).
    assert np.sqrt(np.mean(np.square(scatters))) == pytest.approx(0.05, rel=0.1)
    assert within / 100 == pytest.approx(0.95, abs=0.06)


def test_exact_heights_get_the_floor() -> None:
    fit = _fit_pupil(distances(HEIGHTS, np.log(HEIGHTS + 12.5)))
    assert fit.scatter_mm == HEIGHT_FLOOR_MM
    assert fit.pupil_offset_mm == pytest.approx(12.5, abs=1e-6)


@pytest.mark.parametrize("bad", [0, 2, 5])
def test_a_height_that_was_not_reached_is_found(bad: int) -> None:
    rng = np.random.default_rng(2)
    log_distances = np.log(HEIGHTS + 12.5) + rng.normal(0, 1e-5, 6)
    read = HEIGHTS.copy()
    read[bad] += 0.4
    found = known(_height_outlier(distances(read, log_distances)))
    assert found[0] == bad
    assert found[1] == pytest.approx(HEIGHTS[bad], abs=0.05)


def test_consistent_heights_have_no_outlier() -> None:
    rng = np.random.default_rng(3)
    for _ in range(15):
        read = HEIGHTS + rng.normal(0, 0.02, 6)
        assert _height_outlier(distances(read, np.log(HEIGHTS + 12.5))) is None


def test_two_series_share_the_pupil_and_not_the_unit() -> None:
    heights = np.concatenate([HEIGHTS, HEIGHTS[:3]])
    logs = np.concatenate([np.log(HEIGHTS + 12.5) + 1.0, np.log(HEIGHTS[:3] + 12.5) - 2.0])
    fit = _fit_pupil(distances(heights, logs, [0] * 6 + [1] * 3))
    assert fit.pupil_offset_mm == pytest.approx(12.5, abs=1e-6)
    np.testing.assert_allclose(fit.log_units, [1.0, -2.0], atol=1e-8)


def test_a_stage_that_counts_downwards_is_refused() -> None:
    with pytest.raises(ValueError):
        _fit_pupil(distances(HEIGHTS, -np.log(HEIGHTS)))


def consistent(survey: Survey) -> tuple[ConsistentSeries, dict[str, str]]:
    found = without_outliers(survey.adjusted())
    return found, {one.capture.name: one.reason for one in found.exclusions}


def test_a_slipped_stage_is_named_with_the_height_that_the_image_fits() -> None:
    read = [*HEIGHTS_MM[:3], HEIGHTS_MM[3] + 2.0, HEIGHTS_MM[4]]
    found, excluded = consistent(Survey().add("brick", poses_over(HEIGHTS_MM), heights_mm=read))
    [(name, reason)] = excluded.items()
    assert name == "brick-0-3.tif"
    assert float(reason.split()[6]) == pytest.approx(HEIGHTS_MM[3], abs=0.2)
    assert "342.000 mm was read back" in reason
    assert found.pupil.pupil_offset_mm == pytest.approx(PUPIL_MM, abs=0.2)


def test_a_turned_target_is_named_with_the_angle() -> None:
    poses = poses_over(HEIGHTS_MM)
    poses[2:3] = poses_over(HEIGHTS_MM[2:3], roll_deg=3.0)
    _, excluded = consistent(Survey().add("brick", poses))
    assert excluded == {
        "brick-0-2.tif": "the target was moved by 3.0 degrees relative to the other captures; "
        "retake it"
    }


@pytest.mark.slow
def test_a_lifted_target_is_left_out_whole_with_how_much_it_was_lifted() -> None:
    # Read 3 mm too high, or lying 3 mm above the plane of the first: the pictures are the same.
    survey = Survey().add("brick", poses_over(HEIGHTS_MM))
    survey.add("grass", poses_over(HEIGHTS_MM), heights_mm=[h + 3.0 for h in HEIGHTS_MM])
    found, excluded = consistent(survey)
    assert excluded == {
        f"grass-0-{number}.tif": "its target is at another height" for number in range(5)
    }
    [note] = found.notes
    assert note.startswith("texture grass is +")
    assert float(note.split()[3]) == pytest.approx(3.0, abs=0.1)
    assert "heights are measured from" in note
    assert found.pupil.pupil_offset_mm == pytest.approx(PUPIL_MM, abs=0.1)


def test_targets_on_one_plane_are_all_kept() -> None:
    survey = Survey().add("brick", poses_over(HEIGHTS_MM)).add("grass", poses_over(HEIGHTS_MM))
    found, excluded = consistent(survey)
    assert excluded == {}
    assert found.notes == ()
    # Twice the captures and one figure more: 10 less the offset and two units.
    assert found.pupil.degrees_of_freedom == 7


def test_a_board_at_one_height_contradicts_nobody() -> None:
    survey = Survey().add("A4", poses_over(HEIGHTS_MM[:1]), kind="board")
    _, excluded = consistent(survey.add("brick", poses_over(HEIGHTS_MM)))
    assert excluded == {}


def test_a_repeated_height_whose_readings_jitter_the_wrong_way_contradicts_nobody() -> None:
    # 2 um up by the images, 2 um down by the readings: that tells no pupil, and no fault.
    survey = Survey().add("brick", poses_over(HEIGHTS_MM))
    survey.add("A4", poses_over((220.0, 220.002)), kind="board", heights_mm=(220.002, 220.0))
    found, excluded = consistent(survey)
    assert excluded == {}
    assert found.pupil.pupil_offset_mm == pytest.approx(PUPIL_MM, abs=0.1)


def test_a_stage_that_counts_downwards_is_refused_with_the_remedy() -> None:
    falling = [600.0 - height for height in HEIGHTS_MM]
    survey = Survey().add("brick", poses_over(HEIGHTS_MM), heights_mm=falling)
    with pytest.raises(GeometryError) as refused:
        consistent(survey)
    assert (refused.value.reason, refused.value.subject) == ("heights_reversed", "brick")


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3, 4, 5])
@pytest.mark.parametrize("is_first", [True, False])
def test_one_target_whose_heights_count_downwards_is_named_however_the_others_count(
    count: int, is_first: bool
) -> None:
    falling = [600.0 - height for height in HEIGHTS_MM[:count]]
    survey = Survey()
    if not is_first:
        survey.add("brick", poses_over(HEIGHTS_MM))
    survey.add("grass", poses_over(HEIGHTS_MM[:count]), heights_mm=falling)
    if is_first:
        survey.add("brick", poses_over(HEIGHTS_MM))
    with pytest.raises(GeometryError) as refused:
        consistent(survey)
    assert (refused.value.reason, refused.value.subject) == ("heights_reversed", "grass")
    times = (HEIGHTS_MM[count - 1] + PUPIL_MM) / (HEIGHTS_MM[0] + PUPIL_MM)
    assert f"at 420 mm the image is {times:.3g} times as large as at {falling[-1]:g} mm" in str(
        refused.value
    )


def test_one_wrong_height_is_not_taken_for_a_stage_that_counts_downwards() -> None:
    read = [*HEIGHTS_MM[:4], 43.0]  # for 430
    found, excluded = consistent(Survey().add("brick", poses_over(HEIGHTS_MM), heights_mm=read))
    assert list(excluded) == ["brick-0-4.tif"]
    assert found.pupil.pupil_offset_mm == pytest.approx(PUPIL_MM, abs=0.2)


def test_a_texture_whose_other_captures_are_left_out_goes_with_them() -> None:
    survey = Survey().add("brick", poses_over(HEIGHTS_MM)).add("grass", poses_over(HEIGHTS_MM[:2]))
    left = survey.adjusted().without([survey.captures[6]])
    [brick] = left.series
    assert [one.capture for one in brick.captures] == survey.captures[:5]


def test_a_board_stays_with_a_single_capture_and_keeps_its_unit() -> None:
    survey = Survey().add("brick", poses_over(HEIGHTS_MM))
    survey.add("A4", poses_over(HEIGHTS_MM[:2]), kind="board")
    left = survey.adjusted().without([survey.captures[n] for n in (0, 1, 2, 3, 5)])
    [board] = left.series
    assert [one.capture for one in board.captures] == [survey.captures[6]]
    assert left.first_in_mm == 0
    # In mm, and not in units of the first capture.
    expected = HEIGHTS_MM[1] + PUPIL_MM
    assert board.captures[0].pose.distance == pytest.approx(expected, rel=1e-3)


def test_nothing_left_to_adjust_is_refused() -> None:
    survey = Survey().add("brick", poses_over(HEIGHTS_MM[:2]))
    with pytest.raises(GeometryError) as refused:
        survey.adjusted().without([survey.captures[1]])
    assert refused.value.reason == "nothing_left"


def test_another_focal_length_scales_the_tilt_and_leaves_the_zooms() -> None:
    survey = Survey(noise_px=1e-4).add("brick", poses_over(HEIGHTS_MM, tilt_deg=(0.4, 0.0)))
    series = survey.adjusted()
    longer = series.with_focal_length(2 * series.series[0].lens.focal_length_px)
    # The corner moves by t r^2 / f: twice the focal length, twice the tilt, to its third order.
    tilt_rad = longer.series[0].lens.tilt_x_rad
    assert tilt_rad == pytest.approx(2 * np.deg2rad(0.4), rel=1e-2)
    for before, after in zip(series.captures, longer.captures, strict=True):
        assert after.pose.log_distance == pytest.approx(before.pose.log_distance, abs=1e-4)


def test_a_target_turned_between_all_heights_is_refused_with_the_remedy() -> None:
    survey = Survey()
    for number, height_mm in enumerate(HEIGHTS_MM[:3]):
        survey.add("A4", poses_over([height_mm]), kind="board", orientation_deg=30.0 * number)
    with pytest.raises(GeometryError) as refused:
        consistent(survey)
    assert (refused.value.reason, refused.value.subject) == ("nothing_left", "A4-0-0.tif")
