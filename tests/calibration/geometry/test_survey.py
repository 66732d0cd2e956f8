"""What ``geometry_of_captures`` concludes, from points known exactly up to a seeded noise."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calibration.errors import GeometryError, GeometryFileError
from calibration.estimate import Estimate
from calibration.files import write_geometry
from calibration.geometry import (
    CharucoBoard,
    GeometryCalibration,
    GeometryCapture,
    GeometryOptions,
    PlaneLens,
    _calibration as calibration,
    geometry_of_captures,
)
from calibration.geometry._bundle_adjustment import Exclusion
from calibration.geometry._calibration import length_of
from calibration.geometry._matching import _MatchedCaptures
from tests.calibration.exact_survey import Survey
from tests.calibration.geometry_bench import FOCAL_PX, HEIGHTS_MM, PUPIL_MM, poses_over

Calibrate = Callable[..., GeometryCalibration]

NOMINAL = GeometryOptions(nominal_focal_px=FOCAL_PX)


@pytest.fixture
def calibrated(monkeypatch: pytest.MonkeyPatch) -> Calibrate:
    """Calibrate a survey whose captures are matched by the bench's optics, not by pictures."""

    def calibrate(survey: Survey, options: GeometryOptions | None = None) -> GeometryCalibration:
        def matched(
            captures: list[GeometryCapture],
            lens: PlaneLens,
            _board: CharucoBoard,
            _progress: Callable[[int], None],
        ) -> _MatchedCaptures:
            return _MatchedCaptures(adjustment=survey.adjusted(captures, lens), exclusions=())

        monkeypatch.setattr(calibration, "adjust_captures", matched)
        return geometry_of_captures(survey.captures, options)

    return calibrate


def test_no_capture_is_refused() -> None:
    with pytest.raises(GeometryError) as refused:
        geometry_of_captures([])
    assert refused.value.reason == "no_captures"


def test_captures_of_several_sizes_are_refused() -> None:
    first, second = Survey().add("brick", poses_over(HEIGHTS_MM[:2])).captures
    cut = replace(second, image=second.image[:200])
    with pytest.raises(GeometryError) as refused:
        geometry_of_captures([first, cut])
    assert refused.value.reason == "several_sizes"


def test_without_any_length_the_pupil_is_found_and_scale_and_tilt_are_left_open(
    calibrated: Calibrate,
) -> None:
    found = calibrated(Survey().add("brick", poses_over(HEIGHTS_MM)))
    assert found.pupil_offset_err_mm is not None
    assert found.pupil_offset_mm == pytest.approx(PUPIL_MM, abs=4 * found.pupil_offset_err_mm)
    assert found.scale_px_per_mm is None
    assert found.scale_source is None
    assert found.focal_length_px is None
    assert found.tilt_deg is None
    assert all(capture.scale_px_per_mm is None for capture in found.captures)
    assert "capture a ChArUco board, give --scale" in found.undetermined["scale_px_per_mm"]
    assert "give it in the bench file" in found.undetermined["tilt_deg"]
    # Figures in units of the focal length have none to be in.
    assert found.k1 is not None
    assert found.k1_opencv is found.k2_opencv is found.stage_angle_deg is None


@pytest.mark.slow
def test_a_given_scale_is_exact_where_it_was_given_and_the_zooms_carry_it_on(
    calibrated: Calibrate,
) -> None:
    survey = Survey().add("brick", poses_over(HEIGHTS_MM))
    lowest_mm = HEIGHTS_MM[0] + PUPIL_MM
    found = calibrated(survey, GeometryOptions(scale_px_per_mm=FOCAL_PX / lowest_mm))
    pupil_err_mm = found.pupil_offset_err_mm
    assert found.scale_source == "given"
    assert found.scale_px_per_mm is not None
    assert found.scale_err_px_per_mm is not None
    assert pupil_err_mm is not None
    assert found.scale_px_per_mm[0] == pytest.approx(FOCAL_PX / lowest_mm, rel=1e-12)
    assert found.scale_err_px_per_mm[0] == 0.0
    scales = zip(HEIGHTS_MM, found.scale_px_per_mm, found.scale_err_px_per_mm, strict=True)
    for height_mm, scale, err in list(scales)[1:]:
        assert scale == pytest.approx(FOCAL_PX / (height_mm + PUPIL_MM), abs=4 * err)
        # d ln((h + p) / (l + p)) / dp, the difference of the reciprocals.
        relative = (1 / lowest_mm - 1 / (height_mm + PUPIL_MM)) * pupil_err_mm
        assert err / scale == pytest.approx(relative, rel=1e-3)
    assert found.focal_length_px is not None
    # f = scale (h + p): its error is the pupil's alone.
    expected_err_px = FOCAL_PX / lowest_mm * pupil_err_mm
    assert found.focal_length_err_px == pytest.approx(expected_err_px, rel=1e-9)
    assert found.focal_length_px == pytest.approx(FOCAL_PX, abs=4 * expected_err_px)


def test_a_board_overrules_the_focal_length_of_the_bench(calibrated: Calibrate) -> None:
    survey = Survey().add("A4", poses_over(HEIGHTS_MM), kind="board")
    found = calibrated(survey, GeometryOptions(nominal_focal_px=1.05 * FOCAL_PX))
    assert found.scale_source == "board"
    assert found.focal_length_err_px is not None
    assert found.focal_length_px == pytest.approx(FOCAL_PX, abs=4 * found.focal_length_err_px)
    assert found.focal_length_err_px < 1e-3 * FOCAL_PX


def test_heights_that_hardly_differ_leave_distortion_centre_and_tilt_open(
    calibrated: Calibrate,
) -> None:
    found = calibrated(Survey(noise_px=0.5).add("brick", poses_over((200.0, 206.0))), NOMINAL)
    assert found.principal_x_px is found.principal_y_px is None
    for open_value in (found.k1, found.k2, found.tilt_x_deg, found.tilt_y_deg, found.tilt_deg):
        assert open_value is None
    for name in ("k1", "k2", "tilt_deg"):
        assert "span a wider range of heights" in found.undetermined[name]
    assert "only a lens with distortion" in found.undetermined["principal_px"]
    assert found.k1_opencv is None


def test_two_heights_alone_are_said_to_be_unchecked(calibrated: Calibrate) -> None:
    found = calibrated(Survey().add("brick", poses_over(HEIGHTS_MM[:2])), NOMINAL)
    assert found.notes == (
        "only two heights: nothing checks them, and their error is not included",
    )


def test_a_stage_that_misses_its_heights_is_noted_with_how_much(calibrated: Calibrate) -> None:
    # 0.3 mm to and fro is no single outlier. Six heights, two figures: an rms of 0.3 sqrt(6 / 4).
    heights = (*HEIGHTS_MM, 520.0)
    read = [h + (0.3 if n % 2 else -0.3) for n, h in enumerate(heights)]
    found = calibrated(Survey().add("brick", poses_over(heights), heights_mm=read), NOMINAL)
    assert found.height_scatter_mm == pytest.approx(0.3 * np.sqrt(6 / 4), rel=0.1)
    assert found.notes == (
        f"heights and images disagree by {found.height_scatter_mm:.3f} mm: check the stage, and "
        "that the lens was not refocused between captures",
    )
    assert [c.height_residual_mm > 0 for c in found.captures] == [False, True] * 3


@pytest.mark.slow
def test_two_targets_that_lie_alike_give_one_tilt(calibrated: Calibrate) -> None:
    poses = poses_over(HEIGHTS_MM, tilt_deg=(0.5, -0.25))
    found = calibrated(Survey().add("brick", poses).add("grass", poses), NOMINAL)
    assert found.notes == ()
    assert found.tilt_x_err_deg is not None
    assert found.tilt_y_err_deg is not None
    assert found.tilt_x_deg == pytest.approx(0.5, abs=4 * found.tilt_x_err_deg)
    assert found.tilt_y_deg == pytest.approx(-0.25, abs=4 * found.tilt_y_err_deg)


@pytest.mark.slow
def test_of_two_targets_that_lie_askew_the_first_gives_the_tilt_and_the_other_is_named(
    calibrated: Calibrate,
) -> None:
    survey = Survey().add("brick", poses_over(HEIGHTS_MM))
    survey.add("grass", poses_over(HEIGHTS_MM, tilt_deg=(1.0, 0.0)))
    found = calibrated(survey, NOMINAL)
    assert found.tilt_x_err_deg is not None
    assert found.tilt_x_deg == pytest.approx(0.0, abs=4 * found.tilt_x_err_deg)
    [note] = found.notes
    assert note.startswith("grass is inclined by ")
    assert note.endswith("relative to the first target; the tilt given is that of the first")
    assert float(note.split()[4]) == pytest.approx(1.0, abs=0.1)


def test_a_board_at_one_height_gives_the_scale_of_a_texture_at_many(calibrated: Calibrate) -> None:
    survey = Survey().add("A4", poses_over(HEIGHTS_MM[:1]), kind="board")
    survey.add("brick", poses_over(HEIGHTS_MM))
    found = calibrated(survey)
    assert found.scale_source == "board"
    assert found.focal_length_err_px is not None
    assert found.focal_length_px == pytest.approx(FOCAL_PX, abs=4 * found.focal_length_err_px)
    board = found.captures[0]
    # One place is no line of travel to stand beside.
    assert (board.kind, board.sideways_mm) == ("board", (0.0, 0.0))
    expected = FOCAL_PX / (HEIGHTS_MM[0] + PUPIL_MM)
    assert board.scale_px_per_mm == pytest.approx(expected, rel=5e-4)


def test_a_drift_of_nothing_has_the_error_of_one_axis() -> None:
    nothing = length_of(Estimate(value=0.0, err=0.3), Estimate(value=0.0, err=0.4))
    # By hand: 0.5 / sqrt(2), the rms of both.
    assert nothing.value == 0.0
    assert nothing.err == pytest.approx(0.5 / np.sqrt(2))


def test_a_geometry_json_that_cannot_be_written_is_named(
    calibrated: Calibrate, tmp_path: Path
) -> None:
    found = calibrated(Survey().add("brick", poses_over(HEIGHTS_MM[:2])), NOMINAL)
    path = tmp_path / "nowhere" / "geometry.json"
    with pytest.raises(GeometryFileError) as refused:
        write_geometry(path, found)
    assert refused.value.source == str(path)


def test_every_figure_of_the_document_is_filled_in(calibrated: Calibrate) -> None:
    found = calibrated(Survey().add("A4", poses_over(HEIGHTS_MM), kind="board"))
    later = {"schema_name", "provenance"}
    assert found.model_fields_set == GeometryCalibration.model_fields.keys() - later
    assert all(
        one.model_fields_set == type(one).model_fields.keys()
        for one in (*found.captures, *found.zooms)
    )


def test_a_capture_that_is_left_alone_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    # One capture of a texture says nothing: the other goes with it.
    survey = Survey().add("brick", poses_over(HEIGHTS_MM)).add("grass", poses_over(HEIGHTS_MM[:2]))
    gone = survey.captures[5]
    matched = _MatchedCaptures(
        adjustment=survey.adjusted().without([gone]),
        exclusions=(Exclusion(capture=gone, reason="it is blurred"),),
    )
    monkeypatch.setattr(calibration, "adjust_captures", lambda *_: matched)
    found = geometry_of_captures(survey.captures, NOMINAL)
    first, second = found.excluded
    assert (first.image, first.reason) == ("grass-0-0.tif", "it is blurred")
    assert second.image == "grass-0-1.tif"
    assert len(found.captures) == 5


def test_a_result_says_of_itself_what_fits_a_line_or_two(calibrated: Calibrate) -> None:
    found = calibrated(Survey().add("brick", poses_over(HEIGHTS_MM)), NOMINAL)
    assert len(repr(found)) < 200
    assert f"{found.pupil_offset_mm:.6g}" in str(found)
