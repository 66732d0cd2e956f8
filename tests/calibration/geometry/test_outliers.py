"""Captures and targets that contradict the others, by points that are known."""

import numpy as np
import pytest

from calibration.errors import GeometryError
from calibration.geometry.pupil import ConsistentSeries, without_outliers
from tests.calibration.exact_survey import Survey
from tests.calibration.geometry_bench import HEIGHTS_MM, PUPIL_MM, poses_over


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
