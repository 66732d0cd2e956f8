from pathlib import Path

import pytest

from acquisition.session import Session
from analysis.validation import NothingToCompareError, registrations_at_most, screen
from analysis.validation._screening import Screening, series_of
from tests.acquisition.session_fixtures import whole_session
from tests.analysis.bench_session import chart_session
from tests.analysis.height_series import PSF, height_series


def pairs_of(screening: Screening) -> list[tuple[int, int]]:
    return [(pair.reference.index, pair.followup.index) for pair in screening.pairs]


def excluded_of(screening: Screening) -> list[int]:
    return [one.capture for one in screening.excluded]


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """Four heights of one texture, as they should be."""
    return height_series(tmp_path_factory.mktemp("good") / "series")


@pytest.mark.slow
def test_the_two_nearest_captures_are_references_of_all_further_ones(series: Session) -> None:
    told: list[int] = []
    screening = screen(series, PSF, progress=told.append)
    assert pairs_of(screening) == [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3)]
    assert screening.excluded == ()
    assert told == [1, 2, 3, 4, 5]
    assert registrations_at_most(series, 2) == 5
    zooms = [pair.registration.zoom for pair in screening.pairs]
    # Of the closed form, where the entrance pupil is at height 0.
    assert zooms == pytest.approx([1.2, 1.5, 1.9, 1.25, 19 / 12], rel=1e-3)


@pytest.mark.slow
def test_one_reference_pose_gives_the_pairs_with_the_nearest_alone(series: Session) -> None:
    screening = screen(series, PSF, references=1)
    assert pairs_of(screening) == [(0, 1), (0, 2), (0, 3)]


@pytest.mark.slow
def test_another_target_at_one_height_is_excluded_by_name_with_the_reason(tmp_path: Path) -> None:
    session = height_series(tmp_path / "series", other_target_at=150.0)
    screening = screen(session, PSF)
    assert pairs_of(screening) == [(0, 1), (0, 3), (1, 3)]
    assert excluded_of(screening) == [2]
    text = screening.excluded[0].text
    assert text.startswith("capture 2 (leaves at 150 mm): it does not match capture 0: ")


@pytest.mark.slow
def test_another_target_at_the_nearest_height_is_no_reference(tmp_path: Path) -> None:
    session = height_series(tmp_path / "series", other_target_at=100.0)
    screening = screen(session, PSF)
    assert excluded_of(screening) == [0]
    assert "3 of 3 further captures do not match it" in screening.excluded[0].reason
    assert pairs_of(screening) == [(1, 2), (1, 3), (2, 3)]


@pytest.mark.slow
@pytest.mark.parametrize("step_px", [0.4, 1.5, 6.0])
def test_a_capture_that_was_shaken_in_mid_average_is_excluded(
    tmp_path: Path, step_px: float
) -> None:
    session = height_series(tmp_path / "series", shaken_at={150.0: step_px})
    screening = screen(session, PSF)
    assert excluded_of(screening) == [2]
    assert screening.excluded[0].reason.startswith("motion: ")
    assert pairs_of(screening) == [(0, 1), (0, 3), (1, 3)]


@pytest.mark.slow
def test_a_capture_from_another_height_than_recorded_is_excluded(tmp_path: Path) -> None:
    session = height_series(tmp_path / "series", height_errors_mm={150.0: 12.0})
    screening = screen(session, PSF)
    assert set(excluded_of(screening)) == {2}
    assert "according to the images" in screening.excluded[0].reason


@pytest.mark.slow
def test_a_capture_from_nearer_than_its_reference_is_excluded_with_the_reason(
    tmp_path: Path,
) -> None:
    session = height_series(tmp_path / "series", height_errors_mm={150.0: -80.0})
    screening = screen(session, PSF)
    assert excluded_of(screening) == [2]
    assert pairs_of(screening) == [(0, 1), (0, 3), (1, 3)]


def test_a_series_runs_from_the_nearest_to_the_furthest(session: Session) -> None:
    [series] = series_of(session)
    assert [record.height_asked_mm for record in series] == [100.0, 150.0, 200.0]
    assert {record.kind for record in series} == {"texture"}


def test_a_target_at_one_height_is_no_series(tmp_path: Path) -> None:
    session = chart_session(tmp_path / "s", 3)
    assert series_of(session) == []
    with pytest.raises(NothingToCompareError) as refused:
        screen(session, PSF)
    assert refused.value.excluded == ()


def test_edges_and_flats_are_not_compared(tmp_path: Path) -> None:
    whole_session(tmp_path / "edges")
    session = Session(tmp_path / "edges")
    assert series_of(session) == []
    assert registrations_at_most(session, 2) == 0
    with pytest.raises(NothingToCompareError):
        screen(session, PSF)


@pytest.mark.slow
def test_a_pair_that_shows_two_targets_leaves_nothing(tmp_path: Path) -> None:
    session = height_series(tmp_path / "two", other_target_at=150.0, heights_mm=(100.0, 150.0))
    with pytest.raises(NothingToCompareError) as refused:
        screen(session, PSF)
    assert [one.capture for one in refused.value.excluded] == [1]
    assert refused.value.excluded[0].text in str(refused.value)
