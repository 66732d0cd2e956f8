import numpy as np
import pytest

from calibration.geometry import GeometryCalibration
from calibration.geometry._document import CrossValidation
from calibration.geometry._pupil import without_outliers
from calibration.geometry.cross_validation import cross_validation
from tests.calibration.exact_survey import Survey
from tests.calibration.faulty_survey import Fault, surveyed
from tests.calibration.geometry_bench import HEIGHTS_MM, poses_over

pytestmark = pytest.mark.slow

MATTERS = 0.02
"""Of the distance: a zoom that is off by 0.02 moves d' by 5 %."""


def validated(
    seed: int, kind: str, fault: Fault | None = None, size: float = 0.0
) -> tuple[CrossValidation, bool]:
    """The cross-validation, and whether captures were left out by name before it."""
    found = surveyed(seed, kind, fault, size)
    return cross_validation(found.adjustment, found.pupil), bool(found.exclusions)


@pytest.mark.parametrize("kind", ["board", "texture"])
def test_nothing_is_named_where_the_model_holds(kind: str) -> None:
    found = [validated(seed, kind)[0] for seed in range(4)]
    assert [one.faults for one in found] == [()] * 4
    for one in found:
        assert one.heights is not None
        assert one.points is not None
        # Six predictions of heights, whose images have errors known to a few per cent.
        assert one.heights.chi2_reduced < 6
        assert one.heights.worst < 5e-4
        assert one.points.sag < 5 * one.points.sag_err


@pytest.mark.parametrize("kind", ["board", "texture"])
@pytest.mark.parametrize(
    ("fault", "words"), [("heights", "heights wander"), ("travel", "does not travel straight")]
)
def test_a_stage_that_wanders_is_named(kind: str, fault: Fault, words: str) -> None:
    named = 0
    for seed in range(4):
        found, is_excluded = validated(seed, kind, fault, MATTERS)
        named += is_excluded or any(words in text for text in found.faults)
        assert not any("flat" in text for text in found.faults)
    # Five draws may happen to lie on a line; one in a hundred does, two of four in 1,700.
    assert named >= 3


def test_a_board_that_is_not_flat_is_named_with_how_much() -> None:
    for seed in range(2):
        found, _ = validated(seed, "board", "sag", MATTERS)
        assert found.points is not None
        # A bend along x alone: in closed form, its height at the corner's radius. The pupil and
        # the tilt take what they can of it.
        assert found.points.sag == pytest.approx(MATTERS, rel=0.15)
        assert any("not flat" in text for text in found.faults)


def test_a_flat_board_has_no_sag() -> None:
    sags = []
    for seed in range(3):
        found, _ = validated(seed, "board", "sag", 0.0)
        assert found.points is not None
        assert found.faults == ()
        sags.append(found.points.sag)
    assert np.median(sags) < 1e-3


def test_two_heights_predict_nothing_and_three_one() -> None:
    for count, is_known in ((2, False), (3, True)):
        heights = HEIGHTS_MM[:count]
        survey = Survey(noise_px=0.03).add("target", poses_over(heights), kind="board")
        found = without_outliers(survey.adjusted())
        validated_by_half = cross_validation(found.adjustment, found.pupil)
        assert (validated_by_half.heights is not None) is is_known
        assert (validated_by_half.travel is not None) is is_known
        assert validated_by_half.faults == ()


def test_a_document_of_before_has_no_cross_validation() -> None:
    old = GeometryCalibration.model_validate(
        {
            "heights_mm": (180.0, 220.0),
            "scale_px_per_mm": None,
            "pupil_offset_mm": 12.5,
            "k1": None,
            "k2": None,
            "tilt_deg": None,
            "axis_drift_px_per_mm": None,
        }
    )
    assert old.cross_validation is None
