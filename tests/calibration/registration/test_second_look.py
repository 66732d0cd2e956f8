"""Features that are found again where a weakly founded pose puts them confirm or correct it."""

import numpy as np

from calibration.registration.candidates import Candidate, PhotographPair
from calibration.registration.dense import Agreement, AlignedPhotograph
from calibration.registration.hypotheses import PoseHypothesis
from calibration.registration.second_look import looked_again, second_look
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


def test_details_elsewhere_contradict_a_pose_and_details_in_their_places_do_not() -> None:
    _, true = candidate(TRUE)
    look = second_look(true.directed)
    assert look is not None
    share = look.share(true.directed.pose)
    assert share is not None
    assert share > 0.8
    aside = TRUE.copy()
    aside[:2, 2] += 9.0
    _, wrong = candidate(aside)
    assert look.is_contradicted(wrong.directed.pose)
    assert not look.is_contradicted(true.directed.pose)
    off_px = look.displacement_px(wrong.directed.pose)
    assert off_px is not None
    # 9 px along both axes of the reference, of which 1.3 are one of the follow-up.
    assert abs(off_px - 9 * 2**0.5 / 1.3) < 0.5
