"""Verdicts by curves, and the way from the pose to words."""

import numpy as np
import pytest

from analysis.detectability import DetectabilityCurve
from standoff.console.guide import GuideReference, Judge
from standoff.console.guide._assessment import dprime_lost
from standoff.console.guide._reference import scaled_matrix
from tests.standoff.console.guide.scenes import Stills

pytestmark = pytest.mark.slow

ZOOM = [1.0, 1.5, 2.0]


def curve(dprime: list[float]) -> DetectabilityCurve:
    return DetectabilityCurve(
        model="matched", observer="hotelling", noise_dn=2.0, contrast_dn=12.0, signal_sigma_px=2.0,
        zoom=ZOOM, dprime=dprime, dprime_low=dprime, dprime_high=dprime, auc=[0.9] * 3,
    )  # fmt: skip


def test_a_pose_that_allows_too_little_is_no_go_though_the_camera_is_back(stills: Stills) -> None:
    reference = GuideReference.read(stills.reference)
    poor = Judge(reference, curve([1.5, 1.0, 0.5]), 2.0)
    good = Judge(reference, curve([4.0, 3.0, 2.0]), 2.0)
    back = reference.levels, np.eye(3)
    assert Judge(reference).judged(*back).verdict == "go"
    assert good.judged(*back).verdict == "go"
    found = poor.judged(*back)
    assert found.verdict == "no go"
    assert "d′ 1.50 of at least 2" in found.words


def test_a_fault_is_told_beside_the_arrows_and_spoken_once_the_camera_stands_right(
    stills: Stills,
) -> None:
    reference = GuideReference.read(stills.reference)
    judge = Judge(reference)
    width = reference.small_size[0]
    for share, spoken in ((0.2, "left 20 % of the picture"), (0.012, "more light")):
        aside = np.array([[1.0, 0, share * width], [0, 1, 0], [0, 0, 1]])
        shifted = np.roll(reference.levels, -round(share * width), axis=1)
        found = judge.judged(shifted, aside, level=0.05)
        assert found.arrows
        assert found.faults == ("more light",)
        assert found.spoken == spoken
    # The null: in good light nothing but the arrow is told.
    found = judge.judged(shifted, aside)
    assert found.faults == ()
    assert found.verdict == "go"


def test_nothing_is_said_of_what_is_lost_where_the_references_own_pose_has_none(
    stills: Stills,
) -> None:
    reference = GuideReference.read(stills.reference)
    found = Judge(reference, curve([0.0, 0.0, 0.0]), 1.0).judged(reference.levels, np.eye(3))
    assert found.quality is not None
    assert dprime_lost(found.quality) is None
    assert "lost" not in found.words


def test_what_is_lost_is_told_against_the_references_own_pose(stills: Stills) -> None:
    reference = GuideReference.read(stills.reference)
    judge = Judge(reference, curve([4.0, 3.0, 2.0]), 1.0)
    width, height = reference.small_size
    # From 1.25 times the distance: half way from 4.0 to 3.0 along the curve's spline, some 13 %.
    further = np.array(
        [[1.25, 0, -0.125 * (width - 1)], [0, 1.25, -0.125 * (height - 1)], [0, 0, 1]]
    )
    quality = judge.judged(reference.levels, further).quality
    # The frame is another scene for its detail, so only the pose is asked.
    assert quality is None
    direct = judge._quality(further, reference.small_size, reference.size)
    assert direct is not None
    expected = float(np.asarray(direct.curve.d_prime_at(np.array([1.25])))[0])
    assert dprime_lost(direct) == pytest.approx(1 - expected / 4.0, abs=0.002)


def test_a_homography_is_carried_over_to_the_full_pictures() -> None:
    matrix = np.array([[1.1, 0.02, 3.0], [-0.01, 1.05, -2.0], [1e-5, 0, 1]])
    full = scaled_matrix(matrix, ((640, 480), (640, 480)), ((1280, 960), (3200, 2400)))
    # Pixel centres: (x + .5) scales, so the small pixel 10 has its centre at 20.5 of 1280.
    small = matrix @ [10.0, 20.0, 1.0]
    small /= small[2]
    large = full @ [20.5, 40.5, 1.0]
    large /= large[2]
    np.testing.assert_allclose(large[:2], 5 * (small[:2] + 0.5) - 0.5)
