"""Which captures are adjusted, and why others are not."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.errors import GeometryError, RegistrationError
from calibration.geometry import (
    DEFAULT_BOARD,
    CharucoBoard,
    _matching as matching,
    nominal_focal_px,
)
from calibration.geometry._board import BoardCorners
from calibration.geometry._matching import adjust_captures
from hil_mocks.truth.render import CameraPose
from tests.acquisition.session_fixtures import session_with
from tests.calibration.edge_session import edge_session
from tests.calibration.exact_survey import Survey
from tests.calibration.geometry_bench import (
    HEIGHTS_MM,
    PUPIL_MM,
    pinhole,
    poses_over,
    start_lens,
)


def corners(pose: CameraPose, count: int, wrong: int) -> BoardCorners:
    """The first corners of a board, as many as asked for, of which the last ones are 30 px off."""
    y, x = (axis.ravel()[:count] for axis in np.mgrid[-30.0:31.0:10.0, -40.0:41.0:10.0])
    seen = np.column_stack(pinhole().to_pixel(x, y, pose))
    seen[count - wrong :] += 30.0
    return BoardCorners(seen_px=seen, plane_mm=np.column_stack([x, y]), err_px=np.full(count, 0.02))


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> list[BoardCorners]:
    """What the detector finds, capture by capture; an empty one is a board that it misses."""
    found: list[BoardCorners] = []

    def find_board(_image: NDArray[Any], _board: CharucoBoard) -> BoardCorners:
        next_one = found.pop(0)
        if len(next_one.seen_px) == 0:
            raise RegistrationError("only 0 corners of a ChArUco board", reason="no_board", count=0)
        return next_one

    monkeypatch.setattr(matching, "find_board", find_board)
    return found


def test_lone_captures_of_targets_are_refused_with_the_first_ones_name() -> None:
    survey = Survey().add("brick", poses_over(HEIGHTS_MM[:1]))
    survey.add("grass", poses_over(HEIGHTS_MM[1:2]))
    with pytest.raises(GeometryError) as refused:
        adjust_captures(survey.captures, start_lens(), DEFAULT_BOARD)
    assert (refused.value.reason, refused.value.subject) == ("not_matched", "brick-0-0.tif")


def test_boards_alone_are_adjusted_in_mm(shown: list[BoardCorners]) -> None:
    poses = poses_over(HEIGHTS_MM[:3])
    shown += [corners(pose, 63, 0) for pose in poses]
    done: list[int] = []
    survey = Survey().add("A4", poses, kind="board")
    found = adjust_captures(survey.captures, start_lens(), DEFAULT_BOARD, done.append)
    distances = [one.pose.distance for one in found.adjustment.captures]
    np.testing.assert_allclose(distances, np.array(HEIGHTS_MM[:3]) + PUPIL_MM, rtol=1e-4)
    assert done == [3]


def test_a_lone_texture_beside_a_board_is_left_out_with_the_remedy(
    shown: list[BoardCorners],
) -> None:
    poses = poses_over(HEIGHTS_MM[:3])
    shown += [corners(pose, 63, 0) for pose in poses]
    survey = Survey().add("A4", poses, kind="board").add("grass", poses[:1])
    found = adjust_captures(survey.captures, start_lens(), DEFAULT_BOARD)
    [exclusion] = found.exclusions
    assert exclusion.capture is survey.captures[3]
    assert exclusion.reason == (
        "it is the only capture of its target; capture it at two heights or more"
    )


def test_a_board_that_is_not_found_is_left_out_with_the_remedy(shown: list[BoardCorners]) -> None:
    poses = poses_over(HEIGHTS_MM[:3])
    shown += [corners(poses[0], 63, 0), corners(poses[1], 0, 0), corners(poses[2], 63, 0)]
    survey = Survey().add("A4", poses, kind="board")
    found = adjust_captures(survey.captures, start_lens(), DEFAULT_BOARD)
    first, second, third = survey.captures
    assert [one.capture for one in found.adjustment.captures] == [first, third]
    [exclusion] = found.exclusions
    assert exclusion.capture is second
    assert exclusion.reason == (
        "only 0 corners of a ChArUco board; show more of the board, or name it with --board"
    )


def test_a_capture_with_fewer_than_12_believable_points_is_left_out(
    shown: list[BoardCorners],
) -> None:
    poses = poses_over(HEIGHTS_MM[:3])
    # 13 corners, of which two are wrong: eleven are left.
    shown += [corners(poses[0], 63, 0), corners(poses[1], 63, 2), corners(poses[2], 13, 2)]
    survey = Survey().add("A4", poses, kind="board")
    found = adjust_captures(survey.captures, start_lens(), DEFAULT_BOARD)
    used = [(one.capture, one.match_count) for one in found.adjustment.captures]
    assert used == list(zip(survey.captures[:2], (63, 61), strict=True))
    [exclusion] = found.exclusions
    assert exclusion.capture is survey.captures[2]
    assert exclusion.reason.startswith(
        "it does not agree well enough with the other captures; photograph"
    )


@pytest.mark.parametrize(
    ("optics", "focal_px"),
    [
        ({"focal_length_mm": 8.0, "pixel_pitch_um": 4.0}, 2000.0),
        ({"focal_length_mm": 8, "pixel_pitch_um": 4}, 2000.0),
        ({"focal_length_mm": 8.0}, None),
        ({"focal_length_mm": "8", "pixel_pitch_um": 4.0}, None),
        ({"focal_length_mm": -8.0, "pixel_pitch_um": 4.0}, None),
        ({"focal_length_mm": 8.0, "pixel_pitch_um": 0.0}, None),
        ({"focal_length_mm": 0.0, "pixel_pitch_um": 0.0}, None),
        ({"focal_length_mm": 1e300, "pixel_pitch_um": 1e-300}, None),
        ({"focal_length_mm": 8.0, "pixel_pitch_um": 5e-324}, None),
        ([8.0, 4.0], None),
        (None, None),
    ],
)
def test_the_focal_length_is_the_benchs_or_not_known(
    tmp_path: Path, optics: object, focal_px: float | None
) -> None:
    session = edge_session(tmp_path / "s", [])
    bench: dict[str, Any] = {} if optics is None else {"optics": optics}
    altered = session_with(session, manifest=replace(session.manifest, bench=bench))
    assert nominal_focal_px(altered) == focal_px
