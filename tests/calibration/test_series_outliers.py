"""Captures and targets that contradict the others, by points that are known."""

import pytest

from calibration.errors import GeometryError
from calibration.series_outliers import ConsistentSeries, without_outliers
from tests.calibration.exact_survey import Survey
from tests.calibration.geometry_bench import HEIGHTS_MM, poses_over


def consistent(survey: Survey) -> tuple[ConsistentSeries, dict[str, str]]:
    excluded: dict[int, str] = {}
    found = without_outliers(survey.adjusted(), survey.captures, excluded)
    return found, {survey.captures[place].name: reason for place, reason in excluded.items()}


def test_a_target_turned_between_all_heights_is_refused_with_the_remedy() -> None:
    survey = Survey()
    for number, height_mm in enumerate(HEIGHTS_MM[:3]):
        survey.add("A4", poses_over([height_mm]), kind="board", orientation_deg=30.0 * number)
    with pytest.raises(GeometryError, match=r"A4-0-0\.tif: no target is left .* without moving it"):
        consistent(survey)
