"""Features that are found again where a weakly founded pose puts them confirm or correct it."""

import numpy as np
import pytest

from calibration.errors import RegistrationError
from calibration.registration import (
    Agreement,
    AlignedPhotograph,
    RefinedPose,
    block_votes,
    pair as pair_module,
)
from calibration.registration.candidates import (
    ELSEWHERE_MOST,
    Candidate,
    Choice,
    PhotographPair,
    looked_again,
    second_look,
)
from calibration.registration.hypotheses import PoseHypothesis
from calibration.registration.refinement import PlaceErrors
from simulation.arrays import FloatArray
from tests.calibration.registration.test_any_two import error_px, middle, similarity, waves

SHAPE = (240, 320)
TRUE = similarity(1.3, 10.0, (middle(SHAPE), middle(SHAPE)), 2e-4)


def candidate(matrix: FloatArray) -> tuple[PhotographPair, Candidate]:
    """A pose that nothing speaks for, of a scene with many details."""
    scene = waves(4, 0.01, 0.12)
    pair = PhotographPair(
        reference=AlignedPhotograph.of(scene.seen(np.eye(3), SHAPE)),
        followup=AlignedPhotograph.of(scene.seen(TRUE, SHAPE)),
        psf=None,
    )
    agreement = Agreement(
        correlation=0.5,
        significance=11.0,
        overlap_px=10_000,
        overlap=0.8,
        rival_correlation=0.1,
        rival_shift_px=(30.0, 0.0),
    )
    return pair, Candidate(
        hypothesis=PoseHypothesis(matrix=matrix),
        directed=pair.directed(pair.pose_of(matrix)),
        agreement=agreement,
    )


def off(by_px: float) -> FloatArray:
    """The true pose with a perspective that moves the corners by so much, and them alone."""
    lean = np.eye(3)
    lean[2, 0] = by_px / 160 / 320
    back = np.eye(3)
    back[:2, 2] = middle(SHAPE)
    return np.asarray(TRUE @ back @ lean @ np.linalg.inv(back))


def test_a_pose_that_is_some_pixels_off_is_corrected() -> None:
    pair, weak = candidate(off(12.0))
    assert error_px(weak.directed.of_followup, TRUE) > 2
    better = looked_again(pair, weak)
    assert error_px(better.directed.of_followup, TRUE) < 0.3
    assert better.hypothesis.match_count >= 20


def test_matches_say_how_far_details_lie_from_where_a_pose_puts_them() -> None:
    _, true = candidate(TRUE)
    look = second_look(true.directed)
    assert look is not None
    own_px = look.displacement_px(true.directed.pose)
    assert own_px is not None
    assert own_px < 0.5
    aside = TRUE.copy()
    aside[:2, 2] += 9.0
    off_px = look.displacement_px(candidate(aside)[1].directed.pose)
    # About 9 px along both axes of the reference, of which 1.3 are one of the follow-up.
    assert off_px == pytest.approx(9 * 2**0.5 / 1.3, abs=0.6)


def test_blocks_are_recognised_where_the_true_pose_puts_them_and_beside_another() -> None:
    _, true = candidate(TRUE)
    here = block_votes(*true.directed.photographs, true.directed.pose)
    assert here.here > 30
    assert here.share_elsewhere < 0.05
    # The corners are 24 px off, the middle is not.
    _, wrong = candidate(off(24.0))
    elsewhere = block_votes(*wrong.directed.photographs, wrong.directed.pose)
    assert elsewhere.share_elsewhere > ELSEWHERE_MOST


def test_noise_hides_blocks_and_moves_none() -> None:
    rng, scene = np.random.default_rng(3), waves(4, 0.01, 0.12)
    near, far = (
        AlignedPhotograph.of(scene.seen(one, SHAPE) + rng.normal(0, 60, SHAPE))
        for one in (np.eye(3), TRUE)
    )
    _, true = candidate(TRUE)
    votes = block_votes(near, far, true.directed.pose)
    assert votes.share_elsewhere < 0.1


def test_a_pose_that_outlines_alone_agree_with_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    pair, wrong = candidate(off(24.0))
    # As if the refinement had been drawn there.
    refined = RefinedPose(
        pose=wrong.directed.pose,
        errors=PlaceErrors(place_err_px=0.05, k1_err=0.0),
        correlation=0.98,
        residual_rms=0.1,
    )
    monkeypatch.setattr(pair_module, "refined_pose", lambda *_, **__: refined)
    with pytest.raises(RegistrationError) as refused:
        pair_module._refined(pair, Choice(best=wrong))
    assert refused.value.reason == "contradiction"
